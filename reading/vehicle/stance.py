"""Transform a vehicle's pieces from the file's axes to meters, x forward, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hulldown.geometry.transforms import rotation_z, transform_points
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import GUN_HINTS, GUN_WORDS, NOT_GUN, first_matching_pattern, first_matching_stem
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Evaluated, Piece
from hulldown.reading.vehicle.nose import Direction, find_nose_direction
from hulldown.reading.vehicle.solids import Solids, Wheels, find_solids, find_wheels

UP_AXES = ("z", "-z", "y", "-y", "x", "-x")
MAX_SUNK_RADII = 0.5  # a vehicle that reaches farther below its wheels isn't surely upside down
MIN_SURE_WHEELS = 6  # on one plane
MIN_UP_COSINE = float(np.cos(np.radians(12.0)))  # between up and the file's axis
NOSE_YAWS = {"+x": 0.0, "+y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}


@dataclass(frozen=True, eq=False, slots=True)
class Upright:
    """The drawn pieces of a file, in meters with z up."""

    drawn: Evaluated  # all pieces, with bounds in that frame
    meters: Float[np.ndarray, "4 4"]  # from the file to that frame
    up: Direction[str]
    solids: Solids  # solids of all pieces, in that frame


def turn_pieces_upright(drawn: Evaluated, *, unit: float, stated_up: str, up: str | None) -> Upright:
    """Turn drawn pieces upright by the config's up axis, or by their wheels; `unit` is the file's unit in meters."""
    meters = meters_from_file(unit, stated_up)
    points = [transform_points(meters @ p.pose, drawn.meshes[p.mesh].vertices) for p in drawn.pieces]
    solids = find_solids(points, [drawn.meshes[p.mesh].faces for p in drawn.pieces])
    found = Direction(up, "as the config states") if up else find_up_axis(find_wheels(solids), stated_up)
    if found.value == stated_up:
        return Upright(drawn, meters, found, solids)
    upright = meters_from_file(unit, found.value)
    turn = (upright @ np.linalg.inv(meters))[:3, :3]
    pieces = []
    for piece, own in zip(drawn.pieces, points, strict=True):
        used = np.unique(drawn.meshes[piece.mesh].faces)
        turned = own[used] @ turn.T
        pieces.append(replace(piece, bounds=np.stack([turned.min(axis=0), turned.max(axis=0)])))
    return Upright(replace(drawn, pieces=pieces), upright, found, solids.rotate_solids(turn))


def find_up_axis(wheels: Wheels | None, stated: str) -> Direction[str]:
    """Find the file's up axis."""
    if wheels is None:
        return Direction(stated, "as .obj files usually have" if stated == "y" else "as the file states")
    up = z_up_rotation(stated)[:3, :3].T @ wheels.up
    axis = next((axis for axis in UP_AXES if float(z_up_rotation(axis)[2, :3] @ up) > MIN_UP_COSINE), None)
    if axis is None:
        doubt = Doubt(DoubtKind.UP, "its wheels stand askew to the axes; set up, or turn it upright in Blender")
        return Direction(stated, "as the file states", doubt)
    if axis and wheels.sunk > MAX_SUNK_RADII and axis.removeprefix("-") == stated.removeprefix("-"):
        return Direction(stated, "as the file states")  # it reaches beyond the wheels on both sides
    if axis == stated:
        return Direction(stated, f"as the file states, and {wheels.places} wheels")
    why = f"{wheels.places} wheels lie below the rest of it"
    doubt = Doubt(DoubtKind.UP, f'{axis} is taken to be up, since {why}; set up = "{stated}" if that is wrong', "up", axis)
    sure = stated != "z" or (wheels.places >= MIN_SURE_WHEELS and axis != f"-{stated}")
    return Direction(axis, f"{why}, not {stated} as the file states", None if sure else doubt)


def refind_solids_of_pieces(upright: Upright, kept: Sequence[int]) -> Upright:
    """Find solids in these pieces alone, since larger ones of others may have replaced theirs."""
    pieces, meshes = [upright.drawn.pieces[i] for i in kept], upright.drawn.meshes
    points = [transform_points(upright.meters @ piece.pose, meshes[piece.mesh].vertices) for piece in pieces]
    solids = find_solids(points, [meshes[piece.mesh].faces for piece in pieces])
    return replace(upright, solids=replace(solids, piece=np.asarray(kept)[solids.piece]))


def z_up_rotation(axis: str) -> Float[np.ndarray, "4 4"]:
    """Return the rotation that turns an axis of the file to z: about x for y, -y, and -z, about y for x and -x."""
    turn = {
        "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    }[axis]
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    return matrix


def meters_from_file(unit: float, up: str) -> Float[np.ndarray, "4 4"]:
    """Return the transform from a file's coordinates to meters, z up, with the same origin."""
    return np.diag([unit, unit, unit, 1.0]) @ z_up_rotation(up)


def find_nose_and_wheels(
    upright: Upright, kept: Sequence[int], options: Options
) -> tuple[Direction[float], Solids, Wheels | None]:
    """Return the nose of the kept pieces, their solids numbered as in `kept`, and their wheels; z up."""
    solids = upright.solids.solids_of_pieces(kept)
    wheels = find_wheels(solids)
    if wheels is not None and wheels.up[2] < 0.9:
        wheels = None
    if options.forward is None:
        names = [upright.drawn.pieces[i].name for i in kept]
        gun = [_is_named_gun(upright.drawn.pieces[i]) for i in kept]
        found = find_nose_direction(solids, wheels, names, gun=gun, corners=_piece_triangles(upright, kept))
    else:
        found = Direction(_angle_from_forward_key(options.forward), "as the config states")
    return found, solids, wheels


def _piece_triangles(upright: Upright, kept: Sequence[int]) -> Float[np.ndarray, "f 3 3"]:
    pieces, meshes = [upright.drawn.pieces[i] for i in kept], upright.drawn.meshes
    placed = [transform_points(upright.meters @ p.pose, meshes[p.mesh].vertices)[meshes[p.mesh].faces] for p in pieces]
    return np.concatenate(placed)


def _angle_from_forward_key(forward: str | float | tuple[float, ...]) -> float:
    if isinstance(forward, str):
        return NOSE_YAWS[forward]
    if isinstance(forward, tuple):
        return float(np.arctan2(forward[1], forward[0]))
    return float(np.radians(forward))


def vehicle_from_upright(angle: float) -> Float[np.ndarray, "4 4"]:
    """Return the rotation about z from a nose at `angle` to +x; exact for multiples of a right angle."""
    turned = np.eye(4)
    rotation = rotation_z(-angle)
    quarter = abs(angle / (np.pi / 2) - np.round(angle / (np.pi / 2))) < 1e-12
    turned[:3, :3] = np.round(rotation, 12) + 0.0 if quarter else rotation
    return turned


def _is_named_gun(piece: Piece) -> bool:
    names = [link.name for link in piece.chain]
    return any(
        (first_matching_pattern(n, GUN_WORDS) or first_matching_stem(n, GUN_HINTS)) and not first_matching_pattern(n, NOT_GUN)
        for n in names
    )
