"""The file's own sky is not rendered, whichever way the file is; what the config calls ground or obstacle is."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from assets.bundle import load_scenery
from render.jobs import SceneryFile
from render.reading.build import Options
from render.reading.export import export

MADE = """
import bpy, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
for name, size in (("Skydome", 400), ("Cloud terrain", 200), ("Rock", 2)):
    bpy.ops.mesh.primitive_cube_add(size=size)
    bpy.context.object.name = bpy.context.object.data.name = name
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""
SHOWN = """
import json, sys
import bpy, numpy as np
from render.scene import Stage
stage = Stage(sys.argv[1], np.eye(4), json.loads(sys.argv[2]))
shown = sorted(o.name for o in stage.scene.objects if o.type == "MESH" and o.data.polygons and not o.hide_render)
print("shown", json.dumps(shown))
"""


def shown(path: Path, standing: list[str]) -> list[str]:
    command = [sys.executable, "-c", SHOWN, str(path), json.dumps(standing)]
    ran = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    return json.loads(ran.stdout.rpartition("shown ")[2])


@pytest.mark.blender
@pytest.mark.parametrize(
    ("include", "expected"), [((), ["Rock"]), (("cloud terrain",), ["Cloud terrain", "Rock"])], ids=["names", "config"]
)
def test_what_is_planned_is_what_is_rendered(tmp_path: Path, include: tuple[str, ...], expected: list[str]) -> None:
    made = tmp_path / "sky.blend"
    subprocess.run([sys.executable, "-c", MADE, str(made)], check=True, capture_output=True)
    exported = export(made, tmp_path, kind="scenery", options=Options(include=include))
    scenery = load_scenery(exported.bundle)
    assert sorted([*scenery.ground_names, *scenery.instance_names]) == expected
    standing = SceneryFile(made, np.eye(4), scenery).standing
    assert shown(made, standing) == expected
    assert [name.removesuffix(".001") for name in shown(exported.tidy, standing)] == expected
