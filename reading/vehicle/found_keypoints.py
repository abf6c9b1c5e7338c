"""Keypoints of a vehicle: muzzle, turret, outer wheels, and empties with keypoint names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from hulldown.assets.skeleton import MUZZLE, TURRET, WHEELS
from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.rays import RayCaster
from hulldown.reading.pieces.roles import Link
from hulldown.reading.vehicle.part_names import GUN_PART, TURRET_PART, key_of
from hulldown.reading.vehicle.solids import Solids, Wheels

_NAMED = re.compile(r"(?:kp_|keypoint[_.\- ]*)(.*)", re.IGNORECASE | re.DOTALL)
AHEAD = 0.02  # meters from a gun's front end to its muzzle, so that the gun doesn't hide it from the side
TIP = 0.03  # meters behind the front end that belong to it
OUT = 0.01  # meters from a wheel's outer side


def keypoint_of(name: str) -> str | None:
    """Return the keypoint of an empty with this name; None if it isn't one."""
    found = _NAMED.fullmatch(name)
    return (found[1] or name) if found else None


def marked_points(
    markers: Sequence[tuple[Link, ...]], chains: Sequence[tuple[Link, ...]], piece_part: Sequence[int]
) -> dict[str, tuple[Float[np.ndarray, "3"], int | None]]:
    """Keypoints of empties: positions in the file, and the part that each belongs to, if any."""
    parts_below: dict[tuple[str, bytes], set[int]] = {}
    for chain, part in zip(chains, piece_part, strict=True):
        for link in chain:
            parts_below.setdefault(key_of(link), set()).add(part)
    own = {key_of(chain[0]): part for chain, part in zip(chains, piece_part, strict=True)}
    found: dict[str, tuple[Float[np.ndarray, "3"], int | None]] = {}
    for marker, *above in markers:
        if (name := keypoint_of(marker.name)) is None or name in found:
            continue
        # The first one above it that is a piece, or only holds pieces of one part.
        below = (({own[key]} if key in own else parts_below.get(key, set())) for key in map(key_of, above))
        found[name] = marker.pose[:3, 3], next((min(parts) for parts in below if len(parts) == 1), None)
    return found


def known_points(
    shape: VehicleShape, solids: Solids, wheels: Wheels | None, base: Float[np.ndarray, "3"]
) -> Mapping[str, tuple[Float[np.ndarray, "3"], int]]:
    """Keypoints of a vehicle's parts, in its frame at rest, and the index of their part.

    `solids`, `wheels`: of its pieces, in its axes, with the origin of the vehicle's frame at `base`.
    """
    part = {name: i for i, name in enumerate(shape.part_names)}
    found = {}
    if GUN_PART in part and (muzzle := _muzzle(shape, part[GUN_PART])) is not None:
        found[MUZZLE] = muzzle, part[GUN_PART]
    if TURRET_PART in part:
        found[TURRET] = _roof(shape, part[TURRET_PART]), part[TURRET_PART]
    if wheels is not None:
        discs = solids.where(wheels.index)
        for name in WHEELS:
            left, front = name.endswith("left"), "front" in name
            side = discs.where((discs.center[:, 1] > np.median(discs.center[:, 1])) == left)
            if not len(side):
                continue
            along = side.center[:, 0] if front else -side.center[:, 0]
            end = side.where(along > along.max() - side.radius / 2)
            x, _, z = end.center.mean(axis=0)
            y = end.bounds[:, 1, 1].max() + OUT if left else end.bounds[:, 0, 1].min() - OUT
            found[name] = np.array([x, y, z]) - base, 0
    return found


def _muzzle(shape: VehicleShape, part: int) -> Float[np.ndarray, "3"] | None:
    """Return the point just ahead of the middle of the gun's front end; None for a gun without length or unseen."""
    points = shape.seen_of(part)
    if not len(points):
        return None
    pivot, axis = shape.part_pivot[part], shape.part_axis[part]
    off = points - pivot
    out = off[np.argmax(np.linalg.norm(off, axis=1))]
    out = out - (out @ axis) * axis
    if not (length := np.linalg.norm(out)) > 0.0:
        return None
    out /= length
    along = off @ out
    tip = points[along >= along.max() - TIP]
    middle = (tip.min(axis=0) + tip.max(axis=0)) / 2
    return middle + (along.max() + AHEAD - (middle - pivot) @ out) * out


def _roof(shape: VehicleShape, part: int) -> Float[np.ndarray, "3"]:
    """Return the point where the turret's axis leaves its roof."""
    mesh = shape.mesh.of_faces(np.flatnonzero(shape.vertex_part[shape.mesh.faces[:, 0]] == part))
    low, high = mesh.bounds
    x, y, _ = shape.part_pivot[part]
    top = high[2] + 1.0
    down = RayCaster(mesh).cast([[x, y, top]], [[0.0, 0.0, -1.0]])
    if not down.hit[0]:
        return np.array([*(low + high)[:2] / 2, high[2]])
    return np.array([x, y, top - down.distance[0]])
