"""Full disks."""

import subprocess
import sys
from pathlib import Path

from hulldown.planning.plan_file import PlanWriter
from hulldown.planning.row import Header
from hulldown.tests.plan_lines import HEADER

ROOT = Path(__file__).resolve().parents[1]
FILL = """
import resource, sys
from pathlib import Path
from hulldown.geometry.files import replacing
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    with replacing(Path(sys.argv[1])) as file:
        file.write(bytes(100_000))
        file.flush()
except OSError as error:
    print(error.filename)
"""


def test_the_error_of_a_full_disk_names_the_file(tmp_path):
    code = [sys.executable, "-c", FILL, str(tmp_path / "cache.npz")]
    ran = subprocess.run(code, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.strip() == str(tmp_path / "cache.npz")
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_plan_is_removed_before_it_is_released(tmp_path, monkeypatch):
    writer = PlanWriter(tmp_path / "plan.jsonl", Header(**HEADER))
    there = []
    release = writer._lock.release
    monkeypatch.setattr(
        writer._lock, "release", lambda: (there.append(Path(writer._lock.lock_file).exists()), release())
    )
    writer.__exit__(None, None, None)
    assert there == [False]
