"""Settings of a .blend have no effect outside it."""

import json

import pytest

from hulldown.tests.blender_plans import run_script


@pytest.mark.blender
def test_no_setting_of_a_file_is_in_force_when_it_is_rendered(tmp_path):
    """The test compares all properties that Blender lists, so it finds new ones of later versions."""
    lines = run_script("file_settings.py", tmp_path).splitlines()
    found = json.loads(next(line[2:] for line in lines if line.startswith("@@")))
    changed = found["changed"]
    for expected in ("file.use_autopack", "scene.view_settings.exposure", "layer.cycles.use_denoising"):
        assert expected in changed
    assert len(changed) > 200
    assert found["objects"] == 1
    assert found["left"] == {}
