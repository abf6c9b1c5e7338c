"""Failures of the exporting process: crash, missing Blender, no answer."""

import os
from pathlib import Path

import pytest

import hulldown.reading.reader_process
from hulldown.base.errors import AssetError
from hulldown.reading.reader_process import export_asset


@pytest.mark.parametrize(
    ("script", "error", "message"),
    [
        ("kill -SEGV $$", AssetError, r"tank\.blend: Blender crashed reading it \(signal 11\); open it in Blender"),
        (
            "echo \"ModuleNotFoundError: No module named 'bpy'\" >&2; exit 1",
            AssetError,
            r"needs Blender to be read; install hulldown\[blender\]",
        ),
        pytest.param(
            "echo 'ZeroDivisionError: it was us'; exit 1", AssetError, "it was us; please report it, with", id="a bug of ours"
        ),
        pytest.param("exit 3", AssetError, "reading it failed: exit code 3", id="the answer of an earlier export is not used"),
    ],
)
def test_a_process_without_an_answer_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, error: type[Exception], message: str
) -> None:
    blend, program = tmp_path / "tank.blend", tmp_path / "python"
    blend.write_bytes(b"BLENDER17-01v0500")
    (tmp_path / "answer.json").write_text('{"error": {"problem": "old", "remedy": null}}')
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(hulldown.reading.reader_process.sys, "executable", os.fspath(program))
    with pytest.raises(error, match=message):
        export_asset(blend, tmp_path)
