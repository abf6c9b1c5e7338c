"""Keypoints of a posed vehicle in an image, and their visibility."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hulldown.camera.projection import NEAR_M, Camera
from hulldown.geometry.transforms import apply
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle

UNSEEN, HIDDEN, SEEN = 0.0, 1.0, 2.0  # COCO's v
SURFACE_SLACK_M = 0.01  # meters that a keypoint may be below the surface that it is on


def keypoints_in_image(vehicle: PosedVehicle, camera: Camera, world: Scene) -> Float[np.ndarray, "k 3"]:
    """Pixel and COCO's v of each keypoint of a vehicle: 2 if it's visible, 1 if it's hidden, 0 outside of the image."""
    shape, world_from_vehicle = vehicle.caster.shape, vehicle.world_from_vehicle[0]
    points = apply(world_from_vehicle, shape.keypoints_at(vehicle.articulation))
    pixels, depth = camera.project(points)
    size = (camera.intrinsics.width, camera.intrinsics.height)
    with np.errstate(invalid="ignore"):
        framed = np.flatnonzero((depth >= NEAR_M) & (pixels >= 0.0).all(axis=1) & (pixels < size).all(axis=1))
    keypoints = np.zeros((len(points), 3))
    keypoints[framed] = np.column_stack([pixels[framed], np.full(len(framed), SEEN)])
    along = points[framed] - camera.position
    distance = np.linalg.norm(along, axis=1)
    first = NEAR_M * distance / depth[framed]  # to the near plane
    reach = distance - first - SURFACE_SLACK_M
    asked = np.flatnonzero(reach > 0.0)
    unit = along[asked] / distance[asked, None]
    hidden = world.occluded(camera.position + first[asked, None] * unit, unit, max_distance=reach[asked])
    keypoints[framed[asked[hidden]], 2] = HIDDEN
    return keypoints
