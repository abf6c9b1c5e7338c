"""Pivots of turrets and guns: an object's origin if it's plausible, else an estimate from shape."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import pdist

from hulldown.geometry.transforms import transform_points
from hulldown.reading.pieces.naming import PIVOT_WORDS, first_matching_pattern, name_words
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Link
from hulldown.reading.vehicle.part_names import GUN_PART, TURRET_PART, Naming, ObjectKey, link_key, part_by_pivot_name
from hulldown.reading.vehicle.solids import PlacedPieces

MAX_ORIGIN_DISTANCE_SHARE = 0.25  # of a part's longest side: a mesh object's origin may be so far outside it
GUN_REAR_SHARE = 0.4  # a gun's axis is in this part of it, not in the middle, where a new cylinder's origin is
MIN_RING_WIDTH_SHARE = 0.24  # of the hull's width, for a turret's ring
RING_RADIUS_SHARE = 0.3  # of the hull's width
RING_HEIGHT_SHARE = 0.3  # of the turret's height: the ring is in this lowest part
MIN_MANTLET_RATIO = 1.5  # of a mantlet's width to the barrel's
MANTLET_DEPTH_SHARE = 0.25  # a gun's axis is this far into its mantlet from the rear
MIN_TWIN_BARREL_SHARE = 0.8  # of the longest barrel's length, for another barrel
MAX_TWIN_BARRELS = 3  # more are the tubes of a launcher
MIN_SIDEWAYS_RATIO = 1.5  # of width to length, for what points to a side
MAX_PLATE_THICKNESS_SHARE = 0.3  # of the height of a plate that holds a gun
BEARING_DEPTH_SHARE = 0.25  # of its height, from its top to the bearing
PIVOT_KEYS = {TURRET_PART: "turret_pivot", GUN_PART: "gun_pivot"}
MAX_MIDDLE_DISTANCE_SHARE = 0.01  # of the longest side: an origin so close to its mesh's middle was set automatically

_KEYPOINT_NAME = re.compile(r"(?:kp_|keypoint[_.\- ]*)(.*)", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """An object of a part, as a candidate for its pivot."""

    link: Link
    topmost: bool  # its parent is another part
    named: bool  # its own name is the part's, not only its collection's
    faces: int  # triangles of the part that it carries, itself included


@dataclass(frozen=True, eq=False, slots=True)
class Pivot:
    """A point on the axis, its source, and whether it's only a guess."""

    at: Float[np.ndarray, "3"]
    why: str
    guessed: bool = False


def find_pivot(
    whole: PlacedPieces,
    by_part: Mapping[str | None, PlacedPieces],
    part: str,
    *,
    naming: Naming,
    behind: Float[np.ndarray, "3"],
    options: Options,
) -> Pivot:
    """Find a part's pivot: the config's, an object named so, an empty, the part's mesh, or a guess by shape."""
    if asked := _configured_pivot(whole, part, options):
        return asked
    # Where "set origin" puts origins.
    middles = {link_key(p.chain[0]): b.mean(axis=0) for p, b in zip(whole.pieces, whole.bounds, strict=True)}
    # The middle of a helper mesh such as ``turretpivot`` or ``gun_axis`` counts, since its origin often stays at the
    # file's. Empties are among a part's nodes.
    for piece in whole.pieces:
        if part_by_pivot_name(piece.name) == part:
            return Pivot(middles[link_key(piece.chain[0])], f"the middle of {piece.name!r}, named as a pivot")
    own = by_part[part]
    nodes, guess = _pivot_candidate_nodes(own, naming, part), _pivot_guess_by_shape(by_part, part, behind)
    # One origin shared by most of the hull's objects isn't a pivot.
    resting = np.array([whole.origin(piece.chain[0]) for piece in by_part[None].pieces])
    low, high = own.all_vertices.min(axis=0), own.all_vertices.max(axis=0)
    size = float((high - low).max())
    scale = float(abs(np.linalg.det(whole.vehicle_from_file[:3, :3]))) ** (1 / 3)

    def believed(node: Node) -> bool:
        # Origins at the file's zero, or where those of the hull lie, were left there.
        at_zero = not np.abs(node.link.pose[:3, 3]).max() > 1e-6 * size / max(scale, 1e-30)
        apart = np.linalg.norm(resting.reshape(-1, 3) - whole.origin(node.link), axis=1)
        near = apart < 1e-4 * size
        return not ((at_zero and near.any()) or (len(near) > 2 and near.mean() > 0.5))

    def rank(node: Node) -> tuple[bool, bool, int]:
        bare = tuple(w for w in name_words(node.link.name) if not w.isdigit())
        return (not node.topmost, bare != (part,), -node.faces)

    def first(some: list[Node]) -> Node | None:
        return min(some, key=rank, default=None)

    helpers = [n for n in nodes if first_matching_pattern(n.link.name, PIVOT_WORDS) or part_by_pivot_name(n.link.name) == part]
    if node := first([n for n in helpers if believed(n)]):
        return Pivot(whole.origin(node.link), f"origin of {node.link.name!r}, named pivot")
    if node := first([n for n in nodes if n.named and n.link.kind == "EMPTY" and believed(n)]):
        return Pivot(whole.origin(node.link), f"origin of the empty {node.link.name!r}")
    total = sum(n.faces for n in nodes if n.topmost)
    node = (
        first([n for n in nodes if n.named])
        or first([n for n in nodes if n.link.kind == "EMPTY" and 2 * n.faces > total])
        or min(nodes, key=lambda n: (n.link.kind == "EMPTY", -n.faces))
    )
    at = whole.origin(node.link)
    if node.link.kind == "EMPTY" and believed(node):
        return Pivot(at, f"origin of the empty {node.link.name!r}")
    slack = MAX_ORIGIN_DISTANCE_SHARE * size
    wrong = bool(((at < low - slack) | (at > high + slack)).any()) or not believed(node)
    middle = middles.get(link_key(node.link))
    centered = middle is not None and bool(np.linalg.norm(at - middle) < MAX_MIDDLE_DISTANCE_SHARE * size)
    if part == GUN_PART:
        rear, front = gun_rear_and_front(own.all_vertices, behind)
        wrong |= float((at - rear) @ (front - rear)) / max(float((front - rear) @ (front - rear)), 1e-30) > GUN_REAR_SHARE
    elif centered and guess.guessed and not wrong:
        return Pivot(at, f"origin of {node.link.name!r}, which is only the middle of its mesh", guessed=True)
    wrong |= centered
    if not wrong:
        return Pivot(at, f"origin of {node.link.name!r}")
    return Pivot(guess.at, f"{guess.why}, since the origin of {node.link.name!r} is not where a {part} turns", guess.guessed)


def _configured_pivot(whole: PlacedPieces, part: str, options: Options) -> Pivot | None:
    key = PIVOT_KEYS[part]
    wanted = getattr(options, key)
    if wanted is None:
        return None
    if not isinstance(wanted, str):
        return Pivot(transform_points(whole.vehicle_from_file, np.array(wanted, float)[None])[0], f"the config's {key}")
    for chain in (*whole.markers, *(piece.chain for piece in whole.pieces)):
        for link in chain:
            if link.name == wanted:
                return Pivot(whole.origin(link), f"origin of {wanted!r}, the config's {key}")
    raise ValueError(f"{key} = {wanted!r} is no object or empty of the file")


def _pivot_candidate_nodes(own: PlacedPieces, naming: Naming, part: str) -> list[Node]:
    links: dict[ObjectKey, tuple[Link, bool]] = {}
    faces: dict[ObjectKey, int] = {}
    carried = [(piece.chain, piece.faces) for piece in own.pieces]
    for chain, count in [*carried, *((m, 0) for m in own.markers if keypoint_from_name(m[0].name) is None)]:
        for i, link in enumerate(chain):
            if naming.chain_part(chain[i:]) != part:
                break
            key = link_key(link)
            links.setdefault(key, (link, naming.chain_part(chain[i + 1 :]) != part))
            faces[key] = faces.get(key, 0) + count
    return [Node(link, topmost, naming.parts.get(link.name) == part, faces[key]) for key, (link, topmost) in links.items()]


def _pivot_guess_by_shape(by_part: Mapping[str | None, PlacedPieces], part: str, behind: Float[np.ndarray, "3"]) -> Pivot:
    turret, gun, hull = by_part[TURRET_PART], by_part[GUN_PART], by_part[None]
    if not gun.pieces:
        return guess_turret_pivot(turret, hull)
    of_gun = guess_gun_pivot(gun, behind, held=pivot_between_gun_cheeks(gun, turret if turret.pieces else hull))
    return of_gun if part == GUN_PART else guess_turret_pivot(turret, hull, trunnions=of_gun.at)


def guess_turret_pivot(turret: PlacedPieces, hull: PlacedPieces, *, trunnions: Float[np.ndarray, "3"] | None = None) -> Pivot:
    """Estimate a turret's axis from shape: the middle of its ring, of the hull below, or by its gun's trunnions."""
    own, under = turret.all_vertices, hull.all_vertices[:, 1]
    low, high = own.min(axis=0), own.max(axis=0)
    width = float(np.ptp(under)) if len(under) else float(high[1] - low[1])
    height = float(high[2] - low[2])
    for solids, base, what in (
        (turret.solids, low[2] + RING_HEIGHT_SHARE * height, "its ring"),
        (hull.solids, low[2] + 0.1 * height, "the ring that it stands on"),
    ):
        if not len(solids):
            continue
        upright = (solids.round_about >= 0) & (np.abs(solids.round_axis[:, 2]) > 0.99)
        level = solids.bounds[:, 0, 2] if solids is turret.solids else np.abs(solids.bounds[:, 1, 2] - low[2]) + low[2]
        inside = ((solids.center > low) & (solids.center < high))[:, :2].all(axis=1)
        rings = np.flatnonzero(upright & (level < base) & inside & (2 * solids.radius > MIN_RING_WIDTH_SHARE * width))
        if len(rings):
            ring = rings[np.argmax(solids.radius[rings])]
            return Pivot(
                np.array([*solids.center[ring, :2], low[2]]),
                f"the middle of {what}, a circle of {2 * solids.radius[ring]:.2f} m",
            )
    # Nothing round: the middle of its body, and a ring's radius behind the trunnions, which are over the ring's edge.
    weight, body = turret.solids.size.prod(axis=1), (low + high) / 2
    if weight.sum() > 0:
        body = np.average(turret.solids.bounds.mean(axis=1), axis=0, weights=weight)
    at, why = np.array([body[0], body[1], low[2]]), "the middle of its body"
    if trunnions is not None and 0 < trunnions[0] - at[0] < width:
        at[0] = (at[0] + 2 * (trunnions[0] - RING_RADIUS_SHARE * width)) / 3
        why = "the middle of its body and the distance from its gun"
    center = (under.min() + under.max()) / 2 if len(under) else at[1]
    at[1] = center if abs(at[1] - center) < 0.05 * width else at[1]
    return Pivot(at, why, guessed=True)


def pivot_between_gun_cheeks(gun: PlacedPieces, mount: PlacedPieces) -> Float[np.ndarray, "3"] | None:
    """Return the axis near the top of two upright plates of a mount that hold a gun; None if there are none."""
    own, points, others = gun.all_vertices, mount.all_vertices, mount.solids
    low, high = own.min(axis=0), own.max(axis=0)
    middle = (low + high) / 2
    plate = (others.size[:, 2] < MAX_PLATE_THICKNESS_SHARE * others.size[:, 1]) & (np.abs(others.axes[:, 2, 1]) > 0.97)
    aside = np.abs(others.center[:, 1] - middle[1]) < 0.55 * (high - low)[1]
    meets = (others.bounds[:, 0, ::2] < high[::2]).all(axis=1) & (others.bounds[:, 1, ::2] > low[::2]).all(axis=1)
    best, largest = None, 0.0
    for i in np.flatnonzero(plate & aside & meets & (others.center[:, 1] > middle[1])):
        mirrored = others.center[i] * [1, -1, 1] + [0, 2 * middle[1], 0]
        size = others.size[i]
        twin = np.linalg.norm(others.center - mirrored, axis=1) < 0.1 * size[1]
        twin &= np.abs(others.size - size).max(axis=1) < 0.05 * size[0]
        if not twin.any() or size[0] * size[1] <= largest:
            continue
        box = others.bounds[i]
        inside = points[((points > box[0] - 1e-6) & (points < box[1] + 1e-6)).all(axis=1)]
        tall = box[1, 2] - box[0, 2]
        top = inside[inside[:, 2] > box[1, 2] - BEARING_DEPTH_SHARE * tall]
        if len(top):
            largest = size[0] * size[1]
            best = np.array([(top[:, 0].min() + top[:, 0].max()) / 2, middle[1], box[1, 2] - BEARING_DEPTH_SHARE * tall])
    return best


def guess_gun_pivot(gun: PlacedPieces, behind: Float[np.ndarray, "3"], *, held: Float[np.ndarray, "3"] | None = None) -> Pivot:
    """Estimate a gun's axis from shape: its trunnions, its mantlet, or its rear end."""
    own, solids = gun.all_vertices, gun.solids
    rear, front = gun_rear_and_front(own, behind)
    length = float(np.linalg.norm(front - rear))
    if not len(solids) or length <= 0:
        return Pivot(rear, "the middle of its rear end", guessed=True)
    ahead = (front - rear) / length
    along = (solids.center - rear) @ ahead
    cross = (solids.round_about == 0) & (np.abs(solids.round_axis[:, 1]) > 0.97) & (along < 0.5 * length)
    trunnions = np.flatnonzero(cross & (solids.size[:, 0] > 0.5 * float(np.ptp(own[:, 1]))))
    if len(trunnions):
        at = solids.center[trunnions[np.argmax(solids.size[trunnions, 0])]]
        return Pivot(at, "the middle of its trunnions")
    barrel = int(np.argmax(solids.size[:, 0]))
    line = solids.axes[barrel, 0] * np.sign(solids.axes[barrel, 0] @ ahead or 1.0)
    start = solids.center[barrel] - line * solids.size[barrel, 0] / 2
    slender = solids.size[barrel, 0] > 5 * solids.size[barrel, 1]
    tubes = solids.where(solids.size[:, 0] > MIN_TWIN_BARREL_SHARE * solids.size[barrel, 0])
    aside = pdist(tubes.center - np.outer(tubes.center @ line, line)).max(initial=0.0)
    several = aside > 2 * solids.size[barrel, 1] or (aside > 0.5 * solids.size[barrel, 1] and len(tubes) > MAX_TWIN_BARRELS)
    if several and held is not None:
        return Pivot(held, "the top of the plates that hold its tubes")
    if several or not slender:
        return Pivot(rear, "the middle of its rear end", guessed=True)
    reach = (solids.bounds[:, 0] - start) @ line, (solids.bounds[:, 1] - start) @ line
    nearest, farthest = np.minimum(*reach), np.maximum(*reach)
    thick = (solids.size[:, 1] > MIN_MANTLET_RATIO * solids.size[barrel, 1]) & (nearest < 0.1 * solids.size[barrel, 0])
    thick &= (farthest < 0.5 * solids.size[barrel, 0]) & (
        np.linalg.norm(np.cross(solids.center - start, line), axis=1) < solids.size[:, 1]
    )
    if thick.any():
        mantlet = np.flatnonzero(thick)[np.argmax(solids.size[thick].prod(axis=1))]
        into = nearest[mantlet] + MANTLET_DEPTH_SHARE * (farthest[mantlet] - nearest[mantlet])
        return Pivot(start + into * line, "the rear of its mantlet")
    return Pivot(start, "the rear end of its barrel", guessed=True)


def gun_rear_and_front(
    own: Float[np.ndarray, "n 3"], behind: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the middle of a gun's rear and of its front end; the front is away from `behind`."""
    low, high = own.min(axis=0), own.max(axis=0)
    # Tubes side by side are often wider than long.
    axis = int((high - low)[1] > MIN_SIDEWAYS_RATIO * (high - low)[0])
    rear, front = (low + high) / 2, (low + high) / 2
    forward = rear[axis] >= behind[axis] - 0.1 * (high - low)[axis]
    rear[axis], front[axis] = (low[axis], high[axis]) if forward else (high[axis], low[axis])
    return rear, front


def keypoint_from_name(name: str) -> str | None:
    """Return the keypoint of an empty with this name; None if it isn't one."""
    found = _KEYPOINT_NAME.fullmatch(name)
    return (found[1] or name) if found else None


def keypoints_from_empties(
    markers: Sequence[tuple[Link, ...]], chains: Sequence[tuple[Link, ...]], piece_part: Sequence[int]
) -> dict[str, tuple[Float[np.ndarray, "3"], int | None]]:
    """Return the keypoints of empties: positions in the file, and the part that each belongs to, if any."""
    parts_below: dict[tuple[str, bytes], set[int]] = {}
    for chain, part in zip(chains, piece_part, strict=True):
        for link in chain:
            parts_below.setdefault(link_key(link), set()).add(part)
    own = {link_key(chain[0]): part for chain, part in zip(chains, piece_part, strict=True)}
    found: dict[str, tuple[Float[np.ndarray, "3"], int | None]] = {}
    for marker, *above in markers:
        if (name := keypoint_from_name(marker.name)) is None or name in found:
            continue
        # The first one above it that is a piece, or only holds pieces of one part.
        below = (({own[key]} if key in own else parts_below.get(key, set())) for key in map(link_key, above))
        found[name] = marker.pose[:3, 3], next((min(parts) for parts in below if len(parts) == 1), None)
    return found
