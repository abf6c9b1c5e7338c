"""The package is found in the checkout, complete in the wheel, and alone there."""

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from hulldown.reading import libraries

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SHIPPED = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
PACKAGES = [name for name in SHIPPED if not name.endswith((".py", ".typed"))]


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    [wheel] = folder.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


def test_the_package_is_the_checkout_and_flat_names_cannot_be_imported():
    spec = importlib.util.find_spec("hulldown")
    assert spec is not None
    assert Path(spec.origin).resolve() == ROOT / "__init__.py"
    code = "import importlib.util, sys; sys.exit(any(map(importlib.util.find_spec, sys.argv[1:])))"
    subprocess.run([sys.executable, "-P", "-c", code, *PACKAGES, "cli"], check=True)


def test_the_wheel_contains_exactly_the_modules(wheel_names):
    modules = {str("hulldown" / p.relative_to(ROOT)) for package in PACKAGES for p in (ROOT / package).rglob("*.py")}
    assert len(modules) > 100
    assert modules | {f"hulldown/{name}.py" for name in ("__init__", "__main__", "cli")} <= set(wheel_names)
    assert {name.split("/")[0] for name in wheel_names if ".dist-info/" not in name} == {"hulldown"}
    assert {name.split("/")[1] for name in wheel_names if ".dist-info/" not in name} == set(SHIPPED)


def test_dependencies_have_lower_and_upper_bounds():
    project = PYPROJECT["project"]
    named = project["dependencies"] + [d for extra in project["optional-dependencies"].values() for d in extra]
    assert [d for d in named if ">=" not in d or "<" not in d.split(";")[0]] == []


def test_constraints_are_names_and_versions_only():
    lines = [x for x in (ROOT / "constraints.txt").read_text().splitlines() if x and not x.startswith("#")]
    pin = re.compile(r"[\w.-]+==[\w.]+(; python_version == '3\.\d+')?")
    assert [x for x in lines if not pin.fullmatch(x)] == []


def test_import_rules_cover_every_package_in_pipeline_order():
    rules = PYPROJECT["tool"]["importlinter"]
    assert rules["root_packages"] == ["hulldown"]
    assert rules["contracts"][0]["layers"] == [f"hulldown.{package}" for package in PACKAGES[::-1]]


def test_the_core_does_not_import_blender():
    core = ["scene.ray_caster", "placement.terrain", "camera.cameras", "annotate.boxes", "planning.planner"]
    code = f"import sys; import {', '.join(f'hulldown.{m}' for m in core)}; assert 'bpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)


def test_the_version_is_stated_once():
    version = PYPROJECT["project"]["version"]
    files = [path for folder in ("docs", *SHIPPED) for path in [*(ROOT / folder).rglob("*.[mp][dy]"), ROOT / folder]]
    texts = [ROOT / "README.md", ROOT / "Makefile", ROOT / "Dockerfile", *(path for path in files if path.is_file())]
    assert len(texts) > 100
    assert [path for path in texts if re.search(rf"(?<![\d.]){re.escape(version)}(?![\d.])", path.read_text())] == []


@pytest.mark.parametrize("stack", ["3.11", "3.13"])
def test_each_supported_python_has_one_blender_with_its_constraint(stack):
    marker = f"; python_version == '{stack}'"
    [wanted] = [x for x in PYPROJECT["project"]["optional-dependencies"]["blender"] if x.endswith(marker)]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    [pinned] = [x.removesuffix(marker).split("==")[1] for x in lines if x.startswith("bpy==") and x.endswith(marker)]
    assert Version(pinned) in Requirement(wanted).specifier
    assert f"Programming Language :: Python :: {stack}" in PYPROJECT["project"]["classifiers"]
    assert stack in (ROOT / "Makefile").read_text().partition("SUPPORTED := ")[2].partition("\n")[0].split()


def test_the_readme_has_the_line_that_installs_blenders_libraries():
    assert f"\nsudo {libraries.INSTALL_COMMAND}\n" in (ROOT / "README.md").read_text()


def test_setup_without_the_libraries_stops_with_the_line_that_installs_them(tmp_path):
    """Not even `venv` works without the libraries, so `make` must stop first."""
    (tmp_path / "bare.py").write_text(
        "import ctypes, os, runpy, sys\n"
        "def missing(name): raise OSError(name)\n"
        "ctypes.CDLL, os.geteuid = missing, lambda: 1000\n"
        "runpy.run_path(sys.argv[-1], run_name='__main__')\n"
    )
    python = tmp_path / "python"
    python.write_text(
        f'#!/bin/sh\n[ "$1" = -P ] || exec "{sys.executable}" "$@"\nexec "{sys.executable}" "{tmp_path / "bare.py"}" "$@"\n'
    )
    python.chmod(0o755)
    ran = subprocess.run(
        ["make", "setup", f"PYTHON={python}", f"VENV={tmp_path}/venv"], cwd=ROOT, capture_output=True, text=True
    )
    assert ran.returncode == 2
    assert f"sudo {libraries.INSTALL_COMMAND}\n" in ran.stderr
    assert not (tmp_path / "venv").exists()


FAKE = '#!/bin/sh\n[ "$1" = -c ] && echo {0}\n[ "$1" = -V ] && echo Python {0}.9\n[ "$1" = -P ] && exit 3\nexit 0\n'


@pytest.mark.parametrize(
    ("machine", "expected"),
    [
        ({"python3": "3.11"}, "gets Python 3.11.9, "),
        ({"python3": "3.13", "python3.11": "3.11"}, "gets Python 3.13.9, "),
        ({"python3": "3.12", "python3.13": "3.13", "python3.11": "3.11"}, "gets Python 3.13.9, "),
        ({"python3": "3.12"}, "python3 is Python 3.12.9: install one of them"),
    ],
)
def test_setup_takes_a_supported_python_and_tells_which(tmp_path, machine, expected):
    for name, version in machine.items():
        (tmp_path / name).write_text(FAKE.format(version))
        (tmp_path / name).chmod(0o755)
    ran = subprocess.run(
        [shutil.which("make"), "setup", f"VENV={tmp_path}/venv"],
        cwd=ROOT, capture_output=True, text=True, env={"PATH": str(tmp_path)},
    )  # fmt: skip
    assert ran.returncode == 2
    assert expected in ran.stdout + ran.stderr


@pytest.mark.parametrize(
    ("message", "remedy"),
    [
        ("ImportError: libX11.so.6: cannot open shared object file: No such file or directory\n", libraries.INSTALL_COMMAND),
        ("No module named 'bpy'\n", "hulldown[blender]"),
        ("ImportError: cannot import name 'x' from 'y'\n", "None"),
    ],
)
def test_every_library_of_blender_has_a_package_to_install(message, remedy):
    assert remedy in str(libraries.remedy_for_blender_output(f"Traceback:\n{message}"))
