"""Find kept pieces that don't belong to the vehicle: hidden ones, unedited primitives, pieces below the wheels."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hulldown.assets.naming import FIGURES, STAGES, first_match, words
from hulldown.geometry.meshes import Mesh
from hulldown.reading.roles import MUCH_LARGER, UNDERSIDE, Piece
from hulldown.reading.vehicle.axes import Wheels
from hulldown.reading.wording import as_key, quoted

BELOW = 0.03  # of the vehicle's height: a tire pressed into the ground
OUT = 0.1  # of the length of the rest
APART = 0.02  # of the rest's length: least gap around it
BESIDE = (*STAGES, *FIGURES)  # without "plane", which armor plates are named too
FAR = 0.08  # least gap if it can't belong to the rest
SMALL = 0.75  # diagonal of a thing next to a vehicle over that of the rest; trailers are longer
FLAT = 1e-4  # of its longest side: a sheet without thickness
NAMES = 6  # that a sentence lists


@dataclass(frozen=True, slots=True)
class Strays:
    """Index of each dropped piece among the kept ones -> reason; and doubts about those and the rest."""

    out: dict[int, str]
    out_doubts: tuple[str, ...]
    doubts: tuple[str, ...]


def find_strays(
    pieces: Sequence[Piece],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    meshes: Sequence[Mesh],
    wheels: Wheels | None,
    *,
    wheeled: Collection[int],
    wanted: Collection[int],
) -> Strays:
    """Find pieces that don't belong to the vehicle, and pieces that might not.

    One sign is a doubt, since parts of vehicles may have it. Two independent signs drop a piece:
    no part is both an unedited cube and below the wheels, or both hidden and a protruding sheet.

    Parameters
    ----------
    pieces
        The kept pieces.
    points
        Vertices of each, x forward, z up.
    meshes
        The file's unique meshes.
    wheels
        Wheels in the same frame.
    wheeled
        Pieces with wheels, which are never strays.
    wanted
        Pieces that the config keeps.
    """
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    height = float(bounds[:, 1, 2].max() - bounds[:, 0, 2].min())
    loose = [i for i in range(len(pieces)) if i not in wheeled]
    beside = loose if len(pieces) > 1 else []  # compared with the rest
    hidden = [i for i, p in enumerate(pieces) if p.hidden]
    low = [] if wheels is None else [i for i, b in enumerate(bounds) if b[0, 2] < wheels.level - BELOW * height]
    # If much is below the wheels, they aren't on the ground: tracks are around them, or skirts.
    low = low if len(low) <= max(2, len(pieces) // 10) else []
    regular = [i for i in loose if _is_regular(pieces[i], points[i])]
    apart = [i for i in beside if not _near(i, bounds, APART)]
    sheets = [i for i in beside if _is_sheet_beyond(i, bounds)]
    beyond = [i for i in beside if i in sheets or _is_bulk(i, bounds)]
    signs = {
        "hidden from the viewport, but rendered": hidden,
        "reaching below the wheels": low,
        "as regular as a new mesh of Blender's": regular,
        "not touching the rest": apart,
        "a flat sheet or a bulk that sticks out of the rest": beyond,
    }
    told = {i for some in signs.values() for i in some}
    backdrops = [i for i in beyond if _is_backdrop(i, points, meshes[pieces[i].mesh], bounds, told)]
    out = dict.fromkeys(backdrops, "a sheet that lies under the rest and rises beside it")
    out |= {
        i: "named like a stage or a figure, and not touching the vehicle"
        for i in apart
        if first_match(pieces[i].name, BESIDE)
    }
    out |= {i: "hidden from the viewport, and a regular primitive" for i in regular if i in hidden}
    out |= {i: "hidden from the viewport, and a sheet that sticks out" for i in sheets if i in hidden}
    ground = None if wheels is None else wheels.level + BELOW * height
    under = [i for i in loose if ground is not None and _is_under(bounds[i], bounds[sorted(wheeled)], ground)]
    out |= dict.fromkeys(under, "under all of the wheels")
    sure = set(out)
    out |= {i: "far from the rest" for i in apart if _is_far(i, bounds) and i not in sure}
    out |= {i: "a regular primitive that reaches below the wheels" for i in regular if i in low and i not in sure}
    out |= {i: "a sheet that reaches below the wheels and out" for i in sheets if i in low and i not in sure}
    out = {i: why for i, why in out.items() if i not in wanted}
    out_doubts = tuple(
        f"{pieces[i].name!r}: {why}; left out, set keep = {as_key([pieces[i].name])} if it is part of it"
        for i, why in out.items()
        if i not in sure
    )
    doubts = []
    seen = set(out)
    for what, some in signs.items():
        if new := [i for i in some if i not in seen]:
            names = [pieces[i].name for i in new]
            listed = as_key(names, most=NAMES)
            doubts.append(f"{quoted(names, most=NAMES)}: {what}; set drop = {listed} if that isn't part of it")
        seen |= set(some)
    return Strays(out, out_doubts, tuple(doubts))


def _is_regular(piece: Piece, points: Float[np.ndarray, "v 3"]) -> bool:
    """Whether it's named like a new cube or sphere, and as wide as high."""
    named = [word for word in words(piece.name) if not word.isdigit()]
    off = points - points.mean(axis=0)
    moments = np.linalg.eigvalsh(off.T @ off)
    alike = bool(moments[0] > 0.9 * moments[2] > 0)
    return alike and ((named == ["cube"] and len(points) in (8, 24)) or named in (["sphere"], ["icosphere"]))


def _is_sheet_beyond(i: int, bounds: np.ndarray) -> bool:
    """Whether it's a sheet without thickness that reaches beyond the rest."""
    size = bounds[i, 1] - bounds[i, 0]
    if size.min() > FLAT * size.max():
        return False
    low, high = _rest(i, bounds)
    return bool(np.maximum(low - bounds[i, 0], bounds[i, 1] - high).max() > OUT * (high - low).max())


def _is_bulk(i: int, bounds: np.ndarray) -> bool:
    """Whether it's larger than the rest in two directions."""
    low, high = _rest(i, bounds)
    return int((bounds[i, 1] - bounds[i, 0] > 1.3 * (high - low)).sum()) >= 2


def _is_backdrop(
    i: int, points: Sequence[Float[np.ndarray, "_ 3"]], mesh: Mesh, bounds: np.ndarray, told: Collection[int]
) -> bool:
    """Whether it's a studio backdrop: level below the rest, wider on all sides, with nothing above the rest.

    A hull under a turret is wider too, but reaches lower than the turret does; a body around its seats has a roof.
    """
    sure = [k for k in range(len(bounds)) if k not in told]
    if not sure:
        return False
    low, high = _around(bounds[sure])
    slack = UNDERSIDE * (high - low)[2]
    wider = (bounds[i, 0] < low)[:2].all() and (bounds[i, 1] > high)[:2].all()
    larger = np.prod((bounds[i, 1] - bounds[i, 0])[:2]) > MUCH_LARGER * np.prod((high - low)[:2])
    if not (wider and larger and abs(bounds[i, 0, 2] - low[2]) < slack):
        return False
    corners = points[i][mesh.faces]
    near = ((corners.min(axis=1) < high) & (corners.max(axis=1) > low))[:, :2].all(axis=1)
    return bool(near.any() and (corners[near][..., 2] < low[2] + slack).all())


def _is_under(own: Float[np.ndarray, "2 3"], wheels: Float[np.ndarray, "n 2 3"], ground: float) -> bool:
    """Whether it's below all wheels and reaches beyond them, so it doesn't hang between them."""
    low, high = _around(wheels)
    return bool(own[1, 2] < ground and ((own[0] < low) & (own[1] > high))[:2].all())


def _is_far(i: int, bounds: np.ndarray) -> bool:
    """Whether it's much smaller than the rest and farther away than a slightly displaced part."""
    low, high = _rest(i, bounds)
    small = np.linalg.norm(bounds[i, 1] - bounds[i, 0]) < SMALL * np.linalg.norm(high - low)
    return bool(small and not _near(i, bounds, FAR))


def _around(bounds: Float[np.ndarray, "n 2 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    return bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)


def _rest(i: int, bounds: np.ndarray) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The box around all others."""
    return _around(np.delete(bounds, i, axis=0))


def _near(i: int, bounds: np.ndarray, share: float) -> bool:
    """Whether another box is closer than a share of the rest's length."""
    low, high = _rest(i, bounds)
    slack = share * float((high - low).max())
    near = (bounds[:, 0] < bounds[i, 1] + slack) & (bounds[:, 1] > bounds[i, 0] - slack)
    return bool(near.all(axis=1).sum() > 1)
