"""What counts as the same code: the modules that are named and everything that they import."""

import shutil

import pytest

from geometry import code
from render.node import CODE as RENDERS
from training.study.elsewhere import CODE as TRAINS


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("code")
    for name in code.FOLDERS:
        shutil.copytree(code.ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.mark.parametrize(
    ("modules", "changed", "matters"),
    [
        (RENDERS, "camera/fog.py", True),
        (RENDERS, "camera/precipitation.py", True),
        (RENDERS, "render/blender/worker.py", True),
        (RENDERS, "render/blender/covers.py", True),
        (RENDERS, "training/train.py", False),
        (TRAINS, "training/train.py", True),
        (TRAINS, "dataset/entries.py", True),
        (TRAINS, "geometry/files.py", True),
        (TRAINS, "render/pool.py", False),
    ],
)
def test_what_is_imported_counts(copied, monkeypatch, modules, changed, matters):
    """Blender's side of rendering imports camera/ and a training imports dataset/."""
    before = code.code_sha256(*modules)
    monkeypatch.setattr(code, "ROOT", copied)
    path = copied / changed
    text = path.read_text()
    path.write_text(text + "\nx = 1\n")
    after = code.code_sha256.__wrapped__(*modules)
    path.write_text(text)
    assert len(before) == 64
    assert (after != before) == matters
