"""The package must be ours: found in the checkout, whole in the wheel, and nothing beside it."""

import importlib.util
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SHIPPED = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
PACKAGES = [name for name in SHIPPED if not name.endswith(".py")]


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    [wheel] = folder.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


def test_the_package_is_the_checkout_and_flat_names_are_no_modules():
    spec = importlib.util.find_spec("hulldown")
    assert spec is not None
    assert Path(spec.origin).resolve() == ROOT / "__init__.py"
    code = "import importlib.util, sys; sys.exit(any(map(importlib.util.find_spec, sys.argv[1:])))"
    subprocess.run([sys.executable, "-P", "-c", code, *PACKAGES, "cli"], check=True)


def test_the_wheel_holds_every_module_and_nothing_else(wheel_names):
    modules = {str("hulldown" / p.relative_to(ROOT)) for package in PACKAGES for p in (ROOT / package).rglob("*.py")}
    assert len(modules) > 100
    assert modules | {"hulldown/__init__.py", "hulldown/cli.py"} <= set(wheel_names)
    assert {name.split("/")[0] for name in wheel_names if ".dist-info/" not in name} == {"hulldown"}
    assert {name.split("/")[1] for name in wheel_names if ".dist-info/" not in name} == set(SHIPPED)


def test_dependencies_have_lower_and_upper_bounds():
    project = PYPROJECT["project"]
    named = project["dependencies"] + [d for extra in project["optional-dependencies"].values() for d in extra]
    assert [d for d in named if ">=" not in d or "<" not in d.split(";")[0]] == []


def test_constraints_are_names_and_versions_only():
    lines = [x for x in (ROOT / "constraints.txt").read_text().splitlines() if x and not x.startswith("#")]
    assert [x for x in lines if x.count("==") != 1 or "/" in x or "@" in x or " " in x] == []


def test_import_rules_cover_every_package_in_the_order_of_the_pipeline():
    rules = PYPROJECT["tool"]["importlinter"]
    assert rules["root_packages"] == ["hulldown"]
    assert rules["contracts"][0]["layers"] == [f"hulldown.{package}" for package in PACKAGES[::-1]]


def test_it_cannot_be_uploaded_by_accident():
    assert "Private :: Do Not Upload" in PYPROJECT["project"]["classifiers"]


def test_the_core_does_not_import_blender():
    core = ["geometry.rays", "placement.terrain", "camera.projection", "annotate.boxes", "planning.planner"]
    code = f"import sys; import {', '.join(f'hulldown.{m}' for m in core)}; assert 'bpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)
