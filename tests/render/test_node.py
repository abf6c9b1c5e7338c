"""Files that a render reads, which the workers of a cluster must see."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from hulldown.base.code import package_versions
from hulldown.render.cluster_pool import shared_file_stamps, worker_refusal_reason
from hulldown.tests.builders.render_plans import cube_library


@pytest.fixture
def library(tmp_path):
    """A scenery that refers to its texture, to a secret elsewhere, and to a link to that."""
    folder, secret = tmp_path / "pack" / "worlds" / "a", tmp_path / "secrets" / "passwords"
    for path in (secret, folder / "void.blend", folder / "bark.png", folder / "cube.blend", folder / "sky.exr"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.name)
    (folder / "link.png").symlink_to(secret)
    named = (folder / "bark.png", folder / "bark.<UDIM>.png", secret, folder / "link.png")
    made = cube_library(folder)
    void = replace(made.sceneries["void"], files=tuple(map(str, named)))
    return replace(made, sceneries={"void": void})


@pytest.mark.parametrize("added", [False, True])
def test_a_blend_cannot_choose_what_a_worker_must_see_unless_the_user_adds_its_folder(library, tmp_path, monkeypatch, added):
    if added:
        monkeypatch.setenv("HULLDOWN_READ", str(tmp_path / "secrets"))
    names = {Path(path).name for path in shared_file_stamps(library)}
    assert names == {"void.blend", "cube.blend", "sky.exr", "bark.png", *(["passwords", "link.png"] if added else [])}


def test_a_worker_that_lacks_a_file_or_has_another_one_is_refused(library, tmp_path):
    files, texture = shared_file_stamps(library), tmp_path / "pack/worlds/a/bark.png"
    client, changed = package_versions("bpy"), texture.stat().st_mtime
    assert worker_refusal_reason(client, False, files) == ""
    os.utime(texture, (changed, changed - 9))
    assert worker_refusal_reason(client, False, files).startswith(f"sees another {texture}: all machines must share it")
    texture.unlink()
    assert worker_refusal_reason(client, False, files).startswith(f"cannot read {texture}: all machines must share it")
