"""Which way is up and which way is ahead in a vehicle's file: from wheels, gun and names, in any frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from assets.naming import FRONT, REAR, says
from reading.solids import Solids

UPS = ("z", "-z", "y", "-y", "x", "-x")
PARALLEL = float(np.cos(np.radians(4.0)))
LEAST_WHEELS = 4
FLAT_WHEELS = 0.5  # centres of wheels lie in one plane, give or take this share of their radius
UPRIGHT = float(np.cos(np.radians(12.0)))  # up is the file's axis that is this close
SNAP = np.radians(1.5)  # a nose this close to an axis of the file points along it
SLENDER = 7.0  # a gun's barrel is longer than this many times its width
MIRRORED = 60  # solids whose mirror plane is sought
SYMMETRIC = 0.01  # a mirror image is this close to its original, in lengths of the vehicle
VOTE = 0.4  # names in front outweigh names behind by this much, in half lengths of the vehicle


@dataclass(frozen=True, slots=True)
class Forward:
    """Where the nose points once z is up.

    Parameters
    ----------
    angle
        Radians counter-clockwise from +x.
    why
        How that was found out.
    doubt
        What a person should look at; empty if nothing.
    """

    angle: float
    why: str
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class Up:
    """The axis of the file that points up ("z", "-y", ...), how that was found out, and the doubt about it, if any."""

    axis: str
    why: str
    doubt: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class Wheels:
    """The wheels that a vehicle stands on.

    Parameters
    ----------
    index
        Of the solids.
    up, across
        Unit vectors: up from the ground, and along the axles.
    level
        Height along `up` of the ground under them.
    """

    index: Int[np.ndarray, " w"]
    up: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "3"]
    level: float
    places: int = field(default=0)


def up_matrix(axis: str) -> Float[np.ndarray, "4 4"]:
    """The turn that brings an axis of the file ("z", "y", "x", or with a minus) up to z.

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
    """The largest set of like discs that stand side by side on one plane, or None."""
    discs = np.flatnonzero(
        (solids.round_about >= 0)
        & (solids.size[np.arange(len(solids)), np.maximum(solids.round_about, 0)] < 2.5 * solids.radius)
    )
    axle, radius, centre = solids.axle[discs], solids.radius[discs], solids.centre[discs]
    best, best_score = None, 0.0
    left = np.ones(len(discs), bool)
    for seed in np.argsort(-radius):
        if not left[seed] or radius[seed] <= 0:
            continue
        mine = (np.abs(axle @ axle[seed]) > PARALLEL) & (radius > 0.75 * radius[seed]) & (radius < 1.34 * radius[seed])
        left &= ~mine
        found = _standing(centre[mine], radius[mine], axle[seed])
        if found is not None and found[0] > best_score:
            best_score, best = found[0], (discs[mine][found[3]], *found[1:3])
    if best is None:
        return None
    index, up, across = best
    middle = solids.centre[index].mean(axis=0)
    # The body is on the side where the vehicle reaches farther, floors and other sheets aside.
    thick = solids.size[:, 2] > 0.02 * solids.size[:, 0]
    heights = (solids.centre[thick] - middle) @ up
    weight = solids.size[thick].prod(axis=1) ** (1 / 3)
    if float(heights @ weight) < 0:
        up = -up
    level = float((solids.centre[index] @ up - solids.radius[index]).min())
    places = len(np.unique(np.round(solids.centre[index] / (0.7 * solids.radius[index].mean())), axis=0))
    return Wheels(index, up, across, level, places)


def _standing(
    centre: Float[np.ndarray, "n 3"], radius: Float[np.ndarray, " n"], axle: Float[np.ndarray, "3"]
) -> tuple[float, np.ndarray, np.ndarray, Bool[np.ndarray, " n"]] | None:
    """Score, up (either way) and axle of discs if they are wheels, and which of them are."""
    keep = np.ones(len(centre), bool)
    for _ in range(3):
        if keep.sum() < LEAST_WHEELS:
            return None
        off = centre[keep] - np.median(centre[keep], axis=0)
        along_axle = off @ axle
        flat = off - along_axle[:, None] * axle
        _, _, directions = np.linalg.svd(flat, full_matrices=False)
        ahead = directions[0] - (directions[0] @ axle) * axle
        ahead /= np.linalg.norm(ahead)
        up = np.cross(ahead, axle)
        up /= np.linalg.norm(up)
        lift = np.abs((centre - np.median(centre[keep], axis=0)) @ up)
        within = lift < FLAT_WHEELS * np.median(radius)
        if (within == keep).all():
            break
        keep = within
    size = float(np.median(radius[keep])) if keep.any() else 0.0
    if keep.sum() < LEAST_WHEELS:
        return None
    base, track = float(np.ptp(centre[keep] @ ahead)), float(np.ptp(centre[keep] @ axle))
    if not (3.0 * size < base < 40.0 * size and 1.5 * size < track < base * 1.6):
        return None
    return base * track * size, up, axle, keep


def find_up(wheels: Wheels | None, said: str) -> Up:
    """The axis that is up, in the frame that the solids were found in, which has z up if the file is right.

    Parameters
    ----------
    wheels
        As found, in the file's own axes.
    said
        The axis that the file's format says is up.
    """
    if wheels is None:
        return Up(said, "as the file says")
    for axis in UPS:
        if float(up_matrix(axis)[2, :3] @ wheels.up) > UPRIGHT:
            if axis == said:
                return Up(said, f"as the file says, and {wheels.places} wheels")
            why = f"{wheels.places} wheels lie below the rest of it"
            return Up(
                axis,
                f"{why}, not {said} as the file says",
                f'{axis} is taken to be up, since {why}; set up = "{said}" if that is wrong',
            )
    return Up(said, "as the file says", "its wheels stand askew to the axes; set up, or turn it upright in Blender")


def find_forward(
    solids: Solids,
    wheels: Wheels | None,
    names: Sequence[str],
    *,
    gun: Sequence[bool],
    default: float,
) -> Forward:
    """Where the nose points, in a frame with z up.

    Parameters
    ----------
    solids
        Of the vehicle without floors and the like.
    wheels
        In the same frame.
    names
        What each piece is called.
    gun
        For each piece whether its name says gun.
    default
        Radians: which of two ends to take where nothing tells.
    """
    line, why = _line(solids, wheels)
    ahead = np.array([np.cos(line), np.sin(line), 0.0])
    low, high = solids.bounds[:, 0].min(axis=0), solids.bounds[:, 1].max(axis=0)
    middle = (low + high) / 2
    if wheels is not None:
        centres = solids.centre[wheels.index]
        middle = np.array([*((centres.min(axis=0) + centres.max(axis=0)) / 2)[:2], middle[2]])
    reach = np.abs((solids.bounds.reshape(-1, 3) - middle) @ ahead)
    half = max(float(np.percentile(reach, 98)), 1e-12)
    barrel = gun_barrel(solids, ahead, middle, half, gun)
    votes = _votes(solids, names, (solids.centre - middle) @ ahead / half)
    shape = _shape_votes(solids, wheels, ahead, middle)
    toward = 0.0
    doubt = ""
    if barrel is not None:
        toward = float(np.sign((solids.centre[barrel] - middle) @ ahead))
        why_sign = f"{names[solids.piece[barrel]]!r} points ahead like a gun"
        if votes * toward < -VOTE:
            doubt = "its gun points one way and what is named front the other; forward is taken from the gun"
    elif abs(votes) >= VOTE:
        toward, why_sign = float(np.sign(votes)), "names of what is in front and behind"
    elif shape:
        toward, why_sign = float(np.sign(shape)), "its shape"
        doubt = "nothing in it is named front or rear; its nose was found by shape alone"
    else:
        toward = 1.0 if np.cos(line - default) >= 0 else -1.0
        why_sign = "which end is its nose was not found"
        doubt = "which end is its nose was not found"
    angle = line if toward > 0 else line + np.pi
    angle = float(np.arctan2(np.sin(angle), np.cos(angle)))
    angle = snapped(angle)
    said = forward_said(angle)
    if doubt:
        doubt = f"{doubt}; taken as forward = {said}, set forward = {forward_said(angle + np.pi)} if it faces backwards"
    return Forward(angle, f"{why}, {why_sign}", doubt)


def forward_said(angle: float) -> str:
    """An angle as the key `forward` has it."""
    quarter = round(angle / (np.pi / 2))
    if abs(angle - quarter * np.pi / 2) < 1e-9:
        return '"' + ("+x", "+y", "-x", "-y")[quarter % 4] + '"'
    return f"{np.degrees(np.arctan2(np.sin(angle), np.cos(angle))):.1f}"


def snapped(angle: float) -> float:
    """The angle, or the multiple of a right angle that it is close to."""
    quarter = np.round(angle / (np.pi / 2)) * (np.pi / 2)
    return float(quarter) if abs(angle - quarter) < SNAP else angle


def _line(solids: Solids, wheels: Wheels | None) -> tuple[float, str]:
    """The angle of the vehicle's long axis, either way round."""
    if wheels is not None:
        across = wheels.across[:2] / max(float(np.linalg.norm(wheels.across[:2])), 1e-12)
        centre = solids.centre[wheels.index][:, :2]
        side = centre @ across
        # The line through the wheels of one side is better than an axle, which is short.
        left = side > (side.min() + side.max()) / 2
        off = np.concatenate([c - c.mean(axis=0) for c in (centre[left], centre[~left])])
        ahead = np.linalg.svd(off, full_matrices=False)[2][0]
        if abs(ahead @ across) > 0.1:
            ahead = np.array([across[1], -across[0]])
        return float(np.arctan2(ahead[1], ahead[0])), "by its wheels"
    return _mirror_line(solids)


def _mirror_line(solids: Solids) -> tuple[float, str]:
    """The line of the mirror plane of the largest solids, if there is one and x is none; else x."""
    largest = np.argsort(-solids.size.prod(axis=1))[:MIRRORED]
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) / 2
    corners = np.einsum("ck,nk,nkj->ncj", signs, solids.size[largest], solids.axes[largest])
    cloud = (solids.centre[largest][:, None] + corners).reshape(-1, 3)
    if len(largest) < 3:
        return 0.0, "along x, as nothing tells"
    tree, size = cKDTree(cloud), float(np.ptp(cloud, axis=0).max())

    def gap(angle: float) -> float:
        normal = np.array([-np.sin(angle), np.cos(angle), 0.0])
        side = cloud @ normal
        flipped = cloud - 2 * (side - (side.min() + side.max()) / 2)[:, None] * normal
        return float(np.mean(tree.query(flipped)[0])) / max(size, 1e-30)

    if gap(0.0) < SYMMETRIC:
        return 0.0, "along x, its mirror plane"
    angles = np.radians(np.arange(0.5, 180.0, 0.5))
    gaps = [gap(angle) for angle in angles]
    best = int(np.argmin(gaps))
    if gaps[best] < min(SYMMETRIC, gap(0.0) / 4):
        return float(angles[best]), "by its mirror plane"
    return 0.0, "along x, as nothing tells"


def gun_barrel(
    solids: Solids,
    ahead: Float[np.ndarray, "3"],
    middle: Float[np.ndarray, "3"],
    half: float,
    named: Sequence[bool],
) -> int | None:
    """The solid that is a gun's barrel: long, slender, along the vehicle, above its lower third, with a free end.

    Parameters
    ----------
    solids, ahead, middle, half
        The vehicle's solids, the horizontal unit vector along it (either way), its middle, and half its length.
    named
        For each piece whether its name says gun; then it may be shorter.
    """
    if not len(solids):
        return None
    across = np.cross([0.0, 0.0, 1.0], ahead)
    axis, length = solids.axes[:, 0], solids.size[:, 0]
    low, high = solids.bounds[:, 0, 2].min(), solids.bounds[:, 1, 2].max()
    off = solids.centre - middle
    sideways = off @ across
    width = float(np.ptp((solids.bounds.reshape(-1, 3) - middle) @ across))
    is_named = np.asarray(named, bool)[solids.piece]
    along = np.abs(axis @ ahead) > np.cos(np.radians(25.0))
    slender = (length > SLENDER * solids.size[:, 1]) & (length > np.where(is_named, 0.25, 0.4) * half)
    thick = solids.size[:, 2] > 0.4 * solids.size[:, 1]
    high_up = solids.centre[:, 2] > low + 0.33 * (high - low)
    # The free end: nothing else of the vehicle is around its outer half.
    tip = np.abs(off @ ahead) + length / 2
    free = (np.abs(off @ ahead) > 0.3 * half) & (tip > 0.75 * half)
    middle_line = np.abs(sideways) < 0.2 * width
    fits = along & slender & thick & high_up & free & middle_line
    if not fits.any():
        return None
    return int(np.argmax(np.where(fits, length * (1 + is_named), 0)))


def _votes(solids: Solids, names: Sequence[str], along: Float[np.ndarray, " n"]) -> float:
    """How much what is named front lies ahead of what is named rear, in half lengths, the mean of all votes."""
    votes = []
    for piece, name in enumerate(names):
        sign = bool(says(name, FRONT)) - bool(says(name, REAR))
        mine = solids.piece == piece
        if sign and mine.any():
            extent = solids.size[mine].max(axis=1)
            votes.append(sign * float(np.average(along[mine], weights=np.maximum(extent, 1e-12))))
    return float(np.mean(votes)) if votes else 0.0


def _shape_votes(
    solids: Solids, wheels: Wheels | None, ahead: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"]
) -> float:
    """Which way a wheeled vehicle looks by its shape: the lone axle is in front; 0 if that does not tell."""
    if wheels is None:
        return 0.0
    at = np.sort((solids.centre[wheels.index] - middle) @ ahead)
    radius = float(np.median(solids.radius[wheels.index]))
    axles = [float(c.mean()) for c in np.split(at, np.flatnonzero(np.diff(at) > radius) + 1)]
    if len(axles) != 3:
        return 0.0
    first, second = np.diff(axles)
    return 0.0 if max(first, second) < 1.4 * min(first, second) else (1.0 if second > first else -1.0)
