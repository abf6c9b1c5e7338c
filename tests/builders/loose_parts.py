"""Vehicles of named solids, read as those of a file."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rigid_matrix, rotation_z, transform_points
from hulldown.reading.build import BuiltVehicle, build_vehicle
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Evaluated, Link, Piece
from hulldown.reading.vehicle.stance import meters_from_file, turn_pieces_upright
from hulldown.tests.builders.shapes import CORNERS, FACES


def box(size: ArrayLike, at: ArrayLike) -> Mesh:
    return Mesh((CORNERS - 0.5) * size + at, FACES)


def tube(start: ArrayLike, end: ArrayLike, radius: float, *, sides: int = 16) -> Mesh:
    """A closed prism."""
    mesh = trimesh.creation.cylinder(radius, sections=sides, segment=(start, end))
    return Mesh(mesh.vertices, mesh.faces)


TANK = {
    "Hull": box((6, 2.4, 1), (0, 0, 1)),
    **{f"W{i}{side}": tube((x, 1.4 * side, 0.4), (x, 1.1 * side, 0.4), 0.4)
       for i, x in enumerate((-2.2, -1.0, 0.2, 1.6)) for side in (-1, 1)},
    "Turret": box((2.6, 2, 0.7), (-0.2, 0, 1.95)),
    "Turret_Ring": tube((0.1, 0, 1.45), (0.1, 0, 1.7), 0.9),
    "Gun": tube((1.0, 0, 1.9), (5.5, 0, 1.9), 0.07),
}  # fmt: skip
TRUCK = {k: TANK[k] for k in TANK if k[0] == "W"} | {"Hull": TANK["Hull"], "Cab": box((1.5, 2, 1.2), (2, 0, 2))}
CAR = {k: mesh for k, mesh in TRUCK.items() if k[:2] not in ("W1", "W2")}
MIRRORS = {f"P{s}": box((0.1, 0.3, 0.3), (1.2, 1.55 * s, 1.9)) for s in (-1, 1)}
MIRRORED = {k: mesh for k, mesh in CAR.items() if k != "Cab"} | MIRRORS


def read(
    parts: dict[str, Mesh],
    pose: np.ndarray | None = None,
    *,
    stated: str = "z",
    hidden: tuple[str, ...] = (),
    **options: object,
) -> BuiltVehicle:
    """The vehicle of a file with these parts, with all origins at zero."""
    found, given = Evaluated(), Options(**options)
    for i, (name, mesh) in enumerate(parts.items()):
        placed = mesh.with_vertices(transform_points(np.eye(4) if pose is None else pose, mesh.vertices))
        found.meshes.append(placed)
        bounds = placed.with_vertices(transform_points(meters_from_file(1.0, stated), placed.vertices)).bounds
        link = Link(name, (), "MESH", np.eye(4))
        found.pieces.append(Piece(name, (link,), i, np.eye(4), bounds, len(mesh.faces), hidden=name in hidden))
    upright = turn_pieces_upright(found, unit=1.0, stated_up=stated, up=given.up)
    return build_vehicle("v", upright, given)


def kinds(built) -> list[DoubtKind]:
    """The kinds of its doubts."""
    return [doubt.kind for doubt in built.doubts]


def turned(yaw_deg: float) -> np.ndarray:
    return rigid_matrix(rotation_z(np.radians(yaw_deg)), np.zeros(3))
