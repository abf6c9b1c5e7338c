"""A process that tries forbidden things, with and without Landlock."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hulldown.cli import main
from hulldown.reading.confinement import landlock
from hulldown.reading.confinement.landlock import confine_command, landlock_version, readable_asset_folders

ROOT = Path(__file__).resolve().parents[2]
# Each line is tried separately. IN is writable, OUT isn't; both are folders with a file.
TRIES = """
open(f"{OUT}/new", "w")
open(f"{OUT}/file", "a")
open(f"{OUT}/file", "r+")
open(f"{OUT}/file").read()
os.truncate(f"{OUT}/file", 0)
os.mkdir(f"{OUT}/folder")
os.unlink(f"{OUT}/file")
os.rmdir(f"{OUT}/empty")
os.rename(f"{OUT}/file", f"{IN}/stolen")
os.rename(f"{IN}/file", f"{OUT}/given")
os.link(f"{OUT}/file", f"{IN}/linked")
os.symlink(f"{OUT}/file", f"{IN}/link")
os.mkfifo(f"{IN}/fifo")
os.listdir(OUT)
open("/dev/zero", "rb").read(1)
open("/proc/kmsg", "rb", 0)
open("/proc/1/environ", "rb").read()
open("/etc/shadow").read()
subprocess.run([f"{OUT}/program"], check=True)
subprocess.run([f"{SEEN}/program"], check=True)
socket.create_connection(("127.0.0.1", PORT), 1)
socket.socket().bind(("127.0.0.1", 0))
"""
MAY = """
open(f"{IN}/new", "w").write("x")
open(f"{IN}/file", "r+").truncate(0)
os.mkdir(f"{IN}/folder")
os.rename(f"{IN}/new", f"{IN}/renamed")
os.unlink(f"{IN}/renamed")
open(f"{SEEN}/file").read()
os.listdir(SEEN)
open("/dev/null", "w").write("x")
subprocess.run(["/bin/true"], check=True)
"""
TRY = """
import json, os, socket, subprocess, sys
lines, names = json.loads(sys.argv[1]), json.loads(sys.argv[2])
done = []
for line in lines:
    try:
        exec(line, {**globals(), **names})
        done.append(line)
    except Exception:
        pass
print(json.dumps(done))
"""
needs_landlock = pytest.mark.xfail(not landlock_version(), reason="this kernel has no Landlock", run=False)


@pytest.fixture
def names(tmp_path: Path) -> dict[str, object]:
    folders = {name: tmp_path / name for name in ("IN", "OUT", "SEEN")}
    for folder in folders.values():
        (folder / "empty").mkdir(parents=True)
        (folder / "file").write_text("precious")
        (folder / "program").write_text("#!/bin/sh\ntrue\n")
        (folder / "program").chmod(0o755)
    return {name: str(folder) for name, folder in folders.items()}


def tried(lines: str, names: dict[str, object]) -> list[str]:
    """The lines that succeed in a process that may write IN and read SEEN."""
    listening = socket.create_server(("127.0.0.1", 0))
    names = {**names, "PORT": listening.getsockname()[1]}
    command = [sys.executable, "-I", "-c", TRY, json.dumps(lines.strip().splitlines()), json.dumps(names)]
    ran = subprocess.run(
        confine_command(command, read=[names["SEEN"]], write=[names["IN"]]), capture_output=True, text=True, check=True
    )
    listening.close()
    return json.loads(ran.stdout)


@needs_landlock
@pytest.mark.parametrize("line", TRIES.strip().splitlines())
def test_a_confined_process_reaches_nothing_else(names: dict[str, object], line: str) -> None:
    if "socket" in line and landlock_version() < landlock.NETWORK_ABI:
        pytest.xfail("this kernel's Landlock knows no network")
    assert tried(line, names) == []


@needs_landlock
def test_folders_where_python_looks_for_modules_are_open_only_where_packages_are_installed(
    names: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(str(names["OUT"]))
    monkeypatch.syspath_prepend(folder)
    lines = 'open(f"{OUT}/file").read()\nos.listdir(OUT)\nopen(f"{OUT}/tool.py").read()'
    assert tried(lines, names) == []
    (folder / "tool.py").write_text("")
    (folder / "tool-1.dist-info").mkdir()
    (folder / "tool-1.dist-info/METADATA").write_text("Name: tool\nVersion: 1\n")
    (folder / "tool-1.dist-info/RECORD").write_text("tool.py,,\ntool-1.dist-info/RECORD,,\n../elsewhere,,\n")
    landlock._installed_package_paths.cache_clear()
    assert tried(lines, names) == lines.splitlines()[1:]


@needs_landlock
def test_a_confined_process_can_do_its_work(names: dict[str, object]) -> None:
    assert tried(MAY, names) == MAY.strip().splitlines()


def test_the_forbidden_lines_succeed_without_confinement(names: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HULLDOWN_CONFINEMENT", "off")
    for line in ('open(f"{OUT}/new", "w")', "os.listdir(OUT)", 'socket.create_connection(("127.0.0.1", PORT), 1)'):
        assert tried(line, names) == [line]


def test_a_kernel_without_landlock_runs_the_unchanged_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landlock, "landlock_version", lambda: 0)
    assert confine_command(["/bin/true", "x"], read=[], write=[]) == ["/bin/true", "x"]


@needs_landlock
@pytest.mark.parametrize("version", range(1, 9))
def test_a_kernel_of_any_version_is_asked_only_for_rights_it_supports(
    names: dict[str, object], monkeypatch: pytest.MonkeyPatch, version: int
) -> None:
    """An older kernel has some of these rights, and refuses requests for the others."""
    asked = min(version, landlock_version())
    code = (
        f"from hulldown.reading.confinement import landlock; landlock.landlock_version = lambda: {asked};"
        f"landlock.confine_this_process({{'write': [{names['IN']!r}]}}); open({names['IN'] + '/new'!r}, 'w').close();"
        f"open({names['OUT'] + '/new'!r}, 'w')"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "PermissionError" in ran.stderr
    assert os.path.exists(f"{names['IN']}/new")
    assert not os.path.exists(f"{names['OUT']}/new")


def test_the_folders_of_an_asset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / "pack" / "scenes"
    deep.mkdir(parents=True)
    (deep / "a.blend").touch()
    (tmp_path / "link.blend").symlink_to(deep / "a.blend")
    assert readable_asset_folders(deep / "a.blend") == [deep, deep.parent]
    assert readable_asset_folders(tmp_path / "link.blend")[:2] == [tmp_path, deep]
    monkeypatch.setenv("HOME", str(deep.parent))
    assert readable_asset_folders(deep / "a.blend") == [deep], "not the user's home"
    assert readable_asset_folders(Path("/srv/a.blend")) == [Path("/srv")]
    assert readable_asset_folders(Path("/srv/models/a.blend")) == [Path("/srv/models")]


@pytest.mark.parametrize("required", [False, True])
def test_missing_confinement_is_announced_once_or_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, required: bool
) -> None:
    monkeypatch.setenv("HULLDOWN_CONFINEMENT", "off")
    monkeypatch.chdir(tmp_path)
    code = main(["inspect", "none.blend", *(["--require-confinement"] if required else [])])
    error = capsys.readouterr().err
    assert code == 2
    assert ("does not exist" in error) != required
    assert error.count("HULLDOWN_CONFINEMENT") >= 1
    assert ("would not be confined" in error) == required
    assert list(tmp_path.iterdir()) == []
