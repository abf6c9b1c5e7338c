"""Make a scenery that links libraries and has its own textures, and a vehicle as OBJ; run as a script in Blender.

``python linked_worlds.py FOLDER``. Libraries and textures have relative and absolute paths.
"""

import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.tests.builders.blend_parts import collection, cuboid, fresh, from_library, instance, save
from hulldown.tests.builders.node_trees import textured, write_picture
from hulldown.tests.builders.render_worlds import field, gray

FOLDER = Path(sys.argv[1])


def picture(path, color):
    """A checkered picture on disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.tile(np.array(color), (16, 16, 1))
    pixels[::2, ::2] *= 0.3
    write_picture(path, pixels)


def shown(name, path):
    """A material with a picture, referred to by this path, mapped onto the object."""
    return textured(name, bpy.data.images.load(str(path)))


def library(path, texture):
    """A boulder in a collection named like the file."""
    fresh()
    boulder = cuboid("boulder", (5.0, 5.0, 4.0), (0.0, 0.0, 1.0), shown("stone", texture))
    collection(path.stem).objects.link(boulder)


def link(path, *at):
    instance(f"a {path.stem}", from_library(path, "collections", path.stem), at)


def save_absolute(path):
    """Save without making absolute paths relative, which is Blender's default."""
    save(path, relative_remap=False, compress=True)


def main():
    """Write the files."""
    textures = FOLDER / "shared" / "textures"
    colors = {"soil": (0.7, 0.2, 0.1), "near": (0.1, 0.6, 0.1), "far": (0.1, 0.1, 0.7), "skin": (0.9, 0.8, 0.0)}
    for name, color in colors.items():
        picture(textures / f"{name}.png", color)
    near, far = FOLDER / "shared" / "rocks" / "near.blend", FOLDER / "elsewhere" / "far.blend"
    library(near, textures / "near.png")
    save(near)
    library(far, textures / "far.png")
    save_absolute(far)
    scenery = FOLDER / "sceneries" / "field.blend"

    def drape():
        ground = bpy.data.objects["ground"]
        ground.data.materials.clear()
        ground.data.materials.append(shown("soil", textures / "soil.png"))
        for x, y in ((-15.0, 0.0), (15.0, 10.0), (0.0, -20.0)):
            link(near, x, y, 0.0)

    field(scenery, drape=drape)
    for x, y in ((0.0, -15.0), (10.0, 15.0), (-20.0, 0.0)):
        link(far, x, y, 0.0)
    save_absolute(scenery)
    fresh()
    skin = shown("skin", textures / "skin.png")
    cuboid("hull", (6.0, 3.0, 1.5), (0.0, 0.0, 0.75), skin)
    turret = cuboid("turret", (2.6, 2.0, 0.9), (-0.4, 0.0, 1.95), skin)
    cuboid("gun", (4.0, 0.4, 0.4), (2.9, 0.0, 1.95), skin, turret)
    vehicle = FOLDER / "vehicles" / "tank.obj"
    vehicle.parent.mkdir()
    bpy.ops.wm.obj_export(filepath=str(vehicle), path_mode="RELATIVE", forward_axis="NEGATIVE_Z", up_axis="Y")
    gray(FOLDER / "gray.exr")


main()
