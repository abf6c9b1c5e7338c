"""Cameras at the distance at which a target's projected box has an exact size."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from hulldown.annotate.boxes import Boxes
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import turned
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import Measure, box_length, refine_distance, solve_distance
from hulldown.geometry.columns import put
from hulldown.plan.config.scene_sections import RenderSection
from hulldown.planning.search.instance_table import Instances

# Framing turns the camera, which changes the size a little; correcting the distance changes the framing less.
SIZING_ROUNDS = 4


def image_size(measure: Measure, render: RenderSection) -> float:
    """Height, width, or diagonal of the image in pixels, or its area in square pixels."""
    sizes = {
        "height": render.height,
        "width": render.width,
        "diagonal": math.sqrt(render.width * render.width + render.height * render.height),
        "area": render.width * render.height,
    }
    return float(sizes[measure])


def filled_fraction(
    amodal: Float[np.ndarray, "n 4"], measure: Measure, render: RenderSection
) -> Float[np.ndarray, " n"]:
    """Return the share of the image's height, width, diagonal, or area that these boxes fill; nan without a box."""
    size = box_length(amodal[:, 2:], measure)
    return (size**2 if measure == "area" else size) / image_size(measure, render)


def no_boxes(n: int) -> Boxes:
    """Allocate n boxes: nan."""
    return Boxes(np.full((n, 4), np.nan), np.full((n, 4), np.nan), np.full(n, np.nan))


def vehicle_boxes(instances: Instances, cameras: Cameras) -> Boxes:
    """Return the boxes of n vehicles, each in its own camera."""
    boxes = no_boxes(len(instances))
    for model, i in instances.by_model():
        angles = instances.model_angles(model, i)
        put(boxes, i, model.boxes.boxes(instances.world_from_vehicle[i], cameras.take(i), angles))
    return boxes


def size_cameras(
    targets: Instances,
    hull: Float[np.ndarray, "n h 3"],
    *,
    lenses: Intrinsics,
    pixels: Float[np.ndarray, " n"],
    measure: Measure,
    azimuth: Float[np.ndarray, " n"],
    elevation: Float[np.ndarray, " n"],
    roll: Float[np.ndarray, " n"],
    frame: Callable[[Cameras], Cameras],
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Return cameras in these directions from n targets of one model, framed, at distances with the wanted box sizes.

    Pose and distance are nan if no distance with the whole vehicle in front of the camera gives that size.
    """
    centers = targets.centers
    level = Cameras(lenses, camera_pose(centers, 1.0, azimuth, elevation))
    outward = -level.world_from_camera[:, :3, 2]

    def solved(cameras: Cameras) -> Float[np.ndarray, " n"]:
        return solve_distance(cameras, hull, center=centers, pixels=pixels, measure=measure)

    distance = solved(turned(level, lenses.center, roll))
    for _ in range(SIZING_ROUNDS):
        # Rows without a distance are kept, so that every row keeps its own random numbers.
        poses = camera_pose(centers, np.where(np.isnan(distance), 1e3, distance), azimuth, elevation)
        cameras = frame(level.at_poses(poses))
        distance = np.where(np.isnan(distance), np.nan, solved(cameras))
    if lenses.distorted:
        # The image of an edge is a curve, which may extend beyond its end points.
        def size(at: Float[np.ndarray, " k"], rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
            moved = cameras.take(rows)
            moved.position[:] = centers[rows] + at[:, None] * outward[rows]
            amodal = vehicle_boxes(targets.take(rows), moved).amodal
            return box_length(amodal[:, 2:], measure)

        distance = refine_distance(size, distance, np.sqrt(pixels) if measure == "area" else pixels)
    poses = cameras.world_from_camera
    poses[:, :3, 3] = centers + distance[:, None] * outward
    return poses, distance
