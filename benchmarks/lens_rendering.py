"""Two ways to render a distorting lens: a camera in Open Shading Language, or a wider pinhole picture that is warped.

`python -m hulldown.benchmarks.lens_rendering FOLDER` prints the table of docs/camera.md: CPU seconds, the width of a
checkerboard's edges, and how far its corners are from where `Camera.project` puts them.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import cv2
import numpy as np

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera
from hulldown.reading.blender.frames import world_from_blender_camera
from hulldown.render.blender.lens import set_lens

LENS = Intrinsics.calibrated(640, 360, (426.7, 426.7, 324.0, 174.7), (-0.28, 0.09, 0.001, -0.002, 0.0))
POSE = np.array([[1.0, 0, 0, 0.3], [0, 0.8, -0.6, 1.5], [0, 0.6, 0.8, -6.0], [0, 0, 0, 1]])  # before the board, z = 0
SQUARES = 24  # of 1 m, about the origin
DARK, BRIGHT = 0.1, 0.7
SAMPLES = 32
WAYS = {"pinhole, no distortion": (None, 1.0), "OSL camera": ("osl", 1.0), "wider, warped": ("warp", 1.0),
        "1.5 times the pixels a side, warped": ("warp", 1.5)}  # fmt: skip


def main(folder: Path) -> None:
    """Render the board in every way, in turns, and print what was measured."""
    scene = _scene()
    seconds: dict[str, list[float]] = {name: [] for name in WAYS}
    pictures = {}
    for _ in range(3):
        for name, (way, scale) in WAYS.items():
            started = time.process_time()
            pictures[name] = _picture(scene, way, scale, folder)
            seconds[name].append(time.process_time() - started)
    reference = min(seconds["pinhole, no distortion"])
    print("| way | CPU seconds | edge, 10 to 90 % | corners off, mean and largest |")
    print("|---|---|---|---|")
    for name, picture in pictures.items():
        cost = f"{min(seconds[name]) / reference:.2f}"
        if WAYS[name][0] is None:
            print(f"| {name} | {cost} | | |")
            continue
        mean, largest = _corners_off(picture)
        print(f"| {name} | {cost} | {_edge(picture):.2f} px | {mean:.3f}, {largest:.3f} px |")


def _scene() -> Any:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", SAMPLES
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = world_from_blender_camera(POSE).T.tolist()
    bpy.ops.mesh.primitive_plane_add(size=SQUARES)
    material = bpy.data.materials.new("board")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    checker, place = nodes.new("ShaderNodeTexChecker"), nodes.new("ShaderNodeNewGeometry")
    shift = nodes.new("ShaderNodeVectorMath")
    shift.inputs[1].default_value = (0.0, 0.0, 0.5)  # off the plane on which the squares would change along z
    glow, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    checker.inputs["Scale"].default_value = 1.0
    for socket, value in (("Color1", BRIGHT), ("Color2", DARK)):
        checker.inputs[socket].default_value = (value, value, value, 1.0)
    links.new(place.outputs["Position"], shift.inputs[0])
    links.new(shift.outputs[0], checker.inputs["Vector"])
    links.new(checker.outputs["Color"], glow.inputs["Color"])
    links.new(glow.outputs[0], output.inputs[0])
    bpy.context.object.data.materials.append(material)
    return scene


def _picture(scene: Any, way: str | None, scale: float, folder: Path) -> np.ndarray:
    """The board's brightness (h, w), linear."""
    lens, data, render = LENS, scene.camera.data, scene.render
    if way == "osl":
        render.resolution_x, render.resolution_y = lens.width, lens.height
        data.shift_x = data.shift_y = 0.0
        set_lens(data, lens, 0.1)
        return _rendered(scene, folder)
    (left, top), (right, bottom) = lens.bounds
    fx, fy, cx, cy = lens.pinhole or ()
    width, height = lens.width, lens.height
    if way == "warp":
        fx, fy, room = fx * scale, fy * scale, 4
        width, height = math.ceil((right - left) * fx) + 2 * room, math.ceil((bottom - top) * fy) + 2 * room
        cx, cy = room - left * fx, room - top * fy
    render.resolution_x, render.resolution_y = width, height
    data.type, data.sensor_fit, data.sensor_width = "PERSP", "HORIZONTAL", 36.0
    data.lens, data.shift_x, data.shift_y = 36.0 * fx / width, (width / 2 - cx) / width, (cy - height / 2) / width
    wide = _rendered(scene, folder)
    if way is None:
        return wide
    rays = Camera(lens, np.eye(4)).ray_directions(_pixels(lens.width, lens.height))
    at = rays[:, :2] / rays[:, 2:] * [fx, fy] + [cx, cy] - 0.5  # OpenCV's pixels are centered on whole numbers
    u, v = at.T.reshape(2, lens.height, lens.width).astype(np.float32)
    return cv2.remap(wide, u, v, cv2.INTER_LANCZOS4)


def _rendered(scene: Any, folder: Path) -> np.ndarray:
    scene.render.filepath = str(folder / "lens.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    width, height = image.size
    values = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return np.ascontiguousarray(values.reshape(height, width, 4)[::-1, :, 0])


def _pixels(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1).reshape(-1, 2)


def _place(pixels: np.ndarray) -> np.ndarray:
    """Where on the board pixels (n, 2) look: x and y; nan beside it."""
    camera = Camera(LENS, POSE)
    along = camera.ray_directions(pixels)
    at = camera.position + along * (-camera.position[2] / along[:, 2])[:, None]
    return np.where((np.abs(at[:, :2]).max(axis=1) < SQUARES / 2)[:, None], at[:, :2], np.nan)


def _corners_off(picture: np.ndarray) -> tuple[float, float]:
    """How far the board's corners are, by `cv2.cornerSubPix`, from where the camera projects them."""
    grid = np.stack(np.meshgrid(*[np.arange(1 - SQUARES / 2, SQUARES / 2)] * 2), -1).reshape(-1, 2)
    pixels = Camera(LENS, POSE).project(np.c_[grid, np.zeros(len(grid))]).pixels
    inside = ((pixels > 12) & (pixels < [LENS.width - 12, LENS.height - 12])).all(axis=1)
    near = Camera(LENS, POSE).project(np.c_[grid + np.array([1, 0]), np.zeros(len(grid))]).pixels
    inside &= np.hypot(*(near - pixels).T) > 24
    wanted = pixels[inside]
    found = np.ascontiguousarray(wanted[:, None] - 0.5, dtype=np.float32)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    cv2.cornerSubPix(picture.astype(np.float32), found, (6, 6), (-1, -1), until)
    off = np.hypot(*(found[:, 0] + 0.5 - wanted).T)
    return float(off.mean()), float(off.max())


def _edge(picture: np.ndarray) -> float:
    """Pixels in which the brightness goes from 10 to 90 % across an edge, over all edges away from corners."""
    pixels = _pixels(LENS.width, LENS.height)
    place, slope = _place(pixels), np.stack([_place(pixels + step) for step in np.eye(2) * 0.5], -1)
    slope = (slope - place[..., None]) / 0.5
    nearest = np.round(place)
    off = (place - nearest) / np.hypot(slope[..., 0], slope[..., 1])
    far = np.abs(place - nearest) > 0.25
    distance, level = [], []
    for axis in (0, 1):
        some = np.flatnonzero((np.abs(off[:, axis]) < 3) & far[:, 1 - axis] & (1 / np.abs(slope[:, axis]).max(-1) > 24))
        low = (np.floor(place[some]).sum(axis=1) % 2 == 1) == (off[some, axis] > 0)
        distance.append(np.where(low, 1, -1) * off[some, axis])
        level.append((picture.ravel()[some] - DARK) / (BRIGHT - DARK))
    bins = np.arange(-3, 3.01, 0.05)
    which = np.digitize(np.concatenate(distance), bins)
    means = np.array([np.concatenate(level)[which == k].mean() for k in range(1, len(bins))])
    middles = bins[:-1] + 0.025
    return float(np.interp(0.9, means, middles) - np.interp(0.1, means, middles))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
