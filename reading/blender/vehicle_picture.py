"""A tiny picture of a vehicle by Cycles, in light from everywhere: what people would see at once."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.blender.frames import set_object_pose, world_from_blender_camera
from hulldown.blender.light_pictures import render_light, set_linear_light_output
from hulldown.blender.tidy_properties import REST_PROPERTY
from hulldown.camera.shell import camera_pose

PICTURE_SIDE_PX = 240
PICTURE_SAMPLES = 6
PICTURE_BOUNCES = 3
TRANSPARENT_BOUNCES = 32  # transparent surfaces in a row, as in the dataset's pictures
CAMERA_AZIMUTH, CAMERA_ELEVATION = math.radians(45.0), math.radians(25.0)  # front left, from above
PICTURE_WIDTH_DIAGONALS = 0.95  # of the vehicle


def render_vehicle_picture(collection: Any, bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "h w 4"]:
    """Return linear light and alpha of a vehicle from its front left in a white world, the first row on top."""
    scene = bpy.data.scenes.new("picture")
    scene.collection.children.link(collection)
    root = bpy.data.objects.new("root", None)
    scene.collection.objects.link(root)
    for obj in collection.objects:
        obj.parent = root
        set_object_pose(obj, np.reshape(obj[REST_PROPERTY], (4, 4)))
    cycles, render = scene.cycles, scene.render
    render.engine, cycles.device, render.threads_mode, render.threads = "CYCLES", "CPU", "FIXED", 2
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = PICTURE_SAMPLES, False, False
    cycles.max_bounces, cycles.transparent_max_bounces = PICTURE_BOUNCES, TRANSPARENT_BOUNCES
    render.resolution_x = render.resolution_y = PICTURE_SIDE_PX
    render.resolution_percentage, render.film_transparent = 100, True
    scene.world = bpy.data.worlds.new("white")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera, reach = camera, float(np.linalg.norm(bounds[1] - bounds[0]))
    camera.data.type, camera.data.ortho_scale = "ORTHO", PICTURE_WIDTH_DIAGONALS * reach
    camera.data.clip_start, camera.data.clip_end = reach / 100.0, 3.0 * reach
    at = camera_pose(bounds.mean(axis=0), 1.5 * reach, CAMERA_AZIMUTH, CAMERA_ELEVATION)
    camera.matrix_world = world_from_blender_camera(at).T.tolist()
    set_linear_light_output(scene)
    render.image_settings.color_mode = "RGBA"
    return render_light(scene)[::-1].astype(np.float64)
