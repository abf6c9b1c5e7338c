"""Ray casts against obstacles for all rays of a camera together, which pass the tree of instances as beams."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.camera.camera_rays import CameraRays, box_at_unit_depth
from hulldown.camera.projection import NEAR, Camera
from hulldown.geometry.cutouts import PASSED
from hulldown.geometry.indices import numbered, rounds
from hulldown.geometry.instances import InstancedScene, InstanceHits
from hulldown.geometry.transforms import BOX_CORNERS, apply, invert_rigid, rotate

# Parts of a beam along its length: their boxes enclose less empty space than one box.
LENGTHS = 8
RAYS = 1 << 18  # pairs of ray and instance in memory at a time
PAIRS = 1 << 16  # the same where rays and instances of one camera are paired
BARELY = 1e-6  # meters ahead of a camera
_EDGES = np.array([(i, i + step) for step in (1, 2, 4) for i in range(8) if not i & step]).T  # pairs of corners


def passed_in_beams(
    scene: InstancedScene,
    camera_rays: CameraRays,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    *,
    reach: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """Return each ray's transmittance: 0 or 1 as by `scene.occluded`, or a share behind alpha textures.

    `reach`: how far each looks, in meters from the near plane; -inf: it isn't cast.
    """
    passed, far = np.ones(len(reach)), reach.copy()
    if not len(scene.bounds):
        return passed
    origins, along = camera_rays.rays(world_from_camera, np.arange(len(reach)))
    for flat, instance in _pairs(scene, camera_rays, world_from_camera, far.reshape(-1, camera_rays.count)):
        rays, index = np.unique(flat, return_inverse=True)
        passed[rays] *= scene.transmittance_by(
            origins[rays], along[rays], index, instance=instance, max_distance=reach[rays]
        )
        blocked = rays[passed[rays] < PASSED]
        passed[blocked], far[blocked] = 0.0, -np.inf
    return passed


def nearest_in_beams(
    scene: InstancedScene,
    camera_rays: CameraRays,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    *,
    reach: Float[np.ndarray, " k"],
) -> InstanceHits:
    """Return the first hit of all rays of n cameras: as `scene.cast`, faster for whole images of a wood.

    `reach`: how far each looks, in meters from the near plane.
    """
    hits, far = InstanceHits.missed(len(reach)), reach.copy()
    if not len(scene.bounds):
        return hits
    origins, along = camera_rays.rays(world_from_camera, np.arange(len(reach)))
    along /= np.linalg.norm(along, axis=1)[:, None]
    for ray, instance in _pairs(scene, camera_rays, world_from_camera, far.reshape(-1, camera_rays.count)):
        scene.cast_by(origins, along, ray, instance=instance, reach=far, hits=hits)
    return hits


def hidden_in_view(scene: InstancedScene, camera: Camera, along: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Return whether anything lies along each ray from a camera, as by `scene.occluded`; faster for its whole picture.

    `along`: directions in the world, at most a right angle from the optical axis.
    """
    hidden = np.zeros(len(along), dtype=bool)
    x, y, z = rotate(camera.camera_from_world[:3, :3], along).T
    u, v = x / z, y / z
    start = np.broadcast_to(camera.position, along.shape)
    instances, box = _in_view(scene, camera, np.stack([u, v], axis=1))
    while len(instances):
        # Only rays whose u is in the box are paired with it, and only so many boxes at a time: the nearest hide most.
        left = np.flatnonzero(~hidden)
        left = left[np.argsort(u[left])]
        first = np.searchsorted(u[left], box[:, 0, 0], "left")
        last = np.searchsorted(u[left], box[:, 1, 0], "right")
        some = max(1, int(np.searchsorted(np.cumsum(last - first), PAIRS)))
        pair, number = numbered((last - first)[:some])
        ray = left[first[pair] + number]
        met = np.flatnonzero((v[ray] >= box[pair, 0, 1]) & (v[ray] <= box[pair, 1, 1]))
        met = met[np.argsort(ray[met], kind="stable")]
        scene.occlude_by(start, along, ray[met], instance=instances[pair[met]], hidden=hidden)
        instances, box = instances[some:], box[some:]
    return hidden


def _in_view(
    scene: InstancedScene, camera: Camera, seen: Float[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 2 2"]]:
    """Instances that rays through points at unit depth may meet, nearest first, and boxes around them at unit depth."""
    if not len(seen) or not len(scene.bounds):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2, 2))
    low, high = scene.bounds[:, 0], scene.bounds[:, 1]
    middle = apply(camera.camera_from_world, (low + high) / 2.0)
    radius = np.linalg.norm(high - low, axis=1)  # twice what the bounds need
    inside = middle[:, 2] > -radius
    for axis, side in product((0, 1), (-1.0, 1.0)):
        edge = float((side * seen[:, axis]).max())
        inside &= side * middle[:, axis] - edge * middle[:, 2] < radius * math.hypot(1.0, edge)
    instance = np.flatnonzero(inside)
    instance = instance[np.argsort(middle[instance, 2], kind="stable")]
    local = apply(camera.camera_from_world, _corners(scene, instance))
    ahead = local[..., 2].max(axis=1) > BARELY
    instance, local = instance[ahead], local[ahead]
    box = box_at_unit_depth(local)
    partly = np.flatnonzero(local[..., 2].min(axis=1) <= NEAR)
    # These end where their edges reach the camera's plane: far off, unless the camera is inside.
    one, other = local[partly][:, _EDGES[0]], local[partly][:, _EDGES[1]]
    leaves = (one[..., 2] > BARELY) != (other[..., 2] > BARELY)
    share = (BARELY - one[..., 2]) / np.where(leaves, other[..., 2] - one[..., 2], 1.0)
    ends = (one + share[..., None] * (other - one))[..., :2] / BARELY
    ahead = local[partly, :, 2] > BARELY
    corners = local[partly, :, :2] / np.where(ahead, local[partly, :, 2], 1.0)[..., None]
    points, counts = np.concatenate([corners, ends], axis=1), np.concatenate([ahead, leaves], axis=1)[..., None]
    box[partly, 0] = np.where(counts, points, np.inf).min(axis=1)
    box[partly, 1] = np.where(counts, points, -np.inf).max(axis=1)
    return instance, box


def _corners(scene: InstancedScene, instance: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 8 3"]:
    """Return corners of instances' bounds, grown by more than rounding, in the world."""
    corners = np.where(BOX_CORNERS > 0.0, scene.bounds[instance, None, 1], scene.bounds[instance, None, 0])
    pad = 1e-5 * np.ptp(scene.bounds[instance], axis=1) + 1e-9
    return corners + BOX_CORNERS * pad[:, None]


def _pairs(
    scene: InstancedScene,
    camera_rays: CameraRays,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    far: Float[np.ndarray, "n r"],
) -> Iterator[tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]]:
    """Yield rays and instances that may meet, in blocks, each camera's nearest instances first.

    `far` is how far each ray still looks: callers lower it as rays meet something.
    """
    edges, apex = camera_rays.edges(world_from_camera), world_from_camera[:, :3, 3]
    low, high = scene.bounds[:, 0].min(axis=0), scene.bounds[:, 1].max(axis=0)
    end = np.linalg.norm(np.maximum(np.abs(apex - low), np.abs(apex - high)), axis=1)
    length = np.clip(far.max(axis=1), 0.0, end) + np.linalg.norm(edges, axis=2).max(axis=1)
    rims = (
        apex[:, None, None] + edges[:, None] * (length[:, None] * np.linspace(0.0, 1.0, LENGTHS + 1))[..., None, None]
    )
    low, high = rims.min(axis=2), rims.max(axis=2)
    low, high = np.minimum(low[:, :-1], low[:, 1:]), np.maximum(high[:, :-1], high[:, 1:])
    part, instance = scene.overlapping(low.reshape(-1, 3), high.reshape(-1, 3))
    k = len(scene.bounds)
    view, instance = np.divmod(np.unique(part // LENGTHS * k + instance), k)
    local = apply(invert_rigid(world_from_camera)[view], _corners(scene, instance))
    box, nearest = box_at_unit_depth(local), local[..., 2].min(axis=1)
    order, size = np.lexsort((nearest, view)), max(1, RAYS // camera_rays.count)
    for batch in rounds(view[order]):
        for block in (order[batch[i : i + size]] for i in range(0, len(batch), size)):
            pair, ray = camera_rays.through(box[block], view[block])
            pair = block[pair]
            # From the near plane to a box it's at least the box's depth less the plane's; once more, for rounding.
            ahead = far[view[pair], ray] > nearest[pair] - 2.0 * NEAR
            yield view[pair[ahead]] * camera_rays.count + ray[ahead], instance[pair[ahead]]
