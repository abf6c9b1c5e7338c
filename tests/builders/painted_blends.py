"""Make a vehicle whose materials weren't made to be painted; run as a script, with a folder to write into.

An image texture, a shader inside a group that two materials share, a material of an object's slot over its mesh's, a
linked material named like one of the scenery's, and yellow tires, which must stay yellow.
"""

import math
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.tests.builders.blend_parts import cuboid, fresh, from_library, save
from hulldown.tests.builders.node_trees import grouped, principled, shader_group, textured


def matt(name, color):
    return principled(name, color, 1.0)


def lined(name):
    """A dark texture with bright lines."""
    image = bpy.data.images.new(name, 64, 64)
    pixels = np.full((64, 64, 4), 0.3, np.float32)
    pixels[::16, :, :3] = pixels[:, ::16, :3] = 0.8
    pixels[..., 3] = 1.0
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return textured(name, image, roughness=1.0)


def main(folder):
    fresh()
    stone = matt("stone", (0.4, 0.4, 0.4))
    stone.use_fake_user = True
    save(folder / "library.blend")
    fresh()
    group = shader_group(1.0)
    cuboid("hull", (6.0, 3.0, 1.2), (0.0, 0.0, 1.2), lined("Skin"))
    cuboid("turret", (2.6, 2.0, 0.7), (-0.4, 0.0, 2.15), grouped("soil", group, (0.2, 0.2, 0.2)))
    cuboid("gun", (4.0, 0.4, 0.4), (2.9, 0.0, 2.15), grouped("Gun", group, (0.2, 0.2, 0.2)))
    for side, y in (("left", 1.7), ("right", -1.7)):
        fender = cuboid(f"fender {side}", (5.0, 0.4, 0.3), (0.0, y, 1.5), matt("Mesh", (0.0, 1.0, 0.0)))
        fender.material_slots[0].link = "OBJECT"
        fender.material_slots[0].material = matt("Slot", (0.3, 0.3, 0.3))
    cuboid("hatch", (1.8, 1.4, 0.3), (-0.6, 0.0, 2.65), from_library(folder / "library.blend", "materials", "stone"))
    tire = matt("Tire", (0.8, 0.6, 0.0))
    for x in (-2.2, 0.0, 2.2):
        for y in (-1.4, 1.4):
            bpy.ops.mesh.primitive_cylinder_add(radius=0.6, depth=0.5, location=(x, y, 0.6), rotation=(math.pi / 2, 0, 0))
            bpy.context.object.name = "wheel"
            bpy.context.object.data.materials.append(tire)
    save(folder / "odd.blend")


main(Path(sys.argv[1]))
