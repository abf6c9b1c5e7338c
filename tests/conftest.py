"""What tests of several modules share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

    from tests.messy_export import Messy


@pytest.fixture(scope="session")
def messy(tmp_path_factory: pytest.TempPathFactory) -> Messy:
    """The messy files, built and exported once for the whole run."""
    from tests.messy_export import build  # not before a test asks: it needs most of the code

    return build(tmp_path_factory.mktemp("messy"))


@pytest.fixture(scope="session")
def blender(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A stand-in for an installed Blender; see fake_blender.py."""
    script = tmp_path_factory.mktemp("blender") / "blender"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} -S -E {Path(__file__).with_name('fake_blender.py')}\n")
    script.chmod(0o755)
    return str(script)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """A browser without a window, started once for the whole run."""
    from tests.browser import chromium

    with chromium(tmp_path_factory.mktemp("profile")) as driver:
        yield driver
