"""Rays of cameras: pencils through windows of many cameras, or through all pixels of one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.indices import rank_batches
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.transforms import BOX_CORNERS, compose_affine, invert_rigid, rotate_vectors, transform_points
from hulldown.scene.rays import LocalRayBlock, RayBatch, RayBlock, RayPiece

# Rays through one pinhole are coherent as they come: batches below this size are not sorted again by RayCaster, and
# stay in cache.
BATCH_RAYS = 4095
# Parts of a beam along its length: their boxes enclose less empty space than one box.
BEAM_LENGTHS = 8
RAY_PAIRS_PER_BLOCK = 1 << 18  # of ray and instance
TILE_SIDE_PX = 64  # of rays that are traced together


class CameraPencils(RayBatch):
    """Rays of n cameras, r each, from the near plane on; ray i is ray i % r of camera i // r.

    They go through a pattern of points in each camera's window. Windows are in the plane at unit depth, where a point
    (x, y, z) of the camera's frame is (x / z, y / z). Directions have unit depth.
    """

    def __init__(
        self,
        world_from_camera: Float[np.ndarray, "n 4 4"],
        low: Float[np.ndarray, "n 2"],
        extent: Float[np.ndarray, "n 2"],
        pattern: Float[np.ndarray, "*n r 2"],
    ) -> None:
        self.world_from_camera, self.low, self.extent = world_from_camera, low, extent
        self.count = pattern.shape[-2]
        self._u, self._v = np.ascontiguousarray(np.moveaxis(pattern, -1, 0))
        # A direction with z = 1 is (1, u, v) of the pattern times these rows.
        self._rows = np.zeros((len(low), 3, 3))
        self._rows[:, 0, :2] = low
        self._rows[:, 0, 2] = 1.0
        self._rows[:, [1, 2], [0, 1]] = extent

    def __len__(self) -> int:
        return len(self.low) * self.count

    @cached_property
    def _origins_and_directions(self) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        return self._rays_in_frames(self.world_from_camera, np.arange(len(self)), np.arange(len(self.low)))

    @property
    def origins(self) -> Float[np.ndarray, "k 3"]:
        """Origins on the near planes."""
        return self._origins_and_directions[0]

    @property
    def directions(self) -> Float[np.ndarray, "k 3"]:
        """Directions of unit depth."""
        return self._origins_and_directions[1]

    def asked_ray_blocks(self, asked: Bool[np.ndarray, " k"]) -> Iterator[RayBlock]:
        """Yield the asked rays in coherent blocks."""
        index = np.flatnonzero(asked)
        for some in (index[i : i + BATCH_RAYS] for i in range(0, len(index), BATCH_RAYS)):
            yield RayBlock(some, self.origins[some], self.directions[some])

    def ray_instance_pairs(
        self, tree: BoxTree, bounds: Float[np.ndarray, "i 2 3"], reach: Float[np.ndarray, " k"]
    ) -> Iterator[tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]]:
        """Yield rays with the instances whose boxes cover them in their camera's window."""
        if not len(bounds):
            return
        far, apex = reach.reshape(-1, self.count), self.world_from_camera[:, :3, 3]
        edges = self._edge_directions()
        low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
        end = np.linalg.norm(np.maximum(np.abs(apex - low), np.abs(apex - high)), axis=1)
        length = np.clip(far.max(axis=1), 0.0, end) + np.linalg.norm(edges, axis=2).max(axis=1)
        rims = (
            apex[:, None, None] + edges[:, None] * (length[:, None] * np.linspace(0.0, 1.0, BEAM_LENGTHS + 1))[..., None, None]
        )
        low, high = rims.min(axis=2), rims.max(axis=2)
        low, high = np.minimum(low[:, :-1], low[:, 1:]), np.maximum(high[:, :-1], high[:, 1:])
        part, instance = tree.overlapping_pairs(low.reshape(-1, 3), high.reshape(-1, 3))
        k = len(bounds)
        view, instance = np.divmod(np.unique(part // BEAM_LENGTHS * k + instance), k)
        local = transform_points(self._camera_from_world[view], _padded_bounds_corners(bounds, instance))
        box, nearest = bound_points_at_unit_depth(local), local[..., 2].min(axis=1)
        order, size = np.lexsort((nearest, view)), max(1, RAY_PAIRS_PER_BLOCK // self.count)
        for batch in rank_batches(view[order]):
            for block in (order[batch[i : i + size]] for i in range(0, len(batch), size)):
                pair, ray = self._box_ray_pairs(box[block], view[block])
                pair = block[pair]
                # From the near plane to a box it's at least the box's depth less the plane's; once more, for rounding.
                ahead = far[view[pair], ray] > nearest[pair] - 2.0 * NEAR_M
                yield view[pair[ahead]] * self.count + ray[ahead], instance[pair[ahead]]

    def cameras_and_local_poses(
        self, world_from_vehicle: Float[np.ndarray, "k 4 4"], row: Int[np.ndarray, " k"] | None
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 4 4"]]:
        """Return poses in the cameras' frames."""
        camera = np.arange(len(self.low)) if row is None else row
        return camera, compose_affine(self._camera_from_world[camera], world_from_vehicle)

    def local_rays_near_hull(
        self,
        points: Float[np.ndarray, "c 3"],
        poses: Float[np.ndarray, "m 4 4"],
        camera: Int[np.ndarray, " m"] | None,
        asked: Bool[np.ndarray, " k"],
    ) -> Iterator[LocalRayBlock]:
        """Yield the asked rays through the box of the points in their camera's window."""
        assert camera is not None
        pose, ray = self._box_ray_pairs(bound_points_at_unit_depth(transform_points(poses, points)), camera)
        points_from_camera = invert_rigid(poses)
        kept = np.flatnonzero(asked[camera[pose] * self.count + ray])
        for some in (kept[i : i + BATCH_RAYS] for i in range(0, len(kept), BATCH_RAYS)):
            of, number = pose[some], ray[some]
            rays = self._rays_in_frames(points_from_camera, of * self.count + number, camera)
            yield LocalRayBlock(camera[of] * self.count + number, of, *rays)

    @cached_property
    def _camera_from_world(self) -> Float[np.ndarray, "n 4 4"]:
        return invert_rigid(self.world_from_camera)

    def _rays_in_frames(
        self, frame_from_camera: Float[np.ndarray, "m 4 4"], which: Int[np.ndarray, " k"], camera: Int[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Origins and directions of the rays with these ascending indices: i is ray i % r of frame i // r."""
        r = self.count
        view = which // r
        begin, end = (int(view[0]), int(view[-1]) + 1) if len(which) else (0, 0)
        frames, of = frame_from_camera[begin:end], camera[begin:end]
        turned = rotate_vectors(frames[:, :3, :3], self._rows[of])
        u, v = self._take_patterns(of)
        every = np.empty((3, end - begin, r))
        for axis, out in enumerate(every):
            np.multiply(turned[:, 1, axis, None], u, out=out)
            out += turned[:, 2, axis, None] * v
            out += turned[:, 0, axis, None]
        along = np.ascontiguousarray(every.reshape(3, -1)[:, which - begin * r].T)
        return frames[view - begin, :3, 3] + NEAR_M * along, along

    def _edge_directions(self) -> Float[np.ndarray, "n 4 3"]:
        """Directions of unit depth along the four edges of each camera's rays, in order around it."""
        rows = rotate_vectors(self.world_from_camera[:, :3, :3], self._rows)
        low, across, down = np.moveaxis(rows, 1, 0)
        return np.stack([low, low + across, low + across + down, low + down], 1)

    def _box_ray_pairs(
        self, box: Float[np.ndarray, "p 2 2"], view: Int[np.ndarray, " p"]
    ) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
        """Return all pairs of a box, given by its corners at unit depth, and a ray of its camera through it."""
        low = self.low[view]
        near = np.flatnonzero(((box[:, 1] >= low) & (box[:, 0] <= low + self.extent[view])).all(axis=1))
        box, view = box[near], view[near]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (box - self.low[view, None]) / self.extent[view, None]
        u, v = self._take_patterns(view)
        inside = u >= at[:, 0, :1]
        inside &= u <= at[:, 1, :1]
        inside &= v >= at[:, 0, 1:]
        inside &= v <= at[:, 1, 1:]
        pair, ray = np.nonzero(inside)
        return near[pair], ray

    def _take_patterns(self, cameras: Int[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
        return (self._u, self._v) if self._u.ndim == 1 else (self._u[cameras], self._v[cameras])


class PixelRays:
    """Rays through all pixel centers of a camera, row by row, from its position; hits begin at the near plane."""

    def __init__(self, camera: Cameras) -> None:
        self.camera = camera

    def __len__(self) -> int:
        return self.camera.lenses.width * self.camera.lenses.height

    def ray_piece_makers(self) -> Sequence[Callable[[], RayPiece]]:
        """Return bands of tiles; beyond the picture's last row and column, tiles repeat them."""
        rows, columns = (
            np.arange(-(-n // TILE_SIDE_PX) * TILE_SIDE_PX).clip(max=n - 1).reshape(-1, TILE_SIDE_PX)
            for n in (self.camera.lenses.height, self.camera.lenses.width)
        )
        return [partial(self._tile_band_piece, band, columns) for band in rows]

    def _tile_band_piece(self, band: Int[np.ndarray, " t"], columns: Int[np.ndarray, "b t"]) -> RayPiece:
        width = self.camera.lenses.width
        pixel = (band[:, None] * width + columns[:, None, :]).reshape(-1, TILE_SIDE_PX * TILE_SIDE_PX)
        at = self.camera.lenses.unit_points_from_pixels(np.stack([pixel % width, pixel // width], axis=-1) + 0.5)
        u, v = np.ascontiguousarray(np.moveaxis(at, -1, 0))  # NumPy takes extremes along it many times faster
        low = np.stack([u.min(axis=1), v.min(axis=1)], axis=1)
        extent = np.maximum(np.stack([u.max(axis=1), v.max(axis=1)], axis=1) - low, 1e-300)
        poses = np.tile(self.camera.world_from_camera, (len(low), 1, 1))
        pencils = CameraPencils(poses, low, extent, (at - low[:, None]) / extent[:, None])
        return RayPiece(pixel.ravel(), pencils, (NEAR_M * np.sqrt(1.0 + u * u + v * v)).ravel())


def bound_points_at_unit_depth(points_camera: Float[np.ndarray, "p k 3"]) -> Float[np.ndarray, "p 2 2"]:
    """Return corners of a box around the projected points; infinite if a point is nearer than the near plane."""
    # Points first: NumPy takes extremes over a short last axis many times slower.
    x, y, depth = np.ascontiguousarray(points_camera.transpose(2, 1, 0))
    beyond = depth.min(axis=0) > NEAR_M
    depth = np.where(beyond, depth, 1.0)
    x, y = x / depth, y / depth
    low, high = (np.stack([extreme(x, axis=0), extreme(y, axis=0)], 1) for extreme in (np.min, np.max))
    box = np.stack([low, high], 1)
    box[~beyond] = np.array([[-np.inf], [np.inf]])
    return box


def _padded_bounds_corners(bounds: Float[np.ndarray, "k 2 3"], instance: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 8 3"]:
    """Return corners of instances' bounds, grown by more than rounding, in the world."""
    corners = np.where(BOX_CORNERS > 0.0, bounds[instance, None, 1], bounds[instance, None, 0])
    pad = 1e-5 * np.ptp(bounds[instance], axis=1) + 1e-9
    return corners + BOX_CORNERS * pad[:, None]
