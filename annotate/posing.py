"""A vehicle's surface as coordinate rows that are moved into camera frames by plain sums, the same bits every time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from assets.vehicle import VehicleShape
from geometry.hulls import extreme_points

NEAR_VERTEX = 1e-9  # of a part's size: points this close to a hull vertex may be extreme in its place by rounding


class PosedParts:
    """The used vertices of a vehicle, grouped by rigid part, and those of them that can be extreme in an image.

    Parameters
    ----------
    shape
        The vehicle.

    Attributes
    ----------
    vertices
        (3, v) used vertices at rest, part after part.
    faces
        (f, 3) indices into them, part after part.
    extreme
        (3, h) the vertices of each part's convex hull: a linear function of the part's points, such as being left of
        a line of the image, is greatest at one of them.
    vertex_slices, face_slices, extreme_slices
        Where each part's begin and end.
    """

    def __init__(self, shape: VehicleShape) -> None:
        parts = len(shape.part_names)
        used = np.unique(shape.mesh.faces)
        order = used[np.argsort(shape.vertex_part[used], kind="stable")]
        number = np.empty(len(shape.mesh.vertices), dtype=np.int64)
        number[order] = np.arange(len(order))
        self.vertices: Float[np.ndarray, "3 v"] = np.ascontiguousarray(shape.mesh.vertices[order].T)
        self.vertex_slices = _slices(shape.vertex_part[order], parts)
        face_part = shape.vertex_part[shape.mesh.faces[:, 0]]
        by_part = np.argsort(face_part, kind="stable")
        self.faces: Int[np.ndarray, "f 3"] = number[shape.mesh.faces[by_part]]
        self.face_slices = _slices(face_part[by_part], parts)
        hulls = [s.start + extreme_points(self.vertices[:, s].T, near=NEAR_VERTEX) for s in self.vertex_slices]
        self.extreme: Float[np.ndarray, "3 h"] = np.ascontiguousarray(self.vertices[:, np.concatenate(hulls)])
        self.extreme_slices = _slices(np.repeat(np.arange(parts), [len(hull) for hull in hulls]), parts)
        self._shape = shape

    def angles(self, articulations: Sequence[Mapping[str, float]]) -> Float[np.ndarray, "n p"]:
        """Angles of all parts from {part name: radians}; zero where not named.

        Raises
        ------
        ValueError
            If one names a part the vehicle does not have.
        """
        column = {name: i for i, name in enumerate(self._shape.part_names) if i}
        angles = np.zeros((len(articulations), len(self._shape.part_names)))
        for row, articulation in enumerate(articulations):
            for name, angle in articulation.items():
                if name not in column:
                    raise ValueError(f"articulation: {self._shape.name!r} has no part {name!r}; it has {list(column)}")
                angles[row, column[name]] = angle
        return angles

    def vehicle_from_parts(self, angles: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p 3 4"]:
        """`VehicleShape.vehicle_from_parts` for many articulations at once, without the last row."""
        poses = np.zeros((*angles.shape, 3, 4))
        poses[:, :, :, :3] = np.eye(3)
        for i in np.flatnonzero(angles.any(axis=0)):
            turn = _turn(self._shape.part_axis[i], np.ascontiguousarray(angles[:, i]))
            pivot = self._shape.part_pivot[i]
            poses[:, i, :, :3] = turn
            poses[:, i, :, 3] = pivot - _product(turn, pivot[:, None])[..., 0]
        for i, parent in enumerate(self._shape.part_parent):
            if parent >= 0:
                poses[:, i] = _compose(poses[:, parent], poses[:, i])
        return poses

    def camera_from_parts(
        self,
        world_from_vehicle: Float[np.ndarray, "n 4 4"],
        world_from_camera: Float[np.ndarray, "n 4 4"],
        angles: Float[np.ndarray, "n p"],
    ) -> Float[np.ndarray, "n p 3 4"]:
        """Where poses and angles take each part at rest, in the camera's frame."""
        camera_axes = np.swapaxes(world_from_camera[:, :3, :3], 1, 2)
        camera_from_vehicle = np.empty((len(world_from_vehicle), 3, 4))
        camera_from_vehicle[:, :, :3] = _product(camera_axes, world_from_vehicle[:, :3, :3])
        # The difference first: far from the origin the digits are in it.
        apart = world_from_vehicle[:, :3, 3] - world_from_camera[:, :3, 3]
        camera_from_vehicle[:, :, 3] = _product(camera_axes, apart[:, :, None])[:, :, 0]
        if not angles.any():
            return np.broadcast_to(camera_from_vehicle[:, None], (*angles.shape, 3, 4))
        return _compose(camera_from_vehicle[:, None], self.vehicle_from_parts(angles))


def move(
    points: Float[np.ndarray, "3 v"], slices: Sequence[slice], b_from_parts: Float[np.ndarray, "n p 3 4"]
) -> Float[np.ndarray, "3 n v"]:
    """Points of all parts in n frames.

    Sums are written out, so that a point's result depends on nothing but the point and the pose: a matrix product
    rounds differently with the number of points beside it.
    """
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


def _compose(
    c_from_b: Float[np.ndarray, "*#n 3 4"], b_from_a: Float[np.ndarray, "*#n 3 4"]
) -> Float[np.ndarray, "*n 3 4"]:
    composed = _product(c_from_b[..., :3], b_from_a)
    composed[..., 3] += c_from_b[..., 3]
    return composed


def _product(a: Float[np.ndarray, "*#n 3 3"], b: Float[np.ndarray, "*#n 3 k"]) -> Float[np.ndarray, "*n 3 k"]:
    """Matrix products by sums that are written out: a row's bits do not depend on how many rows there are."""
    return a[..., :, 0:1] * b[..., 0:1, :] + a[..., :, 1:2] * b[..., 1:2, :] + a[..., :, 2:3] * b[..., 2:3, :]


def _turn(axis: Float[np.ndarray, "3"], angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Rodrigues' formula, as `geometry.transforms.rotation_about` has it, without its checks."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    theta = angle[:, None, None]
    return np.eye(3) + np.sin(theta) * cross + 2.0 * np.sin(theta / 2.0) ** 2 * (cross @ cross)


def _slices(part: Int[np.ndarray, " n"], parts: int) -> list[slice]:
    ends = np.searchsorted(part, np.arange(parts + 1))
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
