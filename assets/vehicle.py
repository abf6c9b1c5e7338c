"""A vehicle's shape: one mesh whose vertices belong to rigid parts that turn about pivots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from geometry.meshes import Mesh
from geometry.transforms import apply, rigid, rotation_about

HULL = 0  # the part that stands on the ground and turns about nothing


@dataclass(frozen=True, eq=False, slots=True)
class VehicleShape:
    """A vehicle at rest in its own frame: x forward, y left, z up, metres, origin at the centre of its underside.

    Parameters
    ----------
    name
        The vehicle's name, unique in a config.
    mesh
        All triangles of all parts, turret and gun at angle zero.
    vertex_part
        (v,) index of the part each vertex belongs to; part 0 is the hull. No face spans two parts.
    part_names
        ("hull", "turret", "gun", ...): what articulations are called.
    part_parent
        (p,) index of the part each part rides on; -1 for the hull. Parents come before children.
    part_pivot
        (p, 3) a point on each part's axis of rotation, vehicle frame at rest; zeros for the hull.
    part_axis
        (p, 3) unit axis of rotation, vehicle frame at rest; +z for the hull, which never turns. Positive angles
        turn a turret counter-clockwise seen from above and raise a gun.
    part_limits
        (p, 2) lowest and highest angle in radians; zeros for the hull.
    vehicle_from_file
        (4, 4) affine: from the world coordinates of the file it was read from to the vehicle frame
        (scale to metres, up and forward axis, origin), so that the renderer can place the file's own objects.
    """

    name: str
    mesh: Mesh
    vertex_part: Int[np.ndarray, " v"]
    part_names: tuple[str, ...]
    part_parent: Int[np.ndarray, " p"]
    part_pivot: Float[np.ndarray, "p 3"]
    part_axis: Float[np.ndarray, "p 3"]
    part_limits: Float[np.ndarray, "p 2"]
    vehicle_from_file: Float[np.ndarray, "4 4"]

    @property
    def size_xyz(self) -> Float[np.ndarray, "3"]:
        """Length, width, height of the bounding box at rest."""
        low, high = self.mesh.bounds
        return high - low

    def vehicle_from_parts(self, articulation: Mapping[str, float]) -> Float[np.ndarray, "p 4 4"]:
        """For each part, where `articulation` (part name -> radians) takes its rest position in the vehicle frame.

        Raises
        ------
        ValueError
            If `articulation` names a part the vehicle does not have.
        """
        if unknown := set(articulation) - set(self.part_names[1:]):
            raise ValueError(
                f"articulation: {self.name!r} has no part {sorted(unknown)}; it has {list(self.part_names[1:])}"
            )
        poses = np.tile(np.eye(4), (len(self.part_names), 1, 1))
        for i in range(1, len(self.part_names)):
            turn = rotation_about(self.part_axis[i], articulation.get(self.part_names[i], 0.0))
            about_pivot = rigid(turn, self.part_pivot[i] - turn @ self.part_pivot[i])
            poses[i] = poses[self.part_parent[i]] @ about_pivot
        return poses

    def vertices_at(self, articulation: Mapping[str, float]) -> Float[np.ndarray, "v 3"]:
        """All vertices in the vehicle frame with the parts turned."""
        vertices = self.mesh.vertices.copy()
        for i, pose in enumerate(self.vehicle_from_parts(articulation)):
            if i != HULL and not np.array_equal(pose, np.eye(4)):
                mine = self.vertex_part == i
                vertices[mine] = apply(pose, vertices[mine])
        return vertices
