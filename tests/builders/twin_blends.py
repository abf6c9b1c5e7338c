"""Write a .blend of many equal objects, with every kind of object that isn't quite equal; run in Blender.

``python twin_blends.py FOLDER`` reads ``twins.blend`` with all objects evaluated, into the folder ``all``, and with as
few as possible, into ``few``; ``answer.json`` has what both render and the objects that weren't evaluated.
"""

import json
import random
import sys
from dataclasses import asdict
from pathlib import Path

import bpy

from hulldown.blender.opening import open_blend
from hulldown.reading.blender import duplicates, reader
from hulldown.reading.reader_process import reader_job
from hulldown.render.blender.scene import append_twin_and_materials
from hulldown.tests.builders.blend_parts import collection, fresh, instance, mesh, place, save
from hulldown.tests.builders.shapes import CORNERS, QUADS

DRAW = random.Random(0)


def add(name, data, collection=None):
    at = DRAW.uniform(-80, 80), DRAW.uniform(-80, 80), DRAW.uniform(-1, 1)
    return place(name, data, at, collection=collection)


def pairs(name, data, change, count=2):
    """Equal objects, all changed in the same way, so that mistakes show."""
    for number in range(count):
        change(add(f"{name} {number}", data), number)


def copies(stone, red):
    """Objects with separate meshes: two equal ones, and others that differ in one thing each."""

    def sharpen(data):
        data.polygons[0].use_smooth = True

    def tint(data, shown="tint"):
        for name in ("tint", "other"):
            data.color_attributes.new(name, "BYTE_COLOR", "CORNER").data[0].color = (1, 0, 0, 1)
        data.attributes.default_color_name = shown

    def unwrap(data, rendered=0):
        layers = [data.uv_layers.new(name=name) for name in ("one", "other")]
        layers[rendered].active_render = True

    def fold(data):
        corners = data.attributes[".corner_vert"].data
        corners[0].value, corners[1].value = corners[1].value, corners[0].value

    changes = {
        **{"equal": lambda data: None, "equal too": lambda data: None, "sharpened": sharpen, "folded": fold},
        **{"tinted": tint, "tinted otherwise": lambda data: tint(data, "other")},
        **{"unwrapped": unwrap, "unwrapped otherwise": lambda data: unwrap(data, 1)},
        "dented": lambda data: setattr(data.vertices[0], "co", (0, 0, 1e-6)),
        "red": lambda data: data.materials.__setitem__(0, red),
        "noted": lambda data: data.__setitem__("note", 1),
        "spaced": lambda data: setattr(data, "use_auto_texspace", False),
        "named": lambda data: data.attributes.new("a name", "STRING", "FACE"),
        "patterned": lambda data: setattr(data, "texco_mesh", stone),
    }
    for name, change in changes.items():
        data = stone.copy()
        data.name = f"mesh of {name}"
        change(data)
        add(f"spare {name}", data)
    for number in range(2):
        data = stone.copy()
        data.attributes.new("Axtribute", "FLOAT", "POINT")
        add(f"spare unnamed {number}", data)
    add("spare weighed", stone.copy()).vertex_groups.new(name="weights").add([0], 1.0, "REPLACE")


def make():
    fresh()
    edge = [(-100, -100, 0), (100, -100, 0), (100, 100, 0), (-100, 100, 0)]
    place("ground", mesh("ground", edge, [[0, 1, 2, 3]]))
    stone, empty = mesh("stone", CORNERS, QUADS), mesh("empty", [(0, 0, 0)], [])
    stone.materials.append(bpy.data.materials.new("gray"))
    red = bpy.data.materials.new("red")

    def pose(obj, number):
        obj.rotation_mode = ("XYZ", "ZXY", "QUATERNION", "AXIS_ANGLE")[number % 4]
        obj.rotation_euler = [DRAW.uniform(-3, 3) for _ in range(3)]
        obj.rotation_quaternion = [DRAW.uniform(-3, 3) for _ in range(4)]
        obj.rotation_axis_angle = [DRAW.uniform(-3, 3) for _ in range(4)]
        obj.scale = (1, -1 if number % 3 else 1, 0.5)
        obj.delta_location, obj.delta_scale = (0.5, 0, 0), (1, 2, 1)

    pairs("posed", stone, pose, 24)
    pairs("without faces", empty, lambda obj, number: None)

    def child(obj, number):
        obj.parent = bpy.data.objects[f"posed {number}"]

    def swell(obj, number):
        obj.modifiers.new("bevel", "BEVEL").width = 0.1 * (number + 1)

    def follow(obj, number):
        obj.constraints.new("COPY_LOCATION").target = bpy.data.objects[f"posed {number + 4}"]

    def key(obj, number):
        obj.keyframe_insert("location", frame=1)

    def drive(obj, number):
        curve = obj.driver_add("location", 2)
        variable = curve.driver.variables.new()
        variable.type, variable.targets[0].id = "TRANSFORMS", bpy.data.objects[f"posed {number + 6}"]
        curve.driver.expression = variable.name

    def cut(obj, number):
        tool = obj.modifiers.new("cut", "BOOLEAN")
        tool.object, obj.location = bpy.data.objects[f"posed {number + 8}"], (number, 0, 0)

    def dress(obj, number):
        obj.material_slots[0].link, obj.material_slots[0].material = "OBJECT", red if number else None

    def shade(obj, number):
        obj.color, obj.pass_index, obj.visible_shadow = (number % 2, 0, 0, 1), number // 2, number != 3

    def hide(obj, number):
        setattr(obj, ("hide_render", "hide_viewport", "visible_camera", "is_holdout")[number], number != 2)

    def hide_by_eye(obj, number):
        obj.hide_set(True)

    for change in (child, swell, follow, key, drive, cut, dress, hide_by_eye):
        pairs(change.__name__, stone, change)
    copies(stone, red)
    pairs("shade", stone, shade, 5)
    pairs("hide", stone, hide, 4)

    # Collections: one also instanced elsewhere, one inside another, one not rendered, one excluded.
    inner = collection("inner", collection("outer"))
    places = {"instanced": inner, "unrendered": collection("unrendered"), "excluded": collection("out")}
    for name, where in places.items():
        for number in range(3):
            add(f"{name} {number}", stone, where)
    instance("drawn again", bpy.data.collections["outer"], (30, 30, 0))
    bpy.data.collections["unrendered"].hide_render = True
    bpy.context.view_layer.layer_collection.children["out"].exclude = True
    for number in range(2):
        add(f"in two {number}", stone, collection(f"part {number}"))
        bpy.data.collections["part 0"].objects.link(add(f"in the scene and one {number}", stone))


def drawn(path):
    """What a tidy twin renders: pose, mesh, materials, and visibility of each object."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.context.scene.collection.children.link(append_twin_and_materials(str(path))[0])
    found = []
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        thing = each.object
        if thing.type == "MESH" and each.show_self:
            points = [list(vertex.co) for vertex in thing.data.vertices]
            materials = [slot.material and slot.material.name for slot in thing.material_slots]
            look = [list(thing.color), thing.pass_index, thing.visible_camera, thing.visible_shadow]
            found.append(json.dumps([[list(row) for row in each.matrix_world], points, materials, look]))
    return sorted(found)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    make()
    path = folder / "twins.blend"
    save(path, compress=False)
    odd = path.read_bytes()
    assert b"Axtribute" in odd
    path.write_bytes(odd.replace(b"Axtribute", b"A\xfctribute"))  # not UTF-8, as in old files
    answer = {}
    for name, fewest in (("all", 10**9), ("few", 1)):
        (folder / name).mkdir()
        duplicates.MIN_OBJECTS = fewest
        told = reader_job(path, folder / name, kind="scenery")
        job = folder / name / "job.json"
        job.write_text(json.dumps(asdict(told)))
        reader.main(str(job))
        answer[name] = drawn(str(told.file("tidy.blend")))
    taken = {}
    open_blend(str(path), then=lambda: taken.update(duplicates.remove_duplicate_objects()))
    answer["taken"] = sorted(duplicate.name for same in taken.values() for duplicate in same)
    (folder / "answer.json").write_text(json.dumps(answer))
