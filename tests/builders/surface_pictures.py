"""Render small scenes in weather for test_surfaces; run as a script, with a folder to write into.

Pictures of light are linear .npy files; test_surfaces names them.
"""

import math
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_math_output, add_node
from hulldown.blender.light_pictures import render_light, set_linear_light_output
from hulldown.blender.tidy_properties import PART_PROPERTY, REST_PROPERTY
from hulldown.camera.intrinsics import Intrinsics
from hulldown.render.blender import cycles
from hulldown.render.blender.messages import CameraInput, CyclesSettings, LightInput, VehicleInput
from hulldown.render.blender.scene import BlenderScene
from hulldown.tests.builders.blend_parts import cuboid, fresh, gather, save
from hulldown.tests.builders.node_trees import grouped, material_of, principled, shader_group, write_picture
from hulldown.weather.kinds import Weather

TILES = ("asphalt", "soil", "paint", "metal", "glass", "grouped", "mixed", "matt")
Z_FROM_Y_UP = [[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
SETTINGS = CyclesSettings(samples=16, denoise=False, adaptive_threshold=0.0, bounces=2)


def gray(value):
    return (value, value, value)


def matt(tree):
    return add_node(tree, "BsdfDiffuse", {"Color": (*gray(0.26), 1.0)}).outputs[0]


def mixed(tree):
    """A mix of two soils with different shaders."""
    first = add_node(tree, "BsdfPrincipled", {"Base Color": (*gray(0.245), 1.0), "Roughness": 0.95})
    return add_node(tree, "MixShader", {1: first.outputs[0], 2: matt(tree)}).outputs[0]


def holes(tree):
    """A black leaf card with holes in stripes 0.1 m wide."""
    across = add_node(tree, "SeparateXYZ", {0: add_node(tree, "NewGeometry").outputs["Position"]}).outputs[0]
    alpha = add_math_output(
        tree, "GREATER_THAN", add_math_output(tree, "FRACT", add_math_output(tree, "MULTIPLY", across, 5.0)), 0.5
    )
    black = {"Base Color": (*gray(0.0), 1.0), "Roughness": 1.0}
    return add_node(tree, "BsdfPrincipled", {**black, "Alpha": alpha}).outputs[0]


def black(name):
    return principled(name, gray(0.0), 1.0, Specular_IOR_Level=0.0)


def plane(size, location, material, rotation=(0.0, 0.0, 0.0)):
    bpy.ops.mesh.primitive_plane_add(size=size, location=location, rotation=rotation)
    bpy.context.object.data.materials.append(material)


def tiles(path):
    """Level squares of 1 m in a row, one of each material; the center of the n-th is at x = n."""
    fresh()
    made = [
        principled("asphalt", gray(0.1), 0.85),
        principled("soil", gray(0.245), 0.95),
        principled("paint", gray(0.2), 0.3),
        principled("metal", gray(0.6), 0.6, Metallic=1.0),
        principled("glass", gray(1.0), 0.0, Transmission_Weight=1.0),
        grouped("grouped", shader_group(0.95), gray(0.245)),
        material_of("mixed", mixed),
        material_of("matt", matt),
    ]
    for n, material in enumerate(made):
        plane(1.0, (n, 0.0, 0.0), material)
    gather()
    save(path)


def dome(path):
    """A black sphere of 80 m in the air: seen from above, a pixel's distance from the center gives its slope."""
    fresh()
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, radius=80.0)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(black("rock"))
    gather()
    save(path)


def yard(path):
    """Black ground, an empty roof of 12 m, a wall at x = 12, water, and a leaf card beyond the ground."""
    fresh()
    soil = black("black")
    plane(100.0, (0.0, 0.0, 0.0), soil)
    plane(12.0, (0.0, 0.0, 2.0), soil)
    plane(8.0, (12.0, 0.0, 4.0), soil, (0.0, math.pi / 2, 0.0))
    plane(6.0, (0.0, 20.0, 0.1), black("lake"))
    plane(4.0, (-80.0, 0.0, 5.0), material_of("leaf", holes))
    gather()
    save(path)


def vehicle(path):
    """The tidy twin of a black box of 4 x 4 x 3 m with the ground's material."""
    fresh()
    obj = cuboid("car", (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), black("black"))
    rest = np.diag([4.0, 4.0, 3.0, 1.0])
    rest[2, 3] = 1.5
    obj[PART_PROPERTY], obj[REST_PROPERTY] = 0, rest.ravel().tolist()
    collection = bpy.data.collections.new("hulldown vehicle")
    collection.objects.link(obj)
    bpy.data.libraries.write(str(path), {collection}, fake_user=True)


def white(path):
    write_picture(path, np.ones((4, 8, 3)))


def weather(kind, ground, vehicles):
    return Weather(1e9, kind, 0.0, (0.0, 0.0), 0.004, ground, vehicles)


def at(x, y, z):
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def looking_down(x, y, z, width):
    """A camera that looks down and sees `width` meters at z = 0."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x, y, z
    return CameraInput(pose.tolist(), Intrinsics(64, 64, 2 * math.atan(width / 2 / z)), 0.01, 0.0, 0.0)


def looking_along_x(x, y, z, width, distance):
    """A level camera that sees `width` meters at a distance."""
    pose = np.array([[0.0, 0, 1, x], [-1, 0, 0, y], [0, -1, 0, z], [0, 0, 0, 1]])
    return CameraInput(pose.tolist(), Intrinsics(64, 64, 2 * math.atan(width / 2 / distance)), 0.01, 0.0, 0.0)


class Studio:
    """A scenery, and linear pictures of it."""

    def __init__(self, folder, name):
        self.folder = folder
        self.stage = BlenderScene(str(folder / f"{name}.blend"))
        cycles.configure_scene(self.stage.scene, SETTINGS, device="CPU")
        set_linear_light_output(self.stage.scene)

    def picture(self, name, camera, covered, vehicles=()):
        stage = self.stage
        cars = [VehicleInput(str(self.folder / "vehicle.blend"), [pose.tolist()]) for pose in vehicles]
        stage.place_vehicles(cars)
        stage.set_camera(camera)
        stage.world.set(LightInput(str(self.folder / "white.exr"), 0.0, 1.0, None))
        stage.set_weather(covered, seed=1)
        np.save(self.folder / f"{name}.npy", render_light(stage.scene)[::-1, :, :3])


def albedos(folder):
    studio = Studio(folder, "tiles")
    for n, name in enumerate(TILES):
        camera = looking_down(n, 0.0, 50.0, 0.5)
        studio.picture(f"{name} dry", camera, None)
        studio.picture(f"{name} wet", camera, weather("rain", 1.0, 0.0))
    np.save(folder / "left.npy", studio.stage.surfaces.left)


def slopes(folder):
    studio = Studio(folder, "dome")
    for share in (0.3, 1.0):
        studio.picture(f"dome {share}", looking_down(0.0, 0.0, 16000.0, 160.0), weather("snow", share, 0.0))
    studio.picture("drifts", looking_down(0.0, 0.0, 16000.0, 1.5), weather("snow", 0.5, 0.0))


def yards(folder):
    studio, snow = Studio(folder, "yard"), weather("snow", 1.0, 0.0)
    car = [at(-30.0, -20.0, 0.0)]
    above = looking_down(-30.0, -20.0, 100.0, 12.0)
    level = looking_along_x(-50.0, -20.0, 1.5, 6.0, 18.0)
    studio.picture("open", looking_down(-15.0, 0.0, 20.0, 4.0), snow)
    studio.picture("roofed", looking_down(0.0, 0.0, 1.9, 2.0), snow)
    studio.picture("wall", looking_along_x(6.5, 0.0, 4.0, 3.0, 5.5), snow)
    studio.picture("lake", looking_down(0.0, 20.0, 50.0, 4.0), snow)
    studio.picture("driven", above, snow, car)
    studio.picture("parked", above, weather("snow", 0.0, 1.0), car)
    studio.picture("dusty", level, weather("dust", 0.0, 1.0), car)
    studio.picture("leaf", looking_down(-80.0, 0.0, 50.0, 2.0), snow)


def main(folder):
    for make in (tiles, dome, yard, vehicle, white):
        make(folder / f"{make.__name__}{'.exr' if make is white else '.blend'}")
    albedos(folder)
    slopes(folder)
    yards(folder)


main(Path(sys.argv[1]))
