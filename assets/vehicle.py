"""A vehicle's shape: one mesh whose vertices belong to rigid parts that turn about pivots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import axis_rotation, compose_affine, matrix_product, transform_points

Articulation = Mapping[str, float]  # part name -> radians; parts not named are at rest


@dataclass(frozen=True, eq=False, slots=True)
class VehicleShape:
    """A vehicle at rest in its own frame: x forward, y left, z up, meters, origin at the center of its underside."""

    name: str  # the vehicle's name, unique in a config
    mesh: Mesh  # all triangles of all parts, turret and gun at angle zero
    # index of the part each vertex belongs to; part 0 is the hull. No face spans two parts.
    vertex_part: Int[np.ndarray, " v"]
    part_names: tuple[str, ...]
    # index of the part each part rides on; -1 for the hull. Parents come before children.
    part_parent: Int[np.ndarray, " p"]
    # a point on each part's axis of rotation, vehicle frame at rest; zeros for the hull
    part_pivot: Float[np.ndarray, "p 3"]
    # unit axis of rotation, vehicle frame at rest; +z for the hull, which never turns. Positive angles turn a turret
    # counterclockwise seen from above and raise a gun.
    part_axis: Float[np.ndarray, "p 3"]
    part_limits: Float[np.ndarray, "p 2"]  # lowest and highest angle in radians; zeros for the hull
    # affine: from the world coordinates of the file it was read from to the vehicle frame (scale to meters, up and
    # forward axis, origin), so that the renderer can place the file's own objects
    vehicle_from_file: Float[np.ndarray, "4 4"]
    # heights of the mesh's underside, as `placement.footprint.vehicle_underside` finds them; empty: not known
    underside: Float[np.ndarray, "a b"] = field(default_factory=lambda: np.zeros((0, 0)))
    # keypoint_names, keypoints, keypoint_part: name, (k, 3) place in the vehicle frame at rest, and (k,) index of the
    # part of each keypoint
    keypoint_names: tuple[str, ...] = ()
    keypoints: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    keypoint_part: Int[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    # seen, seen_part: what can be seen of the mesh, by `geometry.seen_mesh_and_source_faces`, and the part of each of its
    # vertices. None: the whole mesh.
    seen: Mesh | None = None
    seen_part: Int[np.ndarray, " s"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def surface(self) -> tuple[Mesh, Int[np.ndarray, " s"]]:
        """The visible mesh, which boxes and sizes are computed from, and the part of each of its vertices."""
        return (self.mesh, self.vertex_part) if self.seen is None else (self.seen, self.seen_part)

    def seen_part_vertices(self, part: int) -> Float[np.ndarray, "v 3"]:
        """Return a part's visible vertices, at rest; none if it's wholly transparent."""
        surface, vertex_part = self.surface
        return surface.vertices[vertex_part == part]

    @property
    def size_xyz(self) -> Float[np.ndarray, "3"]:
        """Length, width, and height of the visible mesh's bounding box, at rest."""
        low, high = self.surface[0].bounds
        return high - low

    def angles(self, articulations: Sequence[Articulation]) -> Float[np.ndarray, "n p"]:
        """Return the angles of all parts in n articulations; 0 for parts that aren't named."""
        column = {name: i for i, name in enumerate(self.part_names) if i}
        angles = np.zeros((len(articulations), len(self.part_names)))
        for row, articulation in enumerate(articulations):
            for name, angle in articulation.items():
                if name not in column:
                    raise ValueError(f"articulation: {self.name!r} has no part {name!r}; it has {list(column)}")
                angles[row, column[name]] = angle
        return angles

    def vehicle_from_parts(
        self, articulation: Articulation | Sequence[Articulation] | Float[np.ndarray, "n p"]
    ) -> Float[np.ndarray, "... p 4 4"]:
        """Poses of articulated parts relative to rest: (p, 4, 4), or (n, p, 4, 4) for n articulations or their angles.

        A row's bits depend on that row alone.
        """
        if isinstance(articulation, Mapping):
            return self.vehicle_from_parts([articulation])[0]
        angles = articulation if isinstance(articulation, np.ndarray) else self.angles(articulation)
        poses = np.zeros((*angles.shape, 4, 4))
        poses[:] = np.eye(4)
        affine = poses[:, :, :3]
        turned = angles.any(axis=0)
        for i in np.flatnonzero(turned):
            pivot = self.part_pivot[i]
            affine[:, i, :, :3] = axis_rotation(self.part_axis[i], angles[:, i])
            affine[:, i, :, 3] = pivot - matrix_product(affine[:, i, :, :3], pivot[:, None])[..., 0]
        if turned.any():
            for i, parent in enumerate(self.part_parent):
                if parent >= 0:
                    affine[:, i] = compose_affine(affine[:, parent], affine[:, i])
        return poses

    def articulated_keypoints(
        self, articulation: Articulation | Sequence[Articulation] | Float[np.ndarray, "1 p"]
    ) -> Float[np.ndarray, "k 3"]:
        """Return keypoints in the vehicle frame with the parts turned."""
        poses = self.vehicle_from_parts(articulation).reshape(-1, 4, 4)[self.keypoint_part]
        return transform_points(poses, self.keypoints[:, None])[:, 0]

    def with_keypoints(self, points: Mapping[str, tuple[ArrayLike, int | None]]) -> VehicleShape:
        """Add keypoints: position in the vehicle frame at rest, and index of the part.

        A keypoint without a part belongs to the part with the nearest surface. One with an existing name replaces it.
        """
        if not points:
            return self  # equal files share their arrays
        known = zip(self.keypoint_names, self.keypoints, self.keypoint_part.tolist(), strict=True)
        every: dict[str, tuple[ArrayLike, int | None]] = {name: (point, part) for name, point, part in known}
        every |= points
        part = [self._nearest_part(point) if given is None else given for point, given in every.values()]
        places = np.array([point for point, _ in every.values()], dtype=np.float64).reshape(-1, 3)
        return replace(self, keypoint_names=tuple(every), keypoints=places, keypoint_part=np.array(part, dtype=np.int64))

    def _nearest_part(self, point: ArrayLike) -> int:
        return int(self.vertex_part[self.mesh.faces[self.mesh.nearest_face(point), 0]])
