"""Cameras at the distance at which a target's projected box has exactly the wanted size."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from hulldown.annotate.boxes import Boxes
from hulldown.camera.framing import Framed, turned
from hulldown.camera.lenses import Lenses
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import Measure, ProjectedSize, refine_distance, solve_distance
from hulldown.planning.config.schema import RenderSection
from hulldown.planning.search.columns import put
from hulldown.planning.search.instances import Instances

# Framing turns the camera, which changes the size a little; the distance that restores it changes the framing less.
ROUNDS = 4


def image_size(measure: Measure, render: RenderSection) -> float:
    """Height, width or diagonal of the image in pixels, or its area in square pixels."""
    sizes = {
        "height": render.height,
        "width": render.width,
        "diagonal": math.sqrt(render.width * render.width + render.height * render.height),
        "area": render.width * render.height,
    }
    return float(sizes[measure])


def fraction_of(amodal: Float[np.ndarray, "n 4"], measure: Measure, render: RenderSection) -> Float[np.ndarray, " n"]:
    """What share of the image's height, width, diagonal or area these boxes fill; nan without a box."""
    size = ProjectedSize(amodal[:, 2], amodal[:, 3]).measure(measure)
    return (size**2 if measure == "area" else size) / image_size(measure, render)


def boxes_of(instances: Instances, world_from_camera: Float[np.ndarray, "n 4 4"], lens: Lenses) -> Boxes:
    """The boxes of n vehicles, each as its own camera sees it."""
    n = len(instances)
    boxes = Boxes(np.full((n, 4), np.nan), np.full((n, 4), np.nan), np.full(n, np.nan))
    for model, i in instances.by_model():
        angles = instances.model_angles(model, i)
        put(boxes, i, model.boxes.boxes(instances.world_from_vehicle[i], world_from_camera[i], lens.rows(i), angles))
    return boxes


def sized_cameras(
    targets: Instances,
    hull: Float[np.ndarray, "n h 3"],
    *,
    lens: Lenses,
    pixels: Float[np.ndarray, " n"],
    measure: Measure,
    azimuth: Float[np.ndarray, " n"],
    elevation: Float[np.ndarray, " n"],
    roll: Float[np.ndarray, " n"],
    framed: Callable[[Float[np.ndarray, "n 4 4"]], Framed],
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Cameras in the wanted directions, turned to frame the target, at the distance that gives its box its size.

    Parameters
    ----------
    targets
        n vehicles of one model.
    hull
        (n, h, 3) points whose projected box is theirs.
    lens
        n of them.
    pixels, measure
        (n,) wanted sizes, and of what; see `camera.size.solve_distance`.
    azimuth, elevation
        (n,) radians, of the camera as seen from the target's center.
    roll
        (n,) radians, of the camera about its axis; see `camera.framing.turned`.
    framed
        The cameras turned as the target is to be framed: each time by the same rule.

    Returns
    -------
    world_from_camera, distance
        nan where no distance with the whole vehicle in front of the camera gives that size.
    """
    centers = targets.centers
    level = camera_pose(centers, 1.0, azimuth, elevation)
    outward, looking = -level[:, :3, 2], turned(level, lens, lens.center, roll)

    def solved(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
        return solve_distance(lens, poses, hull, center=centers, pixels=pixels, measure=measure)

    distance = solved(looking)
    for _ in range(ROUNDS):
        # Rows without an answer are carried along at any distance, so that every row keeps its own numbers.
        poses = camera_pose(centers, np.where(np.isnan(distance), 1e3, distance), azimuth, elevation)
        poses = framed(poses).world_from_camera
        distance = np.where(np.isnan(distance), np.nan, solved(poses))
    if lens.distorted:
        # The vehicle's edges are curves, which may reach beyond its vertices.
        def size(at: Float[np.ndarray, " k"], rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
            there = poses[rows]
            there[:, :3, 3] = centers[rows] + at[:, None] * outward[rows]
            amodal = boxes_of(targets.take(rows), there, lens.rows(rows)).amodal
            return ProjectedSize(amodal[:, 2], amodal[:, 3]).measure(measure)

        distance = refine_distance(size, distance, np.sqrt(pixels) if measure == "area" else pixels)
    poses[:, :3, 3] = centers + distance[:, None] * outward
    return poses, distance
