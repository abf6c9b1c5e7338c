"""The up axis of a vehicle's file, by its wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.hierarchy import fclusterdata

from hulldown.reading.vehicle.solids import Solids

Value = TypeVar("Value", str, float)
UPS = ("z", "-z", "y", "-y", "x", "-x")
PARALLEL = float(np.cos(np.radians(4.0)))
LEAST_WHEELS = 4
FLAT_WHEELS = 0.5  # centers of wheels lie in one plane, give or take this share of their radius
CERTAIN = 6  # wheels on one plane that are sure
UPRIGHT = float(np.cos(np.radians(12.0)))  # up is the file's axis that is this close


@dataclass(frozen=True, slots=True)
class Direction(Generic[Value]):
    """A direction of a vehicle, the reason, and a sentence for the user; empty if it's sure.

    `value` is the file's up axis ("z", "-y", ...), or the nose's angle: radians counterclockwise from +x, with z up.
    """

    value: Value
    why: str
    doubt: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class Wheels:
    """A vehicle's wheels.

    Parameters
    ----------
    index
        Indices of their solids.
    up, across
        Unit vectors: up from the ground, and along the axles.
    level
        Height along `up` of the ground under them.
    places
        Their number, where a tire and its rim are one.
    """

    index: Int[np.ndarray, " w"]
    up: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "3"]
    level: float
    places: int


def up_matrix(axis: str) -> Float[np.ndarray, "4 4"]:
    """The rotation that turns an axis of the file ("z", "y", "x", or with a minus) to z.

    About x for y and -y, about y for x and -x, and a half turn about x for -z.
    """
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


def find_wheels(solids: Solids) -> Wheels | None:
    """The largest set of similar discs side by side on one plane, or None."""
    discs = np.flatnonzero(
        (solids.round_about >= 0)
        & (solids.size[np.arange(len(solids)), np.maximum(solids.round_about, 0)] < 2.5 * solids.radius)
    )
    axle, radius, center = solids.axle[discs], solids.radius[discs], solids.center[discs]
    best, best_score = None, 0.0
    left = np.ones(len(discs), bool)
    for seed in np.argsort(-radius):
        if not left[seed] or radius[seed] <= 0:
            continue
        alike = (np.abs(axle @ axle[seed]) > PARALLEL) & (radius > 0.75 * radius[seed]) & (radius < 1.34 * radius[seed])
        left &= ~alike
        found = _standing(center[alike], radius[alike], axle[seed])
        if found is not None and found[0] > best_score:
            best_score, best = found[0], (discs[alike][found[3]], *found[1:3])
    if best is None:
        return None
    index, up, across = best
    middle = solids.center[index].mean(axis=0)
    # The body is on the side where the vehicle reaches farther, floors and other sheets aside.
    thick = solids.size[:, 2] > 0.02 * solids.size[:, 0]
    heights = (solids.center[thick] - middle) @ up
    weight = solids.size[thick].prod(axis=1) ** (1 / 3)
    if float(heights @ weight) < 0:
        up = -up
    level = float((solids.center[index] @ up - solids.radius[index]).min())
    # A tire and its rim are one wheel.
    joined = fclusterdata(solids.center[index], 0.7 * float(solids.radius[index].mean()), criterion="distance")
    return Wheels(index, up, across, level, places=int(joined.max()))


def _standing(
    center: Float[np.ndarray, "n 3"], radius: Float[np.ndarray, " n"], axle: Float[np.ndarray, "3"]
) -> tuple[float, np.ndarray, np.ndarray, Bool[np.ndarray, " n"]] | None:
    """Score, up (either way) and axle of discs if they are wheels, and which of them are."""
    keep = np.ones(len(center), bool)
    for _ in range(3):
        if keep.sum() < LEAST_WHEELS:
            return None
        off = center[keep] - np.median(center[keep], axis=0)
        along_axle = off @ axle
        flat = off - along_axle[:, None] * axle
        _, _, directions = np.linalg.svd(flat, full_matrices=False)
        ahead = directions[0] - (directions[0] @ axle) * axle
        ahead /= np.linalg.norm(ahead)
        up = np.cross(ahead, axle)
        up /= np.linalg.norm(up)
        lift = np.abs((center - np.median(center[keep], axis=0)) @ up)
        within = lift < FLAT_WHEELS * np.median(radius)
        if (within == keep).all():
            break
        keep = within
    size = float(np.median(radius[keep])) if keep.any() else 0.0
    if keep.sum() < LEAST_WHEELS:
        return None
    base, track = float(np.ptp(center[keep] @ ahead)), float(np.ptp(center[keep] @ axle))
    if not (3.0 * size < base < 40.0 * size and 1.5 * size < track < base * 1.6):
        return None
    return base * track * size, up, axle, keep


def find_up(wheels: Wheels | None, stated: str) -> Direction[str]:
    """Find the file's up axis.

    Parameters
    ----------
    wheels
        Wheels found with the stated axis up.
    stated
        The file's stated up axis: "z", or "y" by convention in OBJ files, which needs no doubt.
    """
    if wheels is None:
        return Direction(stated, "as the file states")
    up = up_matrix(stated)[:3, :3].T @ wheels.up
    axis = next((axis for axis in UPS if float(up_matrix(axis)[2, :3] @ up) > UPRIGHT), None)
    if axis is None:
        doubt = "its wheels stand askew to the axes; set up, or turn it upright in Blender"
        return Direction(stated, "as the file states", doubt)
    if axis == stated:
        return Direction(stated, f"as the file states, and {wheels.places} wheels")
    why = f"{wheels.places} wheels lie below the rest of it"
    doubt = f'{axis} is taken to be up, since {why}; set up = "{stated}" if that is wrong'
    sure = stated != "z" or (wheels.places >= CERTAIN and axis != f"-{stated}")
    return Direction(axis, f"{why}, not {stated} as the file states", "" if sure else doubt)
