"""The file's own sky is not rendered, whichever way the file is; what the config calls ground or obstacle is."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_scenery
from hulldown.reading.export import export
from hulldown.reading.options import Options
from hulldown.render.jobs import SceneryFile

MADE = """
import bpy, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
named = (("Skydome", 400), ("Cloud terrain", 200), ("Rock", 2), ("Inner backdrop", 300), ("Inner rock", 3))
for name, size in named:
    bpy.ops.mesh.primitive_cube_add(size=size)
    bpy.context.object.name = bpy.context.object.data.name = name
bpy.ops.mesh.primitive_cube_add(size=100)
bpy.context.object.name, bpy.context.object.data.name = "Terrain_N", "Skydome.001"
bpy.ops.curve.primitive_bezier_circle_add(radius=90)
bpy.context.object.name, bpy.context.object.data.name = "Ring", "Sky ring"
bpy.context.object.data.bevel_depth = 1.0
kept = bpy.data.collections.new("kept")  # in no scene, but instanced
for obj in [o for o in bpy.data.objects if o.name.startswith("Inner")]:
    bpy.context.scene.collection.objects.unlink(obj)
    kept.objects.link(obj)
carrier = bpy.data.objects.new("carrier", None)
carrier.instance_type, carrier.instance_collection = "COLLECTION", kept
bpy.context.scene.collection.objects.link(carrier)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""
SHOWN = """
import json, sys
import bpy, numpy as np
from hulldown.reading.blender.capture import visit_render
from hulldown.render.blender.scene import Stage
stage = Stage(sys.argv[1], np.eye(4), json.loads(sys.argv[2]))
shown = set()
def look(depsgraph):
    for instance in depsgraph.object_instances:
        if instance.show_self and instance.object.type == "MESH" and instance.object.data.polygons:
            shown.add(instance.object.name)
visit_render(stage.scene, look)
print("shown", json.dumps(sorted(shown)))
"""


def shown(path: Path, standing: list[str]) -> list[str]:
    """What a render is given."""
    command = [sys.executable, "-c", SHOWN, str(path), json.dumps(standing)]
    ran = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    return json.loads(ran.stdout.rpartition("shown ")[2])


@pytest.mark.blender
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        pytest.param(Options(), [], id="names"),
        pytest.param(
            Options(include=("cloud terrain",)), ["Cloud terrain"], id="object in include", marks=pytest.mark.thorough
        ),
        pytest.param(Options(include=("terrain_n",)), ["Terrain_N"], id="object in include, mesh called like a sky"),
        pytest.param(
            Options(exclude=("terrain_n",)),
            ["Terrain_N"],
            id="object in exclude, mesh called like a sky",
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_what_is_planned_is_what_is_rendered(tmp_path: Path, options: Options, expected: list[str]) -> None:
    made = tmp_path / "sky.blend"
    subprocess.run([sys.executable, "-c", MADE, str(made)], check=True, capture_output=True)
    exported = export(made, tmp_path, kind="scenery", options=options)
    scenery = load_scenery(exported.bundle)
    expected = sorted([*expected, "Inner rock", "Rock"])
    assert sorted([*scenery.ground_names, *scenery.instance_names]) == expected
    standing = SceneryFile(made, np.eye(4), scenery).standing
    assert shown(made, standing) == expected
    assert [name.removesuffix(".001") for name in shown(exported.tidy, standing)] == expected
