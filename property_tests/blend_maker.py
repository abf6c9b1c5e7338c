"""Make odd .blend files and read them as hulldown does; run in Blender with a folder, JSON lines in and out.

One process makes thousands of files, since starting Blender takes longer than reading one. An input line has the name
of one of the messy files, changes to its objects, the bytes to damage, and the job; an output line is the reader's
answer. test_blend_files describes them.
"""

import contextlib
import json
import os
import resource
import sys
import traceback
from pathlib import Path

import bpy

from hulldown.blender.add_nodes import add_node
from hulldown.reading.blender import duplicates, reader
from hulldown.tests.builders.blend_parts import instance, place
from hulldown.tests.builders.messy_blends import CASES
from hulldown.tests.builders.messy_parts import scatter
from hulldown.tests.builders.node_trees import principled, shader_of

MOST_MEMORY = 8 * 2**30  # a damaged file may claim all memory; other tests check the limits of reading


def dress(obj, kind):
    """Give an object another material, named after its nodes."""
    material = principled(kind, (0.5, 0.5, 0.5))
    tree, shader = material.node_tree, shader_of(material)
    if kind == "bare":
        tree.nodes.clear()
    elif kind == "glass":
        shader.inputs["Transmission Weight"].default_value = 1.0
    elif kind == "holes":  # baked by Cycles
        noise = add_node(tree, "TexNoise", {"Vector": add_node(tree, "UVMap").outputs[0]})
        tree.links.new(noise.outputs[0], shader.inputs["Alpha"])
    elif kind == "leaves":
        image = bpy.data.images.new("leaf", 4, 4, alpha=True)
        image.pixels.foreach_set([1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0] * 8)
        image.pack()
        tree.links.new(add_node(tree, "TexImage", image=image).outputs["Alpha"], shader.inputs["Alpha"])
    obj.data.materials.append(material)


def modify(obj, kind):
    """Add a modifier with cheap settings: slow defaults differ only in amounts."""
    added = obj.modifiers.new("m", kind)
    if kind == "REMESH":
        added.mode, added.octree_depth = "SHARP", 2  # a mesh of 1e20 m has too many voxels
    elif kind == "OCEAN":
        added.resolution = added.viewport_resolution = 2
    elif kind == "PARTICLE_SYSTEM":
        added.particle_system.settings.count = 5
    elif kind == "NODES":
        added.node_group = scatter("of the first", bpy.data.objects[0])


def add_hair(obj, count):
    settings = obj.modifiers.new("hair", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.child_type = "HAIR", count, "INTERPOLATED" if count else "NONE"
    settings.rendered_child_count = settings.child_percent = 2


def add_kind(_, blocks):
    """Add an object with empty data of this kind."""
    made = getattr(bpy.data, blocks).new("x", *(["POINT"] if blocks == "lights" else []))
    place("x", made)


def carry(obj, _):
    """Add an empty that instances the object's collection."""
    shown = bpy.data.collections.new(obj.name)
    shown.objects.link(obj)
    instance("carrier", shown)


def refer(obj, _):
    """Make evaluated data refer to other evaluated data."""
    if obj.type == "CURVES":
        obj.data.surface = bpy.data.objects[0]
    else:
        obj.data.texco_mesh = bpy.data.meshes[0]


CHANGES = {
    "dress": dress,
    "modify": modify,
    "add hair": add_hair,
    "add": add_kind,
    "carry": carry,
    "refer": refer,
    "move a vertex": lambda obj, to: setattr(obj.data.vertices[0], "co", to),
    "hang on": lambda obj, i: setattr(obj, "parent", bpy.data.objects[i % len(bpy.data.objects)]),
    "follow": lambda obj, _: setattr(obj.constraints.new("COPY_TRANSFORMS"), "target", bpy.data.objects[0]),
}


def make(recipe, path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)  # five times as fast as all settings
    CASES[recipe["case"]]()
    for number, change, value in recipe["changes"]:
        obj = bpy.data.objects[number % len(bpy.data.objects)]
        # Blender refuses some of them.
        with contextlib.suppress(TypeError, ValueError, RuntimeError, AttributeError, OverflowError, IndexError):
            CHANGES[change](obj, value) if change in CHANGES else setattr(obj, change, value)
    bpy.context.scene.unit_settings.scale_length = recipe["unit"]
    bpy.context.scene.frame_set(recipe["frame"])
    with contextlib.suppress(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)


def damage(path, recipe):
    """Change some bytes at positions given as shares of the file's length, or cut off its end."""
    data = bytearray(path.read_bytes())
    for share, value in recipe["bytes"]:
        data[int(share * (len(data) - 1))] = value
    path.write_bytes(data[: max(1, round(recipe["keep"] * len(data)))])


def main():
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY, MOST_MEMORY))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for line in sys.stdin:
        message = json.loads(line)
        job = message["job"]
        try:
            path = Path(job["path"])
            path.unlink(missing_ok=True)
            make(message["make"], path)
            damage(path, message["damage"])
            answers.write("reading\n")  # errors from here on count
            answers.flush()
            job_file = Path(job["folder"], "job.json")
            job_file.write_text(json.dumps(job), encoding="utf-8")
            duplicates.MIN_OBJECTS = message["make"]["fewest"]
            reader.main(str(job_file))
            answer = Path(job["folder"], "answer.json").read_text(encoding="utf-8")
        except Exception:
            answer = json.dumps({"traceback": traceback.format_exc()})
        answers.write(answer.replace("\n", " ") + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
