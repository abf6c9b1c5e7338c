"""Failures of the exporting process: crash, missing Blender, no answer."""

import os
from pathlib import Path

import pytest

import hulldown.reading.export
from hulldown.geometry.errors import AssetError
from hulldown.reading.export import export


@pytest.fixture
def blend(tmp_path: Path) -> Path:
    path = tmp_path / "tank.blend"
    path.write_bytes(b"BLENDER17-01v0500")
    return path


def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """A program in place of Python."""
    program = tmp_path / "python"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(hulldown.reading.export.sys, "executable", os.fspath(program))


def test_a_crash_of_blender_is_a_one_line_error(blend: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, "kill -SEGV $$")
    with pytest.raises(AssetError) as caught:
        export(blend, tmp_path)
    assert str(caught.value).startswith(f"{blend}: Blender crashed reading it (signal 11); open it in Blender")


def test_the_error_without_blender_tells_what_to_install(
    blend: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(tmp_path, monkeypatch, "echo \"ModuleNotFoundError: No module named 'bpy'\" >&2; exit 1")
    with pytest.raises(AssetError, match=r"needs Blender to be read; install hulldown\[blender\]"):
        export(blend, tmp_path)


def test_our_bugs_are_not_user_errors(blend: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, "echo 'ZeroDivisionError: it was us'; exit 1")
    with pytest.raises(RuntimeError, match="it was us"):
        export(blend, tmp_path)


def test_the_answer_of_an_earlier_export_is_not_used(
    blend: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "answer.json").write_text('{"error": {"problem": "old", "remedy": null}}')
    stand_in(tmp_path, monkeypatch, "exit 3")
    with pytest.raises(RuntimeError, match="reading it failed"):
        export(blend, tmp_path)
