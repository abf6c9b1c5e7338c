"""Find vehicles that stand in a scenery, which get no label."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hulldown.geometry.transforms import transform_points
from hulldown.reading.pieces.naming import NOT_VEHICLE_WORDS, VEHICLE_WORDS, first_matching_pattern
from hulldown.reading.pieces.roles import Evaluated, PieceRole
from hulldown.reading.vehicle.solids import find_solids, find_wheels

MIN_LENGTH_M, MAX_LENGTH_M, MIN_HEIGHT_M, MAX_HEIGHT_M = 1.8, 25.0, 0.6, 5.0
MAX_ASPECT = 12.0  # length over width; longer things are walls
MAX_THING_FACES = 50_000  # of one thing whose shape is examined
MAX_ALL_FACES = 1_000_000  # of all such things
MIN_UPRIGHT_COSINE = 0.9


def parked_vehicles(drawn: Evaluated, roles: Sequence[PieceRole], meters: Float[np.ndarray, "4 4"]) -> dict[str, list[str]]:
    """Find obstacles that are vehicles, by a name or by wheels: the name of each, and of its objects."""
    pieces = drawn.pieces
    among = [i for i, role in enumerate(roles) if role.use == "obstacle" and not pieces[i].hair]
    found: dict[str, list[str]] = {}
    looked: dict[tuple[int, ...], bool] = {}
    left = MAX_ALL_FACES
    for name, group in _vehicle_sized_groups(drawn, among):
        own = list(dict.fromkeys(pieces[i].name for i in group))
        names = [name, *own, *(pieces[i].data for i in group), *pieces[group[0]].chain[0].collections[:1]]
        is_one = any(
            first_matching_pattern(n, VEHICLE_WORDS) and not first_matching_pattern(n, NOT_VEHICLE_WORDS) for n in names
        )
        key, faces = tuple(sorted(pieces[i].mesh for i in group)), sum(pieces[i].faces for i in group)
        if not is_one and key not in looked and faces <= min(MAX_THING_FACES, left):
            left -= faces
            points = [transform_points(meters @ pieces[i].pose, drawn.meshes[pieces[i].mesh].vertices) for i in group]
            wheels = find_wheels(find_solids(points, [drawn.meshes[pieces[i].mesh].faces for i in group]))
            looked[key] = wheels is not None and wheels.up[2] > MIN_UPRIGHT_COSINE
        if is_one or looked.get(key):
            found.setdefault(name, []).extend(own)
    return found


def _vehicle_sized_groups(drawn: Evaluated, among: Sequence[int]) -> list[tuple[str, list[int]]]:
    """Group things as large as a vehicle: pieces by their topmost parent that isn't larger, with its name."""
    carried: dict[tuple[str, bytes], list[int]] = {}
    for i in among:
        for link in drawn.pieces[i].chain:
            carried.setdefault((link.name, link.pose.tobytes()), []).append(i)
    fits: dict[tuple[str, bytes], bool] = {}
    for key, members in carried.items():
        box = np.array([drawn.pieces[i].bounds for i in members])
        *sides, height = box[:, 1].max(axis=0) - box[:, 0].min(axis=0)
        narrow, wide = sorted(sides)
        fits[key] = MIN_LENGTH_M <= wide <= min(MAX_LENGTH_M, MAX_ASPECT * narrow) and MIN_HEIGHT_M <= height <= min(
            MAX_HEIGHT_M, 2 * wide
        )
    groups: dict[tuple[str, bytes], list[int]] = {}
    for i in among:
        keys = [(link.name, link.pose.tobytes()) for link in drawn.pieces[i].chain]
        top = next((key for key in reversed(keys) if fits[key]), None)
        if top:
            groups.setdefault(top, []).append(i)
    return [(name, members) for (name, _), members in groups.items()]
