"""Make .blend files from descriptions and read them as hulldown does; run in Blender, JSON lines in and out.

One process makes thousands of files, since starting Blender takes longer than reading one. An input line is a
description, the bytes to damage, and the job; an output line is the reader's answer. `blend_cases` has descriptions.
"""

import contextlib
import json
import os
import resource
import sys
import traceback
from functools import partial
from pathlib import Path

import bpy

from hulldown.reading.blender import duplicates, reader
from hulldown.tests.node_trees import node_group

MOST_MEMORY = 8 * 2**30  # a damaged file may claim all memory; other tests check the limits of reading


def attempt(action):
    """Ignore what Blender refuses to make."""
    with contextlib.suppress(TypeError, ValueError, RuntimeError, AttributeError, OverflowError):
        action()


# ---- objects


def of_data(blocks, *kind):
    """An object with new, empty data."""
    bpy.context.scene.collection.objects.link(made := bpy.data.objects.new("x", blocks.new("x", *kind)))
    bpy.context.view_layer.objects.active = made


def of_hair():
    of_data(bpy.data.hair_curves)
    bpy.context.object.data.add_curves([4, 2])


OBJECTS = {
    "cube": lambda: bpy.ops.mesh.primitive_cube_add(),
    "plane": lambda: bpy.ops.mesh.primitive_plane_add(size=50.0),
    "grid": lambda: bpy.ops.mesh.primitive_grid_add(x_subdivisions=6, y_subdivisions=6, size=50.0),
    "tube": lambda: bpy.ops.mesh.primitive_cylinder_add(vertices=12, radius=1.0, depth=2.0),
    "sphere": lambda: bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=1),
    "bare": lambda: of_data(bpy.data.meshes),
    "text": lambda: bpy.ops.object.text_add(),
    "curve": lambda: bpy.ops.curve.primitive_bezier_circle_add(),
    "ball": lambda: bpy.ops.object.metaball_add(),
    "empty": lambda: bpy.ops.object.empty_add(),
    "lattice": lambda: bpy.ops.object.add(type="LATTICE"),
    "armature": lambda: bpy.ops.object.armature_add(),
    "light": lambda: bpy.ops.object.light_add(),
    "camera": lambda: bpy.ops.object.camera_add(),
    "hair": of_hair,
    "points": lambda: of_data(bpy.data.pointclouds),
    "volume": lambda: of_data(bpy.data.volumes),
    "pencil": lambda: of_data(bpy.data.grease_pencils),
}


def add(part):
    """A described object."""
    OBJECTS[part["type"]]()
    obj = bpy.context.object
    obj.name = part["name"]
    obj.location, obj.scale, obj.rotation_euler = part["location"], part["scale"], part["rotation"]
    if obj.type == "MESH" and obj.data.vertices and part["vertex"] is not None:
        obj.data.vertices[0].co = part["vertex"]
    if part["material"] and obj.data and hasattr(obj.data, "materials"):
        attempt(lambda: obj.data.materials.append(material(part["material"], part["name"])))
    for kind in part["modifiers"]:
        attempt(partial(modify, obj, kind))
    for kind in part["extras"]:
        attempt(partial(EXTRAS[kind], obj))
    return obj


def modify(obj, kind):
    """A modifier with cheap settings: slow defaults differ only in amounts."""
    added = obj.modifiers.new("m", kind)
    if kind == "REMESH":
        added.mode, added.octree_depth = "SHARP", 2  # a mesh of 1e20 m has too many voxels
    elif kind == "OCEAN":
        added.resolution = added.viewport_resolution = 2
    elif kind == "PARTICLE_SYSTEM":
        added.particle_system.settings.count = 5
    elif kind == "NODES":
        added.node_group = scatter(obj)


def scatter(obj):
    """A group that adds geometry and an instance of another object, or of the object itself, on its corners."""
    group, given, result = node_group("Geometry")
    info, on_points, join, worn = (
        group.nodes.new(f"GeometryNode{name}")
        for name in ("ObjectInfo", "InstanceOnPoints", "JoinGeometry", "SetMaterial")
    )
    info.inputs["Object"].default_value = bpy.data.objects[0]
    info.inputs["As Instance"].default_value = len(bpy.data.objects) % 2 == 0
    group.links.new(given[0], on_points.inputs["Points"])
    group.links.new(info.outputs["Geometry"], on_points.inputs["Instance"])
    group.links.new(on_points.outputs["Instances"], join.inputs[0])
    if bpy.data.materials:
        worn.inputs["Material"].default_value = bpy.data.materials[0]
        worn.inputs["Selection"].default_value = len(bpy.data.materials) % 2 == 0
    group.links.new(given[0], worn.inputs[0])
    group.links.new(worn.outputs[0], join.inputs[0])
    group.links.new(join.outputs[0], result[0])
    return group


# ---- materials


def material(kind, name):
    """A material named after the kind of its nodes."""
    made = bpy.data.materials.new(f"{kind} {name}")
    made.use_nodes = True
    nodes, link = made.node_tree.nodes, made.node_tree.links.new
    shader, output = nodes.get("Principled BSDF"), nodes.get("Material Output")
    if kind == "bare":
        nodes.clear()
    elif kind == "glass":
        shader.inputs["Transmission Weight"].default_value = 1.0
    elif kind == "clear":
        shader.inputs["Alpha"].default_value = 0.0
    elif kind == "volume":
        link(nodes.new("ShaderNodeVolumePrincipled").outputs[0], output.inputs["Volume"])
        nodes.remove(shader)
    elif kind == "displaced":
        made.displacement_method = "DISPLACEMENT"
        link(nodes.new("ShaderNodeDisplacement").outputs[0], output.inputs["Displacement"])
    elif kind == "holes":  # baked by Cycles
        noise, at = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeUVMap")
        link(at.outputs[0], noise.inputs["Vector"])
        link(noise.outputs[0], shader.inputs["Alpha"])
    elif kind in ("leaves", "missing"):
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.new("leaf", 4, 4, alpha=True)
        if kind == "missing":
            picture.image.source, picture.image.filepath = "FILE", "//none/leaf.png"
        else:
            picture.image.pixels.foreach_set([1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0] * 8)
            picture.image.pack()
        link(picture.outputs["Color"], shader.inputs["Base Color"])
        link(picture.outputs["Alpha"], shader.inputs["Alpha"])
    return made


# ---- what else an object may have


def keyed(obj):
    obj.location.x += 3.0
    obj.keyframe_insert("location", frame=1)
    obj.location.x = float("nan")
    obj.keyframe_insert("location", frame=40)


def constrained(obj):
    constraint = obj.constraints.new("COPY_TRANSFORMS")
    constraint.target = bpy.data.objects[0]


def shaped(obj):
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="swollen")
    key.data[0].co, key.value = (0.0, 0.0, 7.0), 1.0


def carried(obj):
    """Add an empty that instances the object's collection."""
    collection = bpy.data.collections.new(obj.name)
    collection.objects.link(obj)
    carrier = bpy.data.objects.new("carrier", None)
    carrier.instance_type, carrier.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(carrier)


def on_faces(obj):
    obj.instance_type = "FACES"
    obj.use_instance_faces_scale = True


def haired(obj, count, children):
    settings = obj.modifiers.new("hair", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.child_type = "HAIR", count, children
    settings.rendered_child_count = settings.child_percent = 2


def referring(obj):
    """Make an object an instance of something that is itself an instance."""
    if obj.type == "CURVES":
        obj.data.surface = bpy.data.objects[0]
    else:
        obj.data.texco_mesh = bpy.data.meshes[0] if bpy.data.meshes else bpy.data.meshes.new("other")


EXTRAS = {
    "key": keyed,
    "constraint": constrained,
    "shape key": shaped,
    "carried": carried,
    "on faces": on_faces,
    "refers": referring,
    "bald": lambda obj: haired(obj, 0, "NONE"),
    "furry": lambda obj: haired(obj, 4, "INTERPOLATED"),
    "hidden": lambda obj: setattr(obj, "hide_render", True),
    "adaptive": lambda obj: setattr(obj.modifiers.new("s", "SUBSURF"), "use_adaptive_subdivision", True),
}


# ---- files


def make(recipe, path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)  # five times as fast as all settings
    made = [add(part) for part in recipe["objects"]]
    for child, parent in recipe["parents"] if made else []:
        attempt(lambda c=child, p=parent: setattr(made[c % len(made)], "parent", made[p % len(made)]))
    scene = bpy.context.scene
    scene.unit_settings.scale_length = recipe["unit"]
    scene.frame_set(recipe["frame"])
    attempt(lambda: bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False))


def damage(path, recipe):
    """Change some bytes at positions given as shares of the file's length, or cut off its end."""
    data = bytearray(path.read_bytes())
    for place, value in recipe["bytes"]:
        data[int(place * (len(data) - 1))] = value
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
            duplicates.FEWEST = message["make"]["fewest"]
            reader.main(str(job_file))
            answer = Path(job["folder"], "answer.json").read_text(encoding="utf-8")
        except Exception:
            answer = json.dumps({"traceback": traceback.format_exc()})
        answers.write(answer.replace("\n", " ") + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
