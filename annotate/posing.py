"""A vehicle's surface as coordinate rows, transformed into camera frames by explicit sums for reproducible bits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.hulls import extreme_point_indices
from hulldown.geometry.transforms import compose_affine, matrix_product

NEAR_VERTEX_SHARE = 1e-9  # of part sizes: by rounding, a point so close to a hull vertex may be extreme in its place


class PosedParts:
    """A vehicle's visible vertices by rigid part, and those of them that can be extreme in an image."""

    def __init__(self, shape: VehicleShape) -> None:
        def part_slices(part: Int[np.ndarray, " n"]) -> list[slice]:
            return slices_between_ends(np.searchsorted(part, np.arange(len(shape.part_names) + 1)))

        surface, vertex_part = shape.surface
        used = np.unique(surface.faces)
        order = used[np.argsort(vertex_part[used], kind="stable")]
        number = np.empty(len(surface.vertices), dtype=np.int64)
        number[order] = np.arange(len(order))
        self.vertices: Float[np.ndarray, "3 v"] = np.ascontiguousarray(surface.vertices[order].T)
        self.vertex_slices = part_slices(vertex_part[order])
        face_part = vertex_part[surface.faces[:, 0]]
        by_part = np.argsort(face_part, kind="stable")
        self.faces: Int[np.ndarray, "f 3"] = number[surface.faces[by_part]]
        self.face_slices = part_slices(face_part[by_part])
        hulls = [s.start + extreme_point_indices(self.vertices[:, s].T, near=NEAR_VERTEX_SHARE) for s in self.vertex_slices]
        self.extreme: Float[np.ndarray, "3 h"] = np.ascontiguousarray(self.vertices[:, np.concatenate(hulls)])
        self.extreme_slices = slices_between_ends(np.cumsum([0, *(len(hull) for hull in hulls)]))
        self.shape = shape

    def camera_from_parts(
        self,
        world_from_vehicle: Float[np.ndarray, "n 4 4"],
        world_from_camera: Float[np.ndarray, "n 4 4"],
        angles: Float[np.ndarray, "n p"],
    ) -> Float[np.ndarray, "n p 3 4"]:
        """Return the poses of each part in the camera's frame."""
        camera_axes = np.swapaxes(world_from_camera[:, :3, :3], 1, 2)
        camera_from_vehicle = np.empty((len(world_from_vehicle), 3, 4))
        camera_from_vehicle[:, :, :3] = matrix_product(camera_axes, world_from_vehicle[:, :3, :3])
        # The difference first: far from the origin the digits are in it.
        apart = world_from_vehicle[:, :3, 3] - world_from_camera[:, :3, 3]
        camera_from_vehicle[:, :, 3] = matrix_product(camera_axes, apart[:, :, None])[:, :, 0]
        if not angles.any():
            return np.broadcast_to(camera_from_vehicle[:, None], (*angles.shape, 3, 4))
        return compose_affine(camera_from_vehicle[:, None], self.shape.vehicle_from_parts(angles)[:, :, :3])


def transform_part_points(
    points: Float[np.ndarray, "3 v"], slices: Sequence[slice], b_from_parts: Float[np.ndarray, "n p 3 4"]
) -> Float[np.ndarray, "3 n v"]:
    """Return points of all parts in n frames, by explicit sums: a point's bits depend on point and pose alone."""
    moved = np.empty((3, len(b_from_parts), points.shape[1]))
    scratch = np.empty(moved.shape[1:])
    for part, place in enumerate(slices):
        x, y, z = points[:, place]
        term = scratch[:, place]
        for row in range(3):
            a, b, c, d = b_from_parts[:, part, row, :].T[:, :, None]
            out = moved[row, :, place]
            np.multiply(a, x, out=out)
            out += np.multiply(b, y, out=term)
            out += np.multiply(c, z, out=term)
            out += d
    return moved


def slices_between_ends(ends: Int[np.ndarray, " n"]) -> list[slice]:
    """Return the ranges between consecutive ends."""
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
