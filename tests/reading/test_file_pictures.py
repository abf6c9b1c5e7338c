"""What Cycles draws of an open file was read, or a doubt names it."""

import json
from pathlib import Path

import pytest

from hulldown.tests.builders.blender_plans import run_python

SCRIPT = """
import json, sys
from dataclasses import replace
from pathlib import Path
import bpy, numpy as np
from hulldown.reading.blender.depsgraph import evaluate_scene
from hulldown.reading.blender.file_pictures import lost_geometry_doubts

bpy.ops.wm.read_factory_settings(use_empty=True)
for name, at in (("hull", (0, 0, 1)), ("turret", (0.4, 0, 2.2))):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.0, location=at)
    bpy.context.object.name = name
    bpy.context.object.modifiers.new("s", "SUBSURF").render_levels = 2
drawn = evaluate_scene(bpy.context.scene, meters_from_file=np.eye(4), duplicates={}, texture_size=64)
whole, moved = drawn.pieces, np.eye(4)
moved[2, 3] = 0.3
crate = (replace(whole[1].chain[0], name="crate"),)

def doubts_about(pieces, kind="vehicle", **more):
    drawn.pieces, up = pieces, np.array([0.0, 0.0, 1.0])
    given = {"absent": (), "drop": (), **more}
    return [[d.kind, d.text] for d in lost_geometry_doubts(drawn, up=up, kind=kind, picture=Path(sys.argv[1]), **given)]

print("FOUND", json.dumps({
    "whole": doubts_about(whole) + doubts_about(whole, "scenery"),
    "dropped": doubts_about(whole[:1], drop=["turret"]),
    "lost": doubts_about(whole[:1]),
    "lost scenery": doubts_about(whole[:1], "scenery"),
    "moved": doubts_about([whole[0], replace(whole[1], pose=moved @ whole[1].pose)]),
    "added": doubts_about([*whole, replace(whole[1], chain=crate, pose=whole[1].pose + 3 * np.eye(4, k=3))]),
}))
"""


@pytest.mark.blender
def test_lost_and_added_objects_are_named_with_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "differences.png"
    out = run_python("-c", SCRIPT, picture)
    found = json.loads(out.rpartition("FOUND ")[2].splitlines()[0])
    assert found["whole"] == found["dropped"] == []
    for case, name in (("lost", "turret"), ("lost scenery", "turret"), ("moved", "turret"), ("added", "crate")):
        ((kind, text),) = found[case]
        assert (kind, repr(name) in text) == ("lost", True), case
    assert picture.is_file()
