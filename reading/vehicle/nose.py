"""The direction of a vehicle's nose, with z up, by wheels, gun, names, and shape."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import (
    FRONT_WORDS,
    GUN_WORDS,
    REAR_WORDS,
    TURRET_HINTS,
    TURRET_WORDS,
    first_matching_pattern,
    first_matching_stem,
)
from hulldown.reading.vehicle.solids import MIN_PARALLEL_COSINE, Solids, Wheels

Value = TypeVar("Value", str, float)

NOSE_SNAP_RADIANS = np.radians(1.5)  # a nose this close to an axis of the file points along it
MIN_BARREL_SLENDERNESS = 7.0  # length over width of a gun's barrel
MAX_MIRRORED_SOLIDS = 60  # a mirror plane is sought for the largest
MIRROR_TOLERANCE_SHARE = 0.01  # of the vehicle's length, between a mirror image and its original
MIN_NAME_VOTE = 0.4  # half lengths of the vehicle by which names in front outweigh names behind
MAX_WHEELED_AXLES = 5  # more are under tracks
MIN_TUBE_SLENDERNESS = 5.0  # length over width of a launching tube
MIN_TUBE_RISE_RADIANS = np.radians(10.0)  # lower ones may be over the cab for the road
MIN_BARREL_COSINE = np.cos(np.radians(25.0))  # between a barrel and the vehicle's axis
MIN_NAMED_GUN_COSINE = np.cos(np.radians(65.0))  # the same for guns by name, which may be raised
MIN_GUN_REACH = 0.4  # half lengths of the vehicle
MIN_LONE_GUN_SLENDERNESS = 2.0  # without wheels or a mirror plane, a vehicle points along such a gun
MIN_TWIN_GUN_SHARE = 0.8  # of the longest gun's length: another gun like it
MIN_BARREL_REACH_SHARE, MAX_BARREL_SHARES = 0.1, (0.15, 0.25)  # of length; width and height of what's out there
MAX_EDGE_POINTS = 20_000  # points on edges: a barrel has few vertices between its ends
MAX_MIRRORED_VERTICES = 1000  # their mirror images are looked up
MIN_SLANT_SHARE, MIN_WHOLE_SLANT_SHARE = 0.05, 0.3  # of slanted surface that slants to one end rather than the other
MIN_SLANTED_SHARE = 0.004  # of all surface, times the sine and the cosine of its slope; less tells nothing
MIN_PROTRUSION_SHARE = 0.1  # of a gun's length: its muzzle is so much farther out of the rest than its breech
CONTRADICTION_DOUBT = "its gun points one way and what is named front the other; forward is taken from the gun"
BY_SHAPE = "nothing in it is named front or rear; its nose was found by shape alone"
TUBES_CONTRADICTED = "its tubes rise at one end and what is named front is at the other; forward is taken from the names"
ONE_CLUE = "only its raised tubes tell which end is its nose"
NO_LINE = "along x, as nothing tells"
ONE_BARREL = "only a slender end like a barrel tells which end is its nose"
NOT_FOUND = "which end is its nose was not found"


@dataclass(frozen=True, slots=True)
class Direction(Generic[Value]):
    """The file's up axis, or the nose's angle in radians counterclockwise from +x; the reason; a doubt if unsure."""

    value: Value
    why: str
    doubt: Doubt | None = None


def find_nose_direction(
    solids: Solids, wheels: Wheels | None, names: Sequence[str], *, gun: Sequence[bool], corners: Float[np.ndarray, "f 3 3"]
) -> Direction[float]:
    """Find the direction of the nose, z up, in the frame of `wheels`; without any sign, along the longer of x and y."""
    line, why = _long_axis_and_reason(solids, wheels, gun, corners)
    ahead = np.array([np.cos(line), np.sin(line), 0.0])
    low, high = solids.bounds[:, 0].min(axis=0), solids.bounds[:, 1].max(axis=0)
    middle = (low + high) / 2
    if wheels is not None:
        centers = solids.center[wheels.index]
        middle = np.array([*((centers.min(axis=0) + centers.max(axis=0)) / 2)[:2], middle[2]])
    along = (solids.bounds.reshape(-1, 3) - middle) @ ahead
    half, length = max(float(np.percentile(np.abs(along), 98)), 1e-12), float(np.ptp(along))
    barrel = gun_barrel_index(solids, ahead, middle, half)
    votes = _nose_vote_by_names(solids, names, (solids.center - middle) @ ahead / half)
    raised = nose_vote_by_rising_tubes(solids, ahead, length, named=np.asarray(gun, bool)[solids.piece]) if any(gun) else 0.0
    tubes, built = (
        nose_vote_by_rising_tubes(solids, ahead, length),
        _axle_and_mirror_nose_votes(solids, wheels, ahead, middle, length),
    )
    slanted = 0.0 if tubes else nose_vote_by_slant(corners, ahead)
    built = [*built, slanted if wheels is not None else float(np.sign(slanted))]
    gun_end, gun_why = 0.0, ""
    if barrel is not None:
        gun_end = float(np.sign((solids.center[barrel] - middle) @ ahead))
        gun_why = f"{names[solids.piece[barrel]]!r} points ahead like a gun"
    else:
        gun_end, which = _nose_vote_and_muzzle_piece(solids, ahead, half, gun)
        gun_why = f"{names[which]!r} sticks out there" if gun_end else ""
    named = float(np.sign(votes)) * (abs(votes) >= MIN_NAME_VOTE)
    # Tubes side by side may lie behind the middle, and yet they rise ahead.
    lifted = raised * (raised == tubes)
    names_doubt = TUBES_CONTRADICTED if lifted * named < 0 else ""
    lifted = 0.0 if names_doubt else lifted
    rack = barrel is not None and not gun[solids.piece[barrel]] and gun_end * named < 0  # it may be a pipe or a ladder
    others = (gun_end, named, *np.sign(built))
    total = tubes + sum(built)
    # Two agreeing signs are as good as a name.
    alone = abs(total) < 2 or abs(total) < abs(tubes) + sum(map(abs, built))
    slender = 0.0 if gun_end else slender_end(corners, ahead)
    armed = any(
        first_matching_pattern(name, (*TURRET_WORDS, *GUN_WORDS, "tank")) or first_matching_stem(name, TURRET_HINTS)
        for name in names
    )
    # In order of trust: the end of a sign (0 for neither), the reason, the doubt.
    clues = (
        (lifted, "its tubes rise there", "" if lifted in others else ONE_CLUE),
        (named if names_doubt else 0.0, "names of what is in front and behind", names_doubt),
        (0.0 if rack else gun_end, gun_why, CONTRADICTION_DOUBT if votes * gun_end < -MIN_NAME_VOTE else ""),
        (named, "names of what is in front and behind", ""),
        (raised, "its gun rises there", "" if raised in others else ONE_CLUE),
        (slender, "it ends in a barrel there", "" if slender in others or armed else ONE_BARREL),
        (float(np.sign(total)), "its shape", BY_SHAPE if alone else ""),
        (1.0 if np.cos(line - np.pi / 4) >= 0 else -1.0, NOT_FOUND, NOT_FOUND),
    )
    toward, why_sign, problem = next(clue for clue in clues if clue[0])
    angle = line if toward > 0 else line + np.pi
    angle = snap_to_right_angle(float(np.arctan2(np.sin(angle), np.cos(angle))))
    doubt = None
    if problem:
        stated, back = (forward_config_text(a) for a in (angle, angle + np.pi))
        text = f"{problem}; taken as forward = {stated}, set forward = {back} if it faces backwards"
        doubt = Doubt(DoubtKind.FORWARD, text, "forward", forward_config_value(angle))
    return Direction(angle, f"{why}, {why_sign}", doubt)


def forward_config_value(angle: float) -> str | float:
    """Return an angle in the form of the key `forward`."""
    quarter = round(angle / (np.pi / 2))
    if abs(angle - quarter * np.pi / 2) < 1e-9:
        return ("+x", "+y", "-x", "-y")[quarter % 4]
    return round(float(np.degrees(np.arctan2(np.sin(angle), np.cos(angle)))), 1)


def forward_config_text(angle: float) -> str:
    """Return an angle as it follows `forward =` in a config."""
    return json.dumps(forward_config_value(angle))


def snap_to_right_angle(angle: float, within: float = NOSE_SNAP_RADIANS) -> float:
    """Snap an angle to a close multiple of a right angle."""
    quarter = np.round(angle / (np.pi / 2)) * (np.pi / 2)
    return float(quarter) if abs(angle - quarter) < within else angle


def _long_axis_and_reason(
    solids: Solids, wheels: Wheels | None, gun: Sequence[bool], corners: Float[np.ndarray, "f 3 3"]
) -> tuple[float, str]:
    """Return the angle of the vehicle's long axis, in either direction."""
    if wheels is not None:
        across = wheels.across[:2] / max(float(np.linalg.norm(wheels.across[:2])), 1e-12)
        center = solids.center[wheels.index][:, :2]
        side = center @ across
        # The line through the wheels of one side is better than an axle, which is short.
        left = side > (side.min() + side.max()) / 2
        off = np.concatenate([c - c.mean(axis=0) for c in (center[left], center[~left])])
        ahead = np.linalg.svd(off, full_matrices=False)[2][0]
        if abs(ahead @ across) > 0.1:
            ahead = np.array([across[1], -across[0]])
        return float(np.arctan2(ahead[1], ahead[0])), "by its wheels"
    line, why = _mirror_axis_and_reason(solids)
    if why == NO_LINE:
        own = solids.where(np.asarray(gun, bool)[solids.piece])
        slender = (own.size[:, 0] > MIN_LONE_GUN_SLENDERNESS * own.size[:, 1]) & (
            np.hypot(*own.axes[:, 0, :2].T) > MIN_NAMED_GUN_COSINE
        )
        if slender.any():
            axis = own.axes[np.argmax(np.where(slender, own.size[:, 0], 0.0)), 0]
            return snap_to_right_angle(float(np.arctan2(axis[1], axis[0]))), "along its gun"
        return _surface_axis_and_reason(corners)
    return line, why


def _surface_axis_and_reason(corners: Float[np.ndarray, "f 3 3"]) -> tuple[float, str]:
    """Return the axis, x or y, whose mirror plane the vertices have, or the longer one."""
    points = np.unique(corners.reshape(-1, 3), axis=0)
    size = np.ptp(points, axis=0)
    gaps = [mirror_gap(points, axis) / max(float(size.max()), 1e-30) for axis in (1, 0)]
    alike = (gaps[0] < MIRROR_TOLERANCE_SHARE) == (gaps[1] < MIRROR_TOLERANCE_SHARE)
    along = int(size[1] > size[0]) if alike else int(gaps[1] < gaps[0])
    return along * np.pi / 2, f"along {'xy'[along]}, {'where it is longer' if alike else 'its mirror plane'}"


def mirror_gap(points: Float[np.ndarray, "n 3"], axis: int) -> float:
    """Return the mean distance of a mirror image, in a plane across an axis, to its original."""
    flipped = points[:: max(1, len(points) // MAX_MIRRORED_VERTICES)].copy()
    flipped[:, axis] = points[:, axis].min() + points[:, axis].max() - flipped[:, axis]
    return float(np.mean(cKDTree(points).query(flipped)[0]))


def slender_end(corners: Float[np.ndarray, "f 3 3"], ahead: Float[np.ndarray, "3"]) -> float:
    """Return the end, 1 or -1, whose outer tenth is slender, in the middle, and not low, like a barrel; else 0."""
    steps = np.linspace(0.0, 1.0, 2 + MAX_EDGE_POINTS // max(len(corners), 1))[1:, None]
    edges = corners[:, :, None] + (np.roll(corners, -1, axis=1) - corners)[:, :, None] * steps
    points = edges.reshape(-1, 3) @ np.stack([ahead, np.cross([0.0, 0.0, 1.0], ahead), [0.0, 0.0, 1.0]], axis=1)
    low, high = points.min(axis=0), points.max(axis=0)
    size, found = np.maximum(high - low, 1e-30), list[float]()
    for end, tip in ((1.0, high[0]), (-1.0, low[0])):
        outer = (points[np.abs(points[:, 0] - tip) < MIN_BARREL_REACH_SHARE * size[0]] - low) / size
        thin = (np.ptp(outer[:, 1:], axis=0) < MAX_BARREL_SHARES).all()
        if thin and abs(outer[:, 1].mean() - 0.5) < 0.1 and outer[:, 2].min() > 0.33:
            found.append(end)
    return found[0] if len(found) == 1 else 0.0


def nose_vote_by_slant(corners: Float[np.ndarray, "f 3 3"], ahead: Float[np.ndarray, "3"]) -> float:
    """Return the end that windshields, hoods, and bows slant to: 1 or -1, 2 or -2 if nearly all do, or 0."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    height = corners[..., 2].mean(axis=1)
    low, high = corners[..., 2].min(), corners[..., 2].max()
    upward = (normal[:, 2] > 0) & (height > low + 0.33 * (high - low))
    slanted = np.where(upward, normal[:, 2] * (normal @ ahead) / area, 0.0)
    whole = float(np.abs(slanted).sum())
    if whole < MIN_SLANTED_SHARE * float(area.sum()):
        return 0.0
    share = float(slanted.sum()) / whole
    return float(np.sign(share)) * (1 + (abs(share) > MIN_WHOLE_SLANT_SHARE)) * (abs(share) > MIN_SLANT_SHARE)


def _mirror_axis_and_reason(solids: Solids) -> tuple[float, str]:
    """Return the line of the mirror plane of the largest solids, if there is one and x isn't; else x."""
    largest = np.argsort(-solids.size.prod(axis=1))[:MAX_MIRRORED_SOLIDS]
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) / 2
    corners = np.einsum("ck,nk,nkj->ncj", signs, solids.size[largest], solids.axes[largest])
    cloud = (solids.center[largest][:, None] + corners).reshape(-1, 3)
    if len(largest) < 3:
        return 0.0, NO_LINE
    tree, size = cKDTree(cloud), float(np.ptp(cloud, axis=0).max())

    def gap(angle: float) -> float:
        normal = np.array([-np.sin(angle), np.cos(angle), 0.0])
        side = cloud @ normal
        flipped = cloud - 2 * (side - (side.min() + side.max()) / 2)[:, None] * normal
        return float(np.mean(tree.query(flipped)[0])) / max(size, 1e-30)

    if gap(0.0) < MIRROR_TOLERANCE_SHARE <= gap(np.pi / 2):
        return 0.0, "along x, its mirror plane"
    if gap(0.0) < MIRROR_TOLERANCE_SHARE:
        along = int(np.ptp(cloud[:, 1]) > np.ptp(cloud[:, 0]))
        return along * np.pi / 2, f"along {'xy'[along]}, the longer of two mirror planes"
    angles = np.radians(np.arange(0.5, 180.0, 0.5))
    gaps = [gap(angle) for angle in angles]
    best = int(np.argmin(gaps))
    if gaps[best] < min(MIRROR_TOLERANCE_SHARE, gap(0.0) / 4):
        return float(angles[best]), "by its mirror plane"
    return 0.0, NO_LINE


def gun_barrel_index(solids: Solids, ahead: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"], half: float) -> int | None:
    """Return the solid of a gun's barrel: long, slender, along the vehicle, above its lower third, with a free end.

    The vehicle is `half` long on either side of `middle` along the horizontal unit vector `ahead` (either way).
    """
    if not len(solids):
        return None
    across = np.cross([0.0, 0.0, 1.0], ahead)
    axis, length = solids.axes[:, 0], solids.size[:, 0]
    low, high = solids.bounds[:, 0, 2].min(), solids.bounds[:, 1, 2].max()
    off = solids.center - middle
    sideways = off @ across
    width = float(np.ptp((solids.bounds.reshape(-1, 3) - middle) @ across))
    along = np.abs(axis @ ahead) > MIN_BARREL_COSINE
    slender = (length > MIN_BARREL_SLENDERNESS * solids.size[:, 1]) & (length > 0.4 * half)
    thick = solids.size[:, 2] > 0.4 * solids.size[:, 1]
    high_up = solids.center[:, 2] > low + 0.33 * (high - low)
    # The free end: nothing else of the vehicle is around its outer half.
    tip = np.abs(off @ ahead) + length / 2
    free = (np.abs(off @ ahead) > 0.3 * half) & (tip > 0.75 * half)
    middle_line = np.abs(sideways) < 0.2 * width
    fits = along & slender & thick & high_up & free & middle_line
    if not fits.any():
        return None
    return int(np.argmax(np.where(fits, length, 0.0)))


def _nose_vote_and_muzzle_piece(
    solids: Solids, ahead: Float[np.ndarray, "3"], half: float, named: Sequence[bool]
) -> tuple[float, int]:
    """Return the end at which the longest piece that is named gun protrudes, and that piece; (0, -1) if none does."""
    across = np.cross([0.0, 0.0, 1.0], ahead)
    corners = solids.bounds[:, [[0, 0], [0, 1], [1, 0], [1, 1]], [0, 1]]  # (n, 4, 2) seen from above
    along, aside = corners @ ahead[:2], corners @ across[:2]
    is_gun = np.asarray(named, bool)[solids.piece]
    pieces = np.unique(solids.piece[is_gun])
    reach = np.array([np.ptp(along[solids.piece == piece]) for piece in pieces])
    # More than two alike are the tubes of a launcher, which lie over the cab for the road.
    if not len(pieces) or reach.max() < MIN_GUN_REACH * half or (reach > MIN_TWIN_GUN_SHARE * reach.max()).sum() > 2:
        return 0.0, -1
    piece = int(pieces[reach.argmax()])
    own = solids.piece == piece
    middle = (aside[own].min() + aside[own].max()) / 2
    height = (solids.bounds[own, 0, 2].min() + solids.bounds[own, 1, 2].max()) / 2
    # Pieces on its middle line or on its extension.
    others = ~is_gun & (aside.min(axis=1) < middle) & (aside.max(axis=1) > middle)
    others &= (solids.bounds[:, 0, 2] < height) & (solids.bounds[:, 1, 2] > height)
    if not others.any():
        return 0.0, -1
    front = float(along[own].max() - along[others].max())
    rear = float(along[others].min() - along[own].min())
    if max(front, rear) <= 0 or abs(front - rear) <= MIN_PROTRUSION_SHARE * reach.max():
        return 0.0, -1
    return float(np.sign(front - rear)), piece


def _nose_vote_by_names(solids: Solids, names: Sequence[str], along: Float[np.ndarray, " n"]) -> float:
    """Return how far front-named pieces are ahead of rear-named ones, in half lengths; 1 if all agree."""
    places: dict[int, list[float]] = {1: [], -1: []}
    for piece, name in enumerate(names):
        sign = bool(first_matching_pattern(name, FRONT_WORDS)) - bool(first_matching_pattern(name, REAR_WORDS))
        of_piece = solids.piece == piece
        if sign and of_piece.any():
            extent = solids.size[of_piece].max(axis=1)
            places[sign].append(float(np.average(along[of_piece], weights=np.maximum(extent, 1e-12))))
    front, rear = places[1], places[-1]
    if front and rear and (min(front) > max(rear) or max(front) < min(rear)):
        return float(np.sign(front[0] - rear[0]))  # all agree
    return float(np.mean([*front, *np.negative(rear)])) if front or rear else 0.0


def _axle_and_mirror_nose_votes(
    solids: Solids, wheels: Wheels | None, ahead: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"], length: float
) -> list[float]:
    if wheels is None:
        return []
    votes = []
    at = np.sort((solids.center[wheels.index] - middle) @ ahead)
    radius = float(np.median(solids.radius[wheels.index]))
    axles = [float(c.mean()) for c in np.split(at, np.flatnonzero(np.diff(at) > radius) + 1)]
    if len(axles) == 3:
        first, second = np.diff(axles)
        votes.append(0.0 if max(first, second) < 1.4 * min(first, second) else float(np.sign(second - first)))
    if len(axles) <= MAX_WHEELED_AXLES:
        votes.append(_nose_vote_by_mirrors(solids, ahead, middle, length))
    return votes


def nose_vote_by_rising_tubes(
    solids: Solids, ahead: Float[np.ndarray, "3"], length: float, *, named: Bool[np.ndarray, " n"] | bool = False
) -> float:
    """Return the end that named tubes, or two alike, rise to, which isn't the tail; 0 without such tubes."""
    axis = solids.axes[:, 0] * np.sign(solids.axes[:, :1, 2])
    along = axis @ ahead
    low, high = solids.bounds[:, 0, 2].min(initial=0.0), solids.bounds[:, 1, 2].max(initial=0.0)
    tube = (solids.size[:, 0] > np.where(named, 3.0, MIN_TUBE_SLENDERNESS) * solids.size[:, 1]) & (
        solids.size[:, 0] > 0.25 * length
    )
    tube &= (solids.size[:, 2] > 0.5 * solids.size[:, 1]) & (solids.center[:, 2] > low + 0.33 * (high - low))
    tube &= (
        (axis[:, 2] > np.sin(MIN_TUBE_RISE_RADIANS))
        & (np.abs(along) > 0.3)
        & (np.hypot(along, axis[:, 2]) > MIN_PARALLEL_COSINE)
    )
    if not (tube & named).any():
        parallel = np.abs(axis @ axis.T) > MIN_PARALLEL_COSINE
        alike = np.abs(solids.size[:, None] - solids.size).max(axis=2) < 0.05 * solids.size[:, :1]
        tube &= ((parallel & alike & tube).sum(axis=1)) > 1
    return float(np.sign(np.sum(np.where(tube, along * solids.size[:, 0], 0.0))))


def _nose_vote_by_mirrors(
    solids: Solids, ahead: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"], length: float
) -> float:
    """Return the end at which a pair of small solids, high up, protrudes farthest sideways, like mirrors; or 0."""
    across = np.cross([0.0, 0.0, 1.0], ahead)
    low, high = solids.bounds[:, 0, 2].min(), solids.bounds[:, 1, 2].max()
    reach = np.einsum("nk,nk->n", solids.size / 2, np.abs(solids.axes @ across))
    side, along = (solids.center - middle) @ across, (solids.center - middle) @ ahead
    small = (solids.size[:, 0] < 0.15 * length) & (solids.center[:, 2] > low + 0.3 * (high - low))
    outer = np.abs(side) + reach
    wide = small & (outer > 1.02 * outer[~small].max(initial=0.0))
    left, right = along[wide & (side > 0)], along[wide & (side < 0)]
    if not len(left) or not len(right) or abs(left.mean() - right.mean()) > 0.05 * length:
        return 0.0
    at = float((left.mean() + right.mean()) / 2)
    return float(np.sign(at)) if abs(at) > 0.03 * length else 0.0
