"""A planned image as a .blend file: rendered in Blender, it's the dataset's picture, without the files it's made of."""

import shutil

import numpy as np
import pytest

from hulldown.cli import main
from hulldown.render.supervisor import render_remaining_images
from hulldown.tests.builders.blender_plans import make_plan, pixels, run_python
from hulldown.verbs.output import DONE, MISTAKE

pytestmark = pytest.mark.blender
SCRIPT = "linked_worlds.py"
# What a user does: open the file, and press F12.
F12 = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.context.scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
"""


def test_a_saved_scene_renders_the_picture_of_the_dataset(written, tmp_path, capsys):
    worlds = shutil.copytree(written, tmp_path / "worlds")
    plan = make_plan(
        worlds,
        assets={
            "vehicles": [
                {"path": "vehicles/tank.obj", "category": "tank", "paint": [{"materials": ["*"], "colors": ["#ff8800"]}]}
            ],
            "sceneries": [{"path": "sceneries/field.blend"}],
        },
        budget={"images_per_class": 2, "images_per_position": 1},
        camera={
            "intrinsics": {"fx": 80.0, "fy": 80.0, "cx": 50.0, "cy": 28.0},
            "distortion": {"k1": -0.1, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0},
        },
        placement={"vehicles_per_image": 2, "companion_distance": [9.0, 20.0]},
        weather={"rain": 1.0},
    )
    render_remaining_images(plan.path, tmp_path / "dataset")
    expected = [pixels(tmp_path / "dataset" / row.file_name) for row in plan]
    words = ["blend", str(plan.path), "-o", str(tmp_path / "second.blend"), "--image"]
    assert main([*words, "2"]) == DONE
    assert main([*words, "1"]) == MISTAKE
    assert "exists and isn't a scene by hulldown" in capsys.readouterr().err
    worlds.rename(tmp_path / "moved")  # its textures, too
    run_python("-c", F12, tmp_path / "second.blend", tmp_path / "second.png")
    assert np.array_equal(pixels(tmp_path / "second.png"), expected[1])
    assert not np.array_equal(*expected)
