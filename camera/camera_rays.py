"""Rays of many cameras, through the same pattern of points in each camera's window."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.cameras import NEAR_M
from hulldown.geometry.transforms import rotate_vectors


class CameraRays:
    """Rays of n cameras, r each; flat index i is ray i % r of camera i // r.

    Windows are in the plane at unit depth, where a point (x, y, z) of the camera's frame is (x / z, y / z).
    """

    def __init__(
        self, low: Float[np.ndarray, "n 2"], extent: Float[np.ndarray, "n 2"], pattern: Float[np.ndarray, "*n r 2"]
    ) -> None:
        self.low, self.extent = low, extent
        self.count = pattern.shape[-2]
        self._u, self._v = np.ascontiguousarray(np.moveaxis(pattern, -1, 0))
        # A direction with z = 1 is (1, u, v) of the pattern times these rows.
        self._rows = np.zeros((len(low), 3, 3))
        self._rows[:, 0, :2] = low
        self._rows[:, 0, 2] = 1.0
        self._rows[:, [1, 2], [0, 1]] = extent

    def rays(
        self,
        frame_from_camera: Float[np.ndarray, "m 4 4"],
        which: Int[np.ndarray, " k"],
        camera: Int[np.ndarray, " m"] | None = None,
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Origins on the near plane, and directions of unit depth, of the rays with these ascending indices.

        `frame_from_camera`: frames for the rays.
        `which`: index i is ray i % r of frame i // r.
        `camera`: the camera of each frame's rays; None: frame i is camera i's.
        """
        r = self.count
        view = which // r
        begin, end = (int(view[0]), int(view[-1]) + 1) if len(which) else (0, 0)
        frames = frame_from_camera[begin:end]
        of = slice(begin, end) if camera is None else camera[begin:end]
        turned = rotate_vectors(frames[:, :3, :3], self._rows[of])
        u, v = self._take_cameras(of)
        every = np.empty((3, end - begin, r))
        for axis, out in enumerate(every):
            np.multiply(turned[:, 1, axis, None], u, out=out)
            out += turned[:, 2, axis, None] * v
            out += turned[:, 0, axis, None]
        along = np.ascontiguousarray(every.reshape(3, -1)[:, which - begin * r].T)
        return frames[view - begin, :3, 3] + NEAR_M * along, along

    def edges(self, frame_from_camera: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 3"]:
        """Directions of unit depth along the four edges of each camera's rays, in order around it."""
        low, across, down = np.moveaxis(rotate_vectors(frame_from_camera[:, :3, :3], self._rows), 1, 0)
        return np.stack([low, low + across, low + across + down, low + down], 1)

    def rays_through_boxes(
        self, box: Float[np.ndarray, "p 2 2"], view: Int[np.ndarray, " p"]
    ) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
        """Return all pairs of a box, given by its corners at unit depth, and a ray of its camera through it."""
        low = self.low[view]
        near = np.flatnonzero(((box[:, 1] >= low) & (box[:, 0] <= low + self.extent[view])).all(axis=1))
        box, view = box[near], view[near]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (box - self.low[view, None]) / self.extent[view, None]
        u, v = self._take_cameras(view)
        inside = u >= at[:, 0, :1]
        inside &= u <= at[:, 1, :1]
        inside &= v >= at[:, 0, 1:]
        inside &= v <= at[:, 1, 1:]
        pair, ray = np.nonzero(inside)
        return near[pair], ray

    def _take_cameras(self, cameras: slice | Int[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
        """Return the pattern of some cameras."""
        return (self._u, self._v) if self._u.ndim == 1 else (self._u[cameras], self._v[cameras])


def box_at_unit_depth(points_camera: Float[np.ndarray, "p k 3"]) -> Float[np.ndarray, "p 2 2"]:
    """Return corners of a box around the projected points; infinite if a point is nearer than the near plane."""
    # Points first: NumPy takes extremes over a short last axis many times slower.
    x, y, depth = np.ascontiguousarray(points_camera.transpose(2, 1, 0))
    beyond = depth.min(axis=0) > NEAR_M
    depth = np.where(beyond, depth, 1.0)
    x, y = x / depth, y / depth
    low, high = (np.stack([take(x, axis=0), take(y, axis=0)], 1) for take in (np.min, np.max))
    box = np.stack([low, high], 1)
    box[~beyond] = np.array([[-np.inf], [np.inf]])
    return box
