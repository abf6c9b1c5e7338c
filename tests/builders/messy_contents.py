"""Files with more, less, or worse content than a vehicle: clutter, lost files, scripts, broken numbers. In Blender."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import bpy

from hulldown.tests.builders.blend_parts import collection, empty, fresh, from_library, link, place, save
from hulldown.tests.builders.messy_parts import CASES, FOLDER, box, case, tank
from hulldown.tests.builders.node_trees import node_group


@case
def clutter():
    """Typical clutter around a vehicle; two floors have meaningless names."""
    tank()
    box("Cabin_Floor", (2, 2, 0.1), (-1.5, 0, 1.6))
    box("Plane.004", (0.05, 2.5, 0.8), (-3.4, 0, 1))
    litter = [
        box("Floor", (40, 40, 0.1), (0, 0, -0.05)),
        box("Object_17", (90, 70, 0.01), (3, 2, -0.2)),
        box("shadowCatcher.002", (9, 9, 0.02), (0, 0, 0.3)),
        box("UCX_Hull_01", (6.4, 3.4, 3), (0, 0, 1.5)),
        box("Backdrop", (0.2, 30, 12), (-15, 0, 6)),
        box("ground", (2, 1, 0.02), (0, 0, 0.49)),
        box("ref_side", (9, 0.01, 5), (0, 6, 2)),
    ]
    caught = box("Catcher", (8, 8, 0.1), (0, 0, 0.4))
    caught.is_shadow_catcher = True
    ghost = box("Ghost", (4, 4, 4), (0, 0, 3))
    ghost.visible_camera = False
    place("Key", bpy.data.lights.new("Key", "AREA"))
    place("Camera", bpy.data.cameras.new("Camera"))
    return {"hide": [o.name for o in [*litter, caught, ghost]]}


@case
def textured():
    """Pictures that exist, are packed, missing, missing in a node group, and missing on a dropped object."""
    picture = bpy.data.images.new("there", 4, 4)
    picture.filepath_raw, picture.file_format = str(FOLDER / "there.png"), "PNG"
    picture.save()
    packed = bpy.data.images.new("packed", 4, 4)
    packed.pack()
    hull, turret, _ = (box(n, (4, 2, 1), (0, 0, i)) for i, n in enumerate(("Hull", "Turret", "Spare")))
    floor = box("Floor", (60, 60, 0.1), (0, 0, -0.6))
    for obj, images in (
        (hull, [picture, packed]),
        (turret, [image("//textures/gone.png")]),
        (floor, [image("//floor_gone.png")]),
    ):
        material = bpy.data.materials.new(obj.name)
        for each in images:
            node = material.node_tree.nodes.new("ShaderNodeTexImage")
            node.image = each
        obj.data.materials.append(material)
    group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    group.nodes.new("ShaderNodeTexImage").image = image("//nested_gone.exr")
    tree = bpy.data.materials["Turret"].node_tree
    tree.nodes.new("ShaderNodeGroup").node_tree = group
    tree.links.new(tree.nodes.new("ShaderNodeTexImage").outputs[0], tree.nodes["Principled BSDF"].inputs[0])  # no image
    return {"hide": ["Floor"]}


def image(path):
    made = bpy.data.images.new(Path(path).name, 1, 1)
    made.source, made.filepath = "FILE", path
    return made


@case
def lost_library():
    """A wheel comes from a library that is gone."""
    tank()
    link(from_library(FOLDER / "soon_gone.blend", "objects", "Wheel", relative=True))
    return {}


@case
def malicious():
    """A text that registers itself and a driver, both of which would write a file."""
    turret, _ = tank()
    order = f"open({str(FOLDER / 'ran')!r}, 'w').write('x')"
    text = bpy.data.texts.new("startup.py")
    text.from_string(f"import bpy\n{order}\nbpy.app.driver_namespace['f'] = lambda: {order}\n")
    text.use_module = True
    driver = turret.driver_add("rotation_euler", 2).driver
    driver.type, driver.expression = "SCRIPTED", f"{order} or 1.5"
    return {}


@case
def nothing():
    """A camera, a lamp, and a hidden box."""
    place("Camera", bpy.data.cameras.new("Camera"))
    off = collection("Off")
    box("Hull", (6, 3, 1), collection=off)
    off.hide_render = True
    return {"truth": False}


@case
def odd_ones():
    """Two scenes, two view layers, and meshes that only Cycles changes."""
    bpy.data.scenes.new("Other")
    bpy.context.scene.view_layers.new("Second")
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    hull.modifiers.new("s", "SUBSURF").use_adaptive_subdivision = True
    rough = box("Rough", (1, 1, 1), (0, 0, 2))
    material = bpy.data.materials.new("rough")
    material.displacement_method = "DISPLACEMENT"
    tree = material.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeDisplacement").outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
    rough.data.materials.append(material)
    furry = box("Furry", (1, 1, 1), (2, 0, 2))
    furry.modifiers.new("p", "PARTICLE_SYSTEM")
    furry.particle_systems[0].settings.type = "HAIR"
    strands = place("Strands", bpy.data.hair_curves.new("Strands"))
    strands.data.add_curves([4, 4])
    strands.data.points.foreach_set("position", [float(i) for i in range(24)])
    return {"truth": False}


def unrendered(build):
    """Build a case that isn't rendered."""
    build()
    return {"truth": False}


def body(*where, **more):
    return box("Body", (2, 2, 2), *where, **more)


def squashed_gun():
    """A gun without a muzzle, saved while the turret was edited."""
    body()
    turret = box("Turret", (2, 2, 2), (0, 0, 2))
    bpy.context.view_layer.objects.active = turret
    bpy.ops.object.mode_set(mode="EDIT")
    box("Gun", (2, 2, 2), (0, 0, 2), scale=(0, 0, 0))


def haired(count, *where):
    obj = body(*where)
    obj.modifiers.new("Hair", "PARTICLE_SYSTEM")
    obj.data.materials.append(bpy.data.materials.new("Fur"))
    obj.particle_systems[0].settings.type, obj.particle_systems[0].settings.count = "HAIR", count


def names():
    """Names that aren't UTF-8; see messy_export.py."""
    obj = box("Nxmd", (2, 2, 2))
    obj.data.name = "Dxta"
    obj.data.materials.append(bpy.data.materials.new("Mxterial"))
    collection("Cxllection").objects.link(obj)
    obj.modifiers.new("Pxrticles", "PARTICLE_SYSTEM")
    obj.particle_systems[0].name = "Pxrticles"
    bpy.context.scene.name = "Scxne"
    bpy.context.scene.view_layers[0].name = "Lxyer"


def empty_scene():
    """Everything is in a scene that isn't the active one."""
    body()
    bpy.context.window.scene = bpy.data.scenes.new("Empty")


def instances_without_end():
    group, _, result = node_group("Geometry")
    points, on_points = group.nodes.new("GeometryNodePoints"), group.nodes.new("GeometryNodeInstanceOnPoints")
    points.inputs["Count"].default_value = 100_000_000
    group.links.new(points.outputs[0], on_points.inputs["Points"])
    group.links.new(group.nodes.new("GeometryNodeMeshCube").outputs[0], on_points.inputs["Instance"])
    group.links.new(on_points.outputs[0], result[0])
    modifier = body().modifiers.new("many", "NODES")
    modifier.show_viewport = False  # saving would make all instances
    modifier.node_group = group


def library():
    """An object linked from a file that will be a FIFO."""
    box("Linked", (2, 2, 2))
    save(FOLDER / "lib.blend")
    fresh()
    body()
    link(from_library(FOLDER / "lib.blend", "objects", "Linked", relative=True))


def font():
    """A text whose font will be a FIFO."""
    bpy.ops.object.text_add()
    source = next(Path(bpy.utils.system_resource("DATAFILES")).rglob("*.woff2"))
    (FOLDER / "font.woff2").write_bytes(source.read_bytes())
    bpy.context.object.data.font = bpy.data.fonts.load(str(FOLDER / "font.woff2"))


# Cases that aren't rendered. The bytes of the files of two are damaged afterwards; see messy_export.py.
ODD = {
    "nan_location": lambda: body((math.nan, 0, 0)),
    "far_location": lambda: body((0, 1e20, 0)),
    "nan_vertices": lambda: body(shift=(math.nan, 0, 0)),
    "nan_empty": lambda: (body(), empty("pivot", (0, 0, math.nan))),
    "nan_strands": lambda: haired(3, (math.nan, 0, 0)),  # strands are read before their mesh
    "bald": lambda: haired(0),  # hair without strands crashed Blender
    "hairy_body": lambda: haired(3),  # hair with a material
    "no_known_tree": lambda: body().data.materials.append(bpy.data.materials.new("Plain")),
    **{"squashed_gun": squashed_gun, "names": names, "empty_scene": empty_scene, "font": font},
    **{"instances_without_end": instances_without_end, "library": library, "library_compressed": library},
}
CASES |= {name: partial(unrendered, build) for name, build in ODD.items()}
