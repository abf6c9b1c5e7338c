"""Makes .blend files from random descriptions and reads them as hulldown does; run in Blender, JSON lines in and out.

One process takes thousands of files, since starting Blender takes longer than reading one. A line: what to make, the
bytes to damage, the job. The answer: what the reader has answered.
"""

import contextlib
import json
import os
import sys
import traceback
from pathlib import Path

import bpy

from reading.blender import reader

MAKERS = {
    "cube": lambda: bpy.ops.mesh.primitive_cube_add(),
    "plane": lambda: bpy.ops.mesh.primitive_plane_add(size=50.0),
    "text": lambda: bpy.ops.object.text_add(),
    "curve": lambda: bpy.ops.curve.primitive_bezier_circle_add(),
    "ball": lambda: bpy.ops.object.metaball_add(),
    "empty": lambda: bpy.ops.object.empty_add(),
    "lattice": lambda: bpy.ops.object.add(type="LATTICE"),
    "armature": lambda: bpy.ops.object.armature_add(),
    "light": lambda: bpy.ops.object.light_add(),
    "camera": lambda: bpy.ops.object.camera_add(),
    "bare": lambda: bpy.ops.object.add(type="MESH"),
}


def attempt(action):
    """Blender refuses some of what is drawn, which is its right."""
    with contextlib.suppress(TypeError, ValueError, RuntimeError, AttributeError, OverflowError):
        action()


def make(said, path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    made = []
    for part in said["objects"]:
        MAKERS[part["type"]]()
        obj = bpy.context.object
        made.append(obj)
        obj.name = part["name"]
        obj.location, obj.scale, obj.rotation_euler = part["location"], part["scale"], part["rotation"]
        if obj.type == "MESH" and obj.data.vertices and part["vertex"] is not None:
            obj.data.vertices[0].co = part["vertex"]
        for kind in part["modifiers"]:
            attempt(lambda obj=obj, kind=kind: obj.modifiers.new("m", kind))
        obj.hide_render = part["hidden"]
        if part["collection"]:
            collection = bpy.data.collections.new(part["name"])
            bpy.context.scene.collection.children.link(collection)
            collection.objects.link(obj)
            carrier = bpy.data.objects.new("carrier", None)
            carrier.instance_type, carrier.instance_collection = "COLLECTION", collection
            bpy.context.scene.collection.objects.link(carrier)
    for child, parent in said["parents"]:
        attempt(lambda c=child, p=parent: setattr(made[c % len(made)], "parent", made[p % len(made)]))
    scene = bpy.context.scene
    scene.unit_settings.scale_length = said["unit"]
    scene.frame_set(said["frame"])
    attempt(lambda: bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False))


def damage(path, said):
    """Change some bytes at places given as shares of the file's length, or cut its end off."""
    data = bytearray(path.read_bytes())
    for place, value in said["bytes"]:
        data[int(place * (len(data) - 1))] = value
    path.write_bytes(data[: max(1, round(said["keep"] * len(data)))])


def main():
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        message = json.loads(line)
        job = message["job"]
        try:
            path = Path(job["path"])
            make(message["make"], path)
            damage(path, message["damage"])
            answers.write("reading\n")  # what goes wrong from here on counts
            answers.flush()
            job_file = Path(job["answer"]).with_name("job.json")
            job_file.write_text(json.dumps(job), encoding="utf-8")
            reader.main(str(job_file))
            answer = Path(job["answer"]).read_text(encoding="utf-8")
        except Exception:
            answer = json.dumps({"traceback": traceback.format_exc()})
        answers.write(answer.replace("\n", " ") + "\n")
        answers.flush()


main()
