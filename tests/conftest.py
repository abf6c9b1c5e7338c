"""Shared fixtures."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from filelock import FileLock

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

    from hulldown.plan.library import Library
    from hulldown.plan.plan_file import Plan
    from hulldown.render.supervisor import RenderReport
    from hulldown.tests.builders.messy_export import Messy


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that `make` fills once per run, for all workers of pytest-xdist."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        folder = factory.mktemp(name)
        make(folder)
        return folder
    folder = factory.getbasetemp().parent / name
    made = folder.with_suffix(".made")
    with FileLock(folder.with_suffix(".lock")):
        if not made.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            made.touch()
    return folder


@pytest.fixture(scope="session")
def messy(tmp_path_factory: pytest.TempPathFactory) -> Messy:
    """The messy files, built and exported once for the whole run."""
    from hulldown.tests.builders.messy_export import build, load  # imported late, since they import most of the code

    return load(made_once(tmp_path_factory, "messy", build))


@pytest.fixture(scope="session")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of render_worlds.py, with tank, field, and gray sky in the cache; see `own_worlds`."""
    from hulldown.tests.builders.blender_plans import plan_in, run_script

    def make(folder: Path) -> None:
        run_script("render_worlds.py", folder)
        plan_in(folder, images=1).unlink()

    return made_once(tmp_path_factory, "worlds", make)


@pytest.fixture(scope="module")
def own_worlds(worlds: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of `worlds` for one module, so that files and caches aren't shared."""
    return shutil.copytree(worlds, tmp_path_factory.mktemp("worlds"), dirs_exist_ok=True)


@pytest.fixture(scope="module")
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the script SCRIPT of the module, which imports bpy, has written into."""
    from hulldown.tests.builders.blender_plans import run_script

    script = request.module.SCRIPT
    return made_once(tmp_path_factory, Path(script).stem, partial(run_script, script))


@pytest.fixture(scope="module")
def library(plan: Plan) -> Library:
    """The assets of the module's `plan`, for rendering."""
    from hulldown.plan.library import load_planned_library

    return load_planned_library(plan)


@pytest.fixture(scope="session")
def blender(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A stand-in for an installed Blender; see fake_blender.py."""
    script = tmp_path_factory.mktemp("blender") / "blender"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} -P {Path(__file__).with_name('builders') / 'fake_blender.py'}\n")
    script.chmod(0o755)
    return str(script)


@pytest.fixture
def render(blender: str) -> Callable[..., RenderReport]:
    """`render_remaining_images` for plans of render_plans.py, with a stand-in for Blender."""
    from hulldown.render.pool import Engine
    from hulldown.render.supervisor import render_remaining_images
    from hulldown.tests.builders.render_plans import CUBES

    return partial(render_remaining_images, library=CUBES, engine=Engine(blender=blender))


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """A headless browser, started once per run."""
    from hulldown.tests.builders.browser import chromium

    with chromium(tmp_path_factory.mktemp("profile")) as driver:
        yield driver
