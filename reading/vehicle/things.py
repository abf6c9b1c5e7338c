"""Find several things in one vehicle file: vehicles side by side, and copies of a vehicle drawn over each other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from glob import escape
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, QhullError, cKDTree

from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.asset_report import Thing, xyz_tuple
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import VEHICLE_WORDS, first_matching_pattern, name_words
from hulldown.reading.pieces.roles import Piece, is_kept_by_name
from hulldown.reading.pieces.wording import MAX_LISTED_NAMES, MAX_SENTENCE_NAMES, names_as_config_value, quote_names
from hulldown.reading.vehicle.solids import PlacedPieces, touching_cluster_labels

MAX_PIECE_GAP_SHARE = 0.02  # of the longest piece: closer pieces are one thing
MIN_THING_DIAGONAL_SHARE = 0.5  # of the largest thing's; smaller things belong to the nearest one
MIN_THING_VOLUME_SHARE = 0.15  # of the largest thing's
MAX_COUPLING_GAP_SHARE = 0.15  # of their length: a truck and its trailer are this close in line
MIN_FACING_WIDTH_SHARE = 0.8  # of the narrower one's width
MIN_COMMON_VOLUME_SHARE = 0.4  # of another thing's volume: things that have more in common are in one place
COPY_BOUNDS_SHARE = 0.04  # of the longest side, between bounds of copies
COPY_DISTANCE_SHARE = 0.04  # of the diagonal, between surfaces of copies
MIN_COPIED_AREA_SHARE = 0.85  # of two things' area that is so close, if they're copies
MIN_COPIED_SURFACE_SHARE = 0.6  # of the surface that has copies, if the vehicle is drawn several times
MAX_COARSE_TRIANGLE_SHARE = 0.5  # of the triangles that a hull for collisions or shadows encloses
MIN_CONVEX_AREA_SHARE = 0.95  # of its convex hull's area, for such a mesh
MAX_SAMPLES, MAX_TARGETS = 400, 4000
MAX_PIECES = 2000  # more are one thing


def find_things_and_doubts(
    whole: PlacedPieces, meshes: Sequence[Mesh], rest: Sequence[Piece]
) -> tuple[tuple[Thing, ...], list[Doubt]]:
    """Find things to be read by themselves, as entries of a config, and doubts that propose their keys."""
    pieces = [*whole.pieces, *rest]
    groups = side_by_side_groups(whole.bounds) if len(whole.pieces) <= MAX_PIECES else []
    if groups := groups or _groups_of_vehicle_pieces(whole):
        things = [_make_thing(whole, group, keep=exclusive_piece_patterns(group, pieces)) for group in groups]
        head = f"it holds {len(things)} things that share one label; if they're vehicles of their own,"
        if not all(thing.keep for thing in things):
            return (), [_several_doubt(f"{head} give the objects of each a name in common, and list the file once for each")]
        listed = ", ".join(
            f"keep = {names_as_config_value(thing.keep)} ({_thing_size_text(thing)})" for thing in things[:MAX_LISTED_NAMES]
        )
        more = f" and {len(things) - MAX_LISTED_NAMES} more" if len(things) > MAX_LISTED_NAMES else ""
        text = f'{head} list the file once for each, with drop = ["*"] and {listed}{more}'
        return tuple(things), [_several_doubt(text)]
    if joined := side_by_side_groups(whole.solids.bounds):
        text = f"{len(joined)} things side by side share an object, and a label; make each a file of its own in Blender"
        return (), [_several_doubt(text)]
    spare = surface_copy_indices(whole, meshes) if 1 < len(whole.pieces) <= MAX_PIECES else []
    if not spare:
        return (), []
    drop = exclusive_piece_patterns(spare, pieces)
    names = quote_names((whole.pieces[i].name for i in spare), most=MAX_LISTED_NAMES)
    what = "other levels of detail, or meshes for collisions or shadows"
    key = f"set drop = {names_as_config_value(drop)}" if drop else "rename and drop them"
    text = f"{names}: drawn over the rest, and nearly as large; {key} if that's {what}"
    left = np.delete(np.arange(len(whole.pieces)), spare).tolist()
    return ((_make_thing(whole, left, drop=drop),) if drop else ()), [_several_doubt(text)]


def _several_doubt(text: str) -> Doubt:
    return Doubt(DoubtKind.SEVERAL, text)


def _make_thing(whole: PlacedPieces, group: list[int], *, keep: tuple[str, ...] = (), drop: tuple[str, ...] = ()) -> Thing:
    box = whole.bounds[group]
    size = xyz_tuple(box[:, 1].max(axis=0) - box[:, 0].min(axis=0))
    if drop:
        return Thing("", size, drop=drop)
    return Thing(keep[0].strip("*[]_-. ") if len(keep) == 1 else whole.pieces[group[0]].name, size, keep, ("*",))


def _thing_size_text(thing: Thing) -> str:
    return " x ".join(f"{length:.1f}" for length in thing.size) + " m"


def side_by_side_groups(bounds: Float[np.ndarray, "k 2 3"]) -> list[list[int]]:
    """Return groups of pieces that are separate things of comparable size; empty if they're one thing."""
    if len(bounds) < 2:
        return []
    label = touching_cluster_labels(bounds, MAX_PIECE_GAP_SHARE * float(np.ptp(bounds, axis=1).max()))
    boxes = np.array([[bounds[label == k, 0].min(axis=0), bounds[label == k, 1].max(axis=0)] for k in np.unique(label)])
    size = np.ptp(boxes, axis=1)
    diagonal, volume = np.linalg.norm(size, axis=1), size.prod(axis=1)
    large = np.flatnonzero(
        (diagonal >= MIN_THING_DIAGONAL_SHARE * diagonal.max()) & (volume >= MIN_THING_VOLUME_SHARE * volume.max())
    )
    if len(large) < 2:
        return []
    gaps = np.maximum(boxes[:, None, 0] - boxes[None, large, 1], boxes[None, large, 0] - boxes[:, None, 1]).max(axis=2)
    owner = gaps.argmin(axis=1)
    owner[large] = np.arange(len(large))
    if len(large) == 2 and _are_coupled(*boxes[large]):
        return []
    return [np.flatnonzero(owner[label] == k).tolist() for k in range(len(large))]


def _groups_of_vehicle_pieces(whole: PlacedPieces) -> list[list[int]]:
    """Return groups of pieces named as vehicles of different kinds, if there's nothing else or they're in one place."""
    chains = [[link.name for link in reversed(piece.chain)] for piece in whole.pieces]
    shared = set.intersection(*map(set, chains)) if len(chains) > 1 else set[str]()
    named: dict[str, list[int]] = {}
    for i, names in enumerate(chains):
        owner = (name for name in names if name not in shared and first_matching_pattern(name, VEHICLE_WORDS))
        named.setdefault(next(owner, names[-1]), []).append(i)
    groups = list(named.values())
    boxes = np.array([[whole.bounds[g, 0].min(axis=0), whole.bounds[g, 1].max(axis=0)] for g in groups])
    size = np.ptp(boxes, axis=1)
    large = (size >= MIN_THING_DIAGONAL_SHARE * size.max(axis=0)).all(axis=1)
    kinds = [first_matching_pattern(name, VEHICLE_WORDS) for name, wide in zip(named, large, strict=True) if wide]
    if len(set(kinds)) < 2 or not all(kinds):
        return []
    low, high = boxes[large].transpose(1, 0, 2)
    common = (np.minimum(high[:, None], high) - np.maximum(low[:, None], low)).clip(0.0).prod(axis=2)
    together = (common > MIN_COMMON_VOLUME_SHARE * size[large].prod(axis=1)).all()
    return [groups[i] for i in np.flatnonzero(large)] if together or large.all() else []


def _are_coupled(a: Float[np.ndarray, "2 3"], b: Float[np.ndarray, "2 3"]) -> bool:
    """Return whether one thing follows the other in line and close, like a trailer, or is above it."""
    gap = np.maximum(a[0] - b[1], b[0] - a[1])
    shared = (np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])) / np.minimum(a[1] - a[0], b[1] - b[0])
    length = max(float(np.ptp(a, axis=0)[:2].max()), float(np.ptp(b, axis=0)[:2].max()))
    along = int(gap.argmax())
    if along == 2:
        return True
    both = np.maximum(a[1], b[1])[:2] - np.minimum(a[0], b[0])[:2]
    return bool(
        both[along] > 1.5 * both[1 - along]
        and gap[along] < MAX_COUPLING_GAP_SHARE * length
        and shared[1 - along] > MIN_FACING_WIDTH_SHARE
    )


def surface_copy_indices(whole: PlacedPieces, meshes: Sequence[Mesh]) -> list[int]:
    """Return pieces that repeat the surface of others in place, more coarsely; empty if most is drawn once."""
    if spare := _coarse_level_indices(whole):
        return spare
    pieces, bounds = whole.pieces, whole.bounds
    faces = np.array([piece.faces for piece in pieces])
    triangles = [points[meshes[p.mesh].faces] for p, points in zip(pieces, whole.points, strict=True)]
    area = np.array([triangle_areas(corners).sum() for corners in triangles])
    samples = cache(lambda i: _surface_samples(triangles[i]))
    kept, spare, doubled = list[int](), list[int](), np.zeros(len(pieces), bool)
    for i in np.argsort(-faces, kind="stable").tolist():
        near = np.flatnonzero(_bounds_match_mask(bounds[kept], bounds[i])).tolist()
        twin = next((kept[j] for j in near if _surfaces_agree(samples(i), samples(kept[j]))), None)
        if twin is None:
            kept.append(i)
        else:
            spare.append(i)
            doubled[[i, twin]] = True
    if area[doubled].sum() >= MIN_COPIED_SURFACE_SHARE * area.sum():
        return sorted(spare)
    around = np.array([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
    for i in np.flatnonzero(_bounds_match_mask(bounds, around)).tolist():
        others = np.delete(np.arange(len(pieces)), i)
        if not _bounds_match_mask(bounds[i], np.array([bounds[others, 0].min(axis=0), bounds[others, 1].max(axis=0)])):
            continue
        cloud = _surface_samples(np.concatenate([triangles[j] for j in others]))
        finer, much_finer = (faces[i] <= share * faces[others].sum() for share in (1.0, MAX_COARSE_TRIANGLE_SHARE))
        if (finer and _surfaces_agree(samples(i), cloud)) or (
            much_finer and _is_hull_around_cloud(whole.points[i], float(area[i]), cloud)
        ):
            return [i]
    return []


def _coarse_level_indices(whole: PlacedPieces) -> list[int]:
    """Return pieces that are a level of detail, by their own or a parent's name, beside a finer one of like extent."""
    level = np.array([_detail_level(piece) for piece in whole.pieces])
    found = np.unique(level[level >= 0])
    boxes = [whole.bounds[level == k] for k in found]
    boxes = [np.array([box[:, 0].min(axis=0), box[:, 1].max(axis=0)]) for box in boxes]
    coarse = [
        k
        for k, box in zip(found[1:], boxes[1:], strict=True)
        if _bounds_match_mask(box, boxes[0], within=3 * COPY_BOUNDS_SHARE)
    ]
    return np.flatnonzero(np.isin(level, coarse)).tolist()


def _detail_level(piece: Piece) -> int:
    for link in piece.chain:
        for name in (link.name, *link.collections):
            parts = name_words(name)
            for before, number in pairwise(parts):
                if before == "lod" and number.isdigit():
                    return int(number)
    return -1


def _bounds_match_mask(
    a: Float[np.ndarray, "*n 2 3"], b: Float[np.ndarray, "2 3"], *, within: float = COPY_BOUNDS_SHARE
) -> Bool[np.ndarray, "*n"]:
    return np.abs(a - b).max(axis=(-1, -2)) <= within * float(np.ptp(b, axis=0).max())


def triangle_areas(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, " f"]:
    """Return the area of each triangle."""
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def _surface_samples(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return points spread over triangles, the same in every call."""
    area = triangle_areas(corners)
    if not area.sum() > 0:
        return corners[0, :1]
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(corners[rng.choice(len(area), MAX_TARGETS, p=area / area.sum())], 1, 0)
    u, v = np.sort(rng.random((2, MAX_TARGETS, 1)), axis=0)
    return u * a + (v - u) * b + (1 - v) * c


def _surfaces_agree(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> bool:
    close = COPY_DISTANCE_SHARE * float(np.linalg.norm(np.ptp(a, axis=0)))
    return all((cKDTree(to).query(of[:MAX_SAMPLES])[0] <= close).mean() >= MIN_COPIED_AREA_SHARE for of, to in ((a, b), (b, a)))


def _is_hull_around_cloud(points: Float[np.ndarray, "v 3"], area: float, cloud: Float[np.ndarray, "n 3"]) -> bool:
    try:
        hull = ConvexHull(points)
    except QhullError:
        return False
    slack = COPY_DISTANCE_SHARE * float(np.ptp(points, axis=0).max())
    inside = (cloud[:MAX_SAMPLES] @ hull.equations[:, :3].T + hull.equations[:, 3] <= slack).all(axis=1)
    return bool(area >= MIN_CONVEX_AREA_SHARE * hull.area and inside.mean() >= MIN_COPIED_AREA_SHARE)


def exclusive_piece_patterns(members: Sequence[int], pieces: Sequence[Piece]) -> tuple[str, ...]:
    """Return a few patterns for `keep` or `drop` that match these pieces and no others; empty if that's impossible.

    >>> from types import SimpleNamespace
    >>> def piece(name):
    ...     return SimpleNamespace(name=name, data="", chain=[SimpleNamespace(name=name, collections=())])
    >>> exclusive_piece_patterns([0, 1], [piece("hull_LOD1"), piece("gun_LOD1"), piece("hull_LOD0"), piece("gun_LOD0")])
    ('*_LOD1',)
    """
    inside = np.isin(np.arange(len(pieces)), members)
    found: list[str] = []
    open_ = inside.copy()
    while open_.any() and len(found) < MAX_SENTENCE_NAMES:
        best, most = "", 0
        for candidate in _candidate_patterns([pieces[i] for i in np.flatnonzero(open_)]):
            matched = np.array([is_kept_by_name(piece, (candidate,)) for piece in pieces])
            if not (matched & ~inside).any() and (count := int((matched & open_).sum())) > most:
                best, most, covered = candidate, count, matched
        if not best:
            return ()
        found.append(best)
        open_ &= ~covered
    return () if open_.any() else tuple(found)


def _candidate_patterns(pieces: Sequence[Piece]) -> list[str]:
    first, names = pieces[0], [piece.name for piece in pieces]
    own = name_words(first.name)
    around = [name for link in first.chain[::-1] for name in (*link.collections[::-1], link.name)]
    prefix, suffix = _common_beginning(names), _common_beginning([name[::-1] for name in names])[::-1]
    joined = ["".join(own[i:k]) for i in range(len(own)) for k in range(i + 1, len(own) + 1)]
    globs = [f"{escape(prefix)}*", f"*{escape(suffix)}"] if len(pieces) > 1 else [first.name]
    whole = escape(first.name[:1]) if first.name[:1] in "*?[" else f"[{first.name[:1]}]"
    literal = f"{whole}{escape(first.name[1:])}"  # a glob matches the whole name
    return [one for one in (*around[:-1], *globs, *joined, literal) if one.strip("*") and not one.isdigit()]


def _common_beginning(names: Sequence[str]) -> str:
    low, high = min(names), max(names)
    return low[: next((i for i, (x, y) in enumerate(zip(low, high, strict=False)) if x != y), len(low))]
