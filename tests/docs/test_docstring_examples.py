"""Examples in docstrings run."""

import doctest
import importlib
import tomllib
from pathlib import Path

import pytest

from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import small_assets, small_config

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGES = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
IN_BLENDER = {"blender", "demo"}  # folders with code that runs inside Blender's process
MODULES = [
    ".".join(["hulldown", *path.relative_to(ROOT).with_suffix("").parts])
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if not IN_BLENDER & set(path.relative_to(ROOT).parts) and ">>>" in path.read_text(encoding="utf-8")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a plan, for the examples."""
    folder = tmp_path_factory.mktemp("examples")
    write_plan(small_config(), small_assets(), folder / "plan.jsonl")
    return folder


@pytest.mark.parametrize("module", MODULES)
def test_examples_run(module, folder, monkeypatch):
    monkeypatch.chdir(folder)
    found = importlib.import_module(module)
    result = doctest.testmod(found, optionflags=doctest.NORMALIZE_WHITESPACE)
    # Examples that need Blender or a trained detector are skipped.
    assert result.attempted > 0 or "doctest: +SKIP" in Path(found.__file__).read_text(encoding="utf-8")
    assert result.failed == 0
