"""A file's sky object isn't rendered, in any format; objects that the config makes ground or obstacles are."""

import json
from pathlib import Path

import pytest

from hulldown.assets.bundle import load_scenery
from hulldown.assets.scenery import Scenery
from hulldown.reading.export import Exported, export
from hulldown.reading.options import Options
from hulldown.tests.blender_plans import run_python

MADE = """
import bpy, sys
from hulldown.tests.blend_parts import cuboid, fresh, instance, link, save
fresh()
kept = bpy.data.collections.new("kept")  # in no scene, but instanced
for name, size in (("Skydome", 400), ("Rock", 2), ("Inner backdrop", 300), ("Inner rock", 3), ("Terrain_N", 100)):
    made = cuboid(name, (size, size, size), (0, 0, 0))
    made.data.name = "Skydome.001" if name == "Terrain_N" else name
    if name.startswith("Inner"):
        bpy.context.scene.collection.objects.unlink(made)
        link(made, kept)
bpy.ops.curve.primitive_bezier_circle_add(radius=90)
bpy.context.object.name, bpy.context.object.data.name = "Ring", "Sky ring"
bpy.context.object.data.bevel_depth = 1.0
instance("carrier", kept)
save(sys.argv[1])
"""
SHOWN = """
import json, sys
import bpy, numpy as np
from hulldown.reading.blender.capture import visit_render
from hulldown.render.blender.scene import Stage
from hulldown.render.messages import SceneryInput
stage = Stage(SceneryInput(sys.argv[1], np.eye(4), *json.loads(sys.argv[2])))
shown = []
def look(depsgraph):
    for instance in depsgraph.object_instances:
        if instance.show_self and instance.object.type == "MESH" and instance.object.data.polygons:
            shown.append(instance.object.name.partition(".")[0])
visit_render(stage.scene, look)
print("shown", json.dumps(sorted(shown)))
"""


def assert_what_is_planned_is_rendered(file: Path, exported: Exported, scenery: Scenery) -> None:
    """In renders of the file and of its tidy twin, which numbers copies when it writes them."""
    planned = sorted(name.partition(".")[0] for name in (*scenery.ground_names, *scenery.instance_names))
    for path, removed in ((file, list(scenery.removed_names)), (exported.tidy, [])):
        shown = run_python("-c", SHOWN, path, json.dumps([scenery.standing_names, removed]))
        assert json.loads(shown.rpartition("shown ")[2]) == planned


@pytest.mark.blender
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        pytest.param(Options(), [], id="names"),
        pytest.param(Options(include=("terrain_n",)), ["Terrain_N"], id="object in include, mesh called like a sky"),
    ],
)
def test_rendered_objects_are_the_planned_ones(tmp_path: Path, options: Options, expected: list[str]) -> None:
    made = tmp_path / "sky.blend"
    run_python("-c", MADE, made)
    exported = export(made, tmp_path, kind="scenery", options=options)
    scenery = load_scenery(exported.bundle)
    assert sorted([*scenery.ground_names, *scenery.instance_names]) == sorted([*expected, "Inner rock", "Rock"])
    assert_what_is_planned_is_rendered(made, exported, scenery)
