import subprocess
import sys
from pathlib import Path

import pytest

from hulldown.base.files import atomic_writer, is_safe_relative_path
from hulldown.tests.oracles.synced import synced_bytes

FILL = """
import resource, sys
from pathlib import Path
from hulldown.base.files import atomic_writer
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    with atomic_writer(Path(sys.argv[1])) as file:
        file.write(bytes(100_000))
        file.flush()
except OSError as error:
    print(error.filename)
"""


def test_a_replaced_file_is_synced_before_it_gets_its_name(tmp_path, monkeypatch):
    path, synced = tmp_path / "plan.json", synced_bytes(monkeypatch)
    path.write_bytes(b"old")
    with atomic_writer(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert synced[path.stat().st_ino] == b"new"


def test_an_error_keeps_the_old_file(tmp_path):
    path = tmp_path / "plan.json"
    path.write_bytes(b"old")
    with pytest.raises(TypeError), atomic_writer(path) as file:
        file.writelines([b"half", None])
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("plan.json", b"old")]


def test_the_error_of_a_full_disk_names_the_file(tmp_path):
    code = [sys.executable, "-c", FILL, str(tmp_path / "cache.npz")]
    ran = subprocess.run(code, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.strip() == str(tmp_path / "cache.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["/a.png", "..", "a/../../b", "a\\..\\b", "C:a.png", "\\a.png", "a\0b", "", None])
def test_names_that_leave_their_folder_on_any_system(name):
    assert not is_safe_relative_path(name)
    assert is_safe_relative_path("images/a b.png")
