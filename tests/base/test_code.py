"""The fingerprint of the code covers all modules."""

import shutil

import pytest

from hulldown.base import code
from hulldown.conftest import PACKAGES


@pytest.fixture
def copied(tmp_path, monkeypatch):
    for name in PACKAGES:
        if (code.PACKAGE_FOLDER / name).is_dir():
            shutil.copytree(code.PACKAGE_FOLDER / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code, "PACKAGE_FOLDER", tmp_path)
    return tmp_path


def test_any_changed_module_counts_and_its_location_does_not(copied):
    before = code.code_sha256()
    assert code.code_sha256.__wrapped__() == before  # so the hash is that of the shipped folders
    for changed in ("weather/kinds.py", "render/blender/worker.py", "training/train.py"):
        (copied / changed).write_text((copied / changed).read_text() + "\nx = 1\n")
        after = code.code_sha256.__wrapped__()
        assert after != before
        before = after


def test_another_version_is_named():
    own = code.package_versions("numpy", "no-such-package")
    assert own.keys() == {"hulldown", "numpy", "no-such-package"}
    assert code.describe_version_difference(own) == ""
    assert code.describe_version_difference({**own, "numpy": "0.1"}) == f"has numpy {own['numpy']}, and the client 0.1"
    assert code.describe_version_difference({"no-such-package": "1"}) == "has no-such-package not installed, and the client 1"
