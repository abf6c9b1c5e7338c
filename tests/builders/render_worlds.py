"""Write the small files of the render tests into a folder; run as a script."""

import math
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node
from hulldown.reading.blender.hdri_picture import _write_radiance_exr
from hulldown.tests.builders.blend_parts import cuboid, empty, fresh, gather, mesh, place, save
from hulldown.tests.builders.node_trees import material_of, principled, shader_of, write_picture

EVIL = """
import pathlib
pathlib.Path({path!r}).write_text("a script of the file has run")
"""


def glowing(name, color):
    """A material with the same color from everywhere in any light, so that its pixels can be counted."""
    return _of_one_shader(name, "Emission", color)


def diffuse(name, color):
    """A Lambertian material."""
    return _of_one_shader(name, "BsdfDiffuse", color)


def _of_one_shader(name, kind, color):
    return material_of(name, lambda tree: add_node(tree, kind, {"Color": (*color, 1.0)}).outputs[0])


def tank(path):
    fresh()
    pink = glowing("pink", (1.0, 0.0, 1.0))
    cuboid("hull", (6.0, 3.0, 1.5), (1.0, 0.5, 0.75), pink)
    turret = cuboid("turret", (2.6, 2.0, 0.9), (0.6, 0.5, 1.95), pink)
    cuboid("gun", (4.0, 0.4, 0.4), (3.9, 0.5, 1.95), pink, turret)
    bpy.ops.mesh.primitive_plane_add(size=80.0)
    bpy.context.object.name = "floor"
    save(path)


def field(path, *, unit=1.0, center=(0.0, 0.0, 0.0), drape=None):
    """Rolling ground of 80 m with boulders, in any unit and at any place."""
    fresh()
    bpy.context.scene.unit_settings.scale_length = unit
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=40, y_subdivisions=40, size=80.0)
    ground = bpy.context.object
    ground.name = "ground"
    for vertex in ground.data.vertices:
        vertex.co.z = 1.2 * math.sin(vertex.co.x / 9.0) * math.cos(vertex.co.y / 7.0)
    ground.data.materials.append(principled("soil", (0.3, 0.25, 0.15), 1.0))
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(-35.0, 35.0, (12, 2)):
        cuboid("boulder", (3.0, 2.0, 2.5), (x, y, 1.0), principled("stone", (0.4, 0.4, 0.4), 1.0))
    root = empty("all", center, scale=(1.0 / unit,) * 3)
    for obj in list(bpy.context.scene.objects):
        if obj is not root and obj.parent is None:
            obj.parent = root
    gather()
    bpy.ops.object.camera_add(location=(0.0, 0.0, 5.0))
    bpy.ops.object.light_add(type="SUN")
    if drape:
        drape()
    save(path)


def trees(folder):
    """Sixty crossed pairs of cards cut out by a texture of leaves, taller than a tank."""

    def drape():
        rng = np.random.default_rng(1)
        rgba = np.full((64, 64, 4), (0.1, 0.3, 0.05, 0.0), dtype=np.float32)
        rgba[..., 3] = np.kron(rng.random((16, 16)) < 0.5, np.ones((4, 4)))
        leaves = bpy.data.images.load(str(write_picture(folder / "leaves.png", rgba)))
        leaves.filepath = "//leaves.png"
        material = principled("leaves", (0.1, 0.3, 0.05), 1.0)
        texture = add_node(material.node_tree, "TexImage", image=leaves, interpolation="Closest")
        material.node_tree.links.new(texture.outputs["Alpha"], shader_of(material).inputs["Alpha"])
        corners = [(-2, 0, 0), (2, 0, 0), (2, 0, 5), (-2, 0, 5), (0, -2, 0), (0, 2, 0), (0, 2, 5), (0, -2, 5)]
        card = mesh("tree", corners, [(0, 1, 2, 3), (4, 5, 6, 7)])
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)] * 2, dtype=np.float32)
        card.uv_layers.new().uv.foreach_set("vector", square.ravel())
        card.materials.append(material)
        for x, y in rng.uniform(-36.0, 36.0, (60, 2)):
            z = 1.2 * math.sin(x / 9.0) * math.cos(y / 7.0) - 0.1
            place("tree", card, (x, y, z), rot=(0.0, 0.0, rng.uniform(0.0, 6.3)))

    return drape


def leaking():
    """Settings of a file that could change the pictures of other files."""
    scene = bpy.context.scene
    render = scene.render
    render.resolution_percentage, render.film_transparent, render.use_border = 50, True, True
    render.use_crop_to_border, render.border_max_x = True, 0.5
    render.pixel_aspect_x, render.use_stamp, render.use_motion_blur = 2.0, True, True
    render.use_simplify, render.simplify_subdivision_render = True, 0
    render.image_settings.file_format, render.image_settings.color_mode = "JPEG", "BW"
    render.use_multiview, render.dither_intensity, render.filter_size = True, 2.0, 9.0
    scene.cycles.film_exposure, scene.cycles.filter_width, scene.cycles.max_bounces = 5.0, 8.0, 0
    scene.cycles.sample_clamp_direct, scene.cycles.use_fast_gi = 0.1, True
    scene.view_settings.exposure, scene.view_settings.gamma, scene.view_settings.view_transform = 3.0, 2.0, "Raw"
    scene.view_settings.use_curve_mapping = True
    layer = scene.view_layers[0]
    layer.material_override, layer.samples = principled("override", (1.0, 0.0, 0.0), 1.0), 1
    scene.view_layers.new("second")
    marker = scene.timeline_markers.new("cut", frame=1)
    marker.camera = next(o for o in scene.objects if o.type == "CAMERA")
    scene.world = bpy.data.worlds.new("theirs")
    tree = bpy.data.node_groups.new("compositor", "CompositorNodeTree")
    scene.compositing_node_group = tree  # an empty compositor makes black pictures
    scene.background_set = bpy.data.scenes.new("set")
    layer.cycles.use_denoising = False
    scene.view_settings.keyframe_insert("exposure")
    bpy.data.use_autopack = True


def evil(folder):
    """Scripts and drivers that would write a file if they ran."""

    def drape():
        text = bpy.data.texts.new("evil.py")
        text.write(EVIL.format(path=str(folder / "registered")))
        text.use_module = True
        ground, world = bpy.data.objects["ground"], bpy.data.worlds.new("evil")
        bpy.context.scene.world = world
        call = f"__import__('pathlib').Path({str(folder / 'driven')!r}).write_text('x')"
        for owner, prop, index in ((ground, "location", 2), (ground, "rotation_euler", 2), (world, "color", 0)):
            driver = owner.driver_add(prop, index).driver
            driver.type, driver.expression = "SCRIPTED", call

    return drape


def sky(path, width=256):
    """An even gray sky with one bright patch at azimuth 0, 20 degrees up."""
    height = width // 2
    pixels = np.full((height, width), 0.5)
    row = height - round((20.0 + 90.0) / 180.0 * height)
    pixels[row - 2 : row + 2, height - 2 : height + 2] = 40.0
    hdri(path, pixels)


def gray(path):
    pixels = np.full((32, 64), 0.5)
    pixels[-1, 0] = 0.501  # one texel at the nadir, since an even sky is refused
    hdri(path, pixels)


def bright_side(path):
    """A sky that is three times as bright at azimuth 0 as behind, for pictures whose sky has to be the planned one."""
    azimuth = math.pi - (np.arange(128) + 0.5) / 128 * 2.0 * math.pi
    hdri(path, np.tile(0.4 + 0.2 * np.cos(azimuth), (64, 1)))


def hdri(path, radiance):
    """Write a gray sky, with the zenith in the first row, and its radiance beside it for `oracles.rendered`."""
    np.save(path.with_suffix(".npy"), radiance)
    _write_radiance_exr(np.repeat(radiance[::-1, :, None], 3, axis=2), str(path))


def targets(path):
    """Black walls, 20, 60, and 150 m from the origin, for the law of fog."""
    fresh()
    black = glowing("black", (0.0, 0.0, 0.0))
    for x, y in ((20.0, -8.0), (60.0, 0.0), (150.0, 70.0)):
        cuboid("wall", (0.5, 12.0 * x / 60.0, 12.0 * x / 60.0), (x, y, 0.0), black)
    gather()
    save(path)


def main(folder):
    tank(folder / "tank.blend")
    field(folder / "field.blend")
    field(folder / "centimeters.blend", unit=0.01)
    field(folder / "map.blend", center=(512_000.0, 5_403_000.0, 300.0))
    field(folder / "leaking.blend", drape=leaking)
    field(folder / "evil.blend", drape=evil(folder))
    field(folder / "wood.blend", drape=trees(folder))
    targets(folder / "walls.blend")
    fresh()
    cuboid("wall", (0.5, 80.0, 80.0), (20.0, 0.0, 0.0), glowing("dark", (0.05, 0.05, 0.05)))
    gather()
    save(folder / "wall.blend")
    fresh()
    cuboid("ground", (900.0, 900.0, 1.0), (0.0, 0.0, -0.5), diffuse("ground", (0.5, 0.5, 0.5)))
    gather()
    save(folder / "ground.blend")
    sunny = np.full((128, 256), 0.1)
    sunny[38:44, 100:106] = 120.0  # 30 degrees high; it gives the ground three times as much light as the rest
    hdri(folder / "sunny.exr", sunny)
    sky(folder / "sky.exr")
    bright_side(folder / "bright_side.exr")
    gray(folder / "gray.exr")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
