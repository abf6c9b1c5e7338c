"""Find kept pieces that don't belong to the vehicle: hidden ones, unedited primitives, pieces below the wheels."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import PERSON_WORDS, STAGE_WORDS, first_matching_pattern, name_words
from hulldown.reading.pieces.roles import MAX_SUNK_SHARE, MIN_STAGE_AREA_RATIO, Piece
from hulldown.reading.pieces.wording import MAX_LISTED_NAMES, names_as_config_value, quote_names
from hulldown.reading.vehicle.solids import PlacedPieces, Wheels
from hulldown.reading.vehicle.things import exclusive_piece_patterns, triangle_areas

MAX_BELOW_SHARE = 0.03  # of the vehicle's height: a tire pressed into the ground
MIN_OUTREACH_SHARE = 0.1  # of the rest's length
MIN_GAP_SHARE = 0.02  # of the rest's length
STRAY_WORDS = (*STAGE_WORDS, *PERSON_WORDS)  # without "plane", which armor plates are named too
MIN_FAR_GAP_SHARE = 0.08  # of the rest's length, for what can't belong to the rest
MAX_THING_DIAGONAL_SHARE = 0.75  # of the rest's diagonal, for a thing next to a vehicle; trailers are longer
MIN_HULL_SURFACE_SHARE = 0.35  # of the surface; such a piece is no stray
MAX_DROPPED_SURFACE_SHARE = 0.05  # of the surface that a doubt proposes to drop, but for sheets
MIN_BULK_RATIO = 1.3  # to the rest's extent, in two directions
MAX_FLAT_THICKNESS_SHARE = 1e-4  # of its longest side, for a sheet without thickness


@dataclass(frozen=True, slots=True)
class Stray:
    """Pieces that might not belong to a vehicle."""

    text: str  # their names, and what is odd about them
    drop: tuple[str, ...]  # patterns that match them and nothing else
    small: bool  # whether the pieces are a small share of the vehicle's surface, or sheets

    def doubt(self, *, helps: bool) -> Doubt:
        """Return a doubt that proposes to drop the pieces if that `helps`, or else to look at them first."""
        advice = f"set drop = {names_as_config_value(self.drop)} if that" if helps else "look at it, and name it in drop if it"
        return Doubt(DoubtKind.STRAY, f"{self.text}; {advice} isn't part of it")


def find_left_out_and_strays(
    whole: PlacedPieces, meshes: Sequence[Mesh], wheels: Wheels | None, *, wanted: Collection[int], left_out: Sequence[Piece]
) -> tuple[dict[int, str], list[Doubt], list[Stray]]:
    """Find pieces that don't belong to the vehicle by two independent signs, and those that might not, by one."""
    pieces, bounds, count = whole.pieces, whole.bounds, len(whole.pieces)
    none = np.zeros(count, bool)
    loose, low, under = ~none, none, none
    if wheels is not None:
        wheeled = np.unique(whole.solids.piece[wheels.index])
        loose = ~np.isin(np.arange(count), wheeled)
        slack = MAX_BELOW_SHARE * float(bounds[:, 1, 2].max() - bounds[:, 0, 2].min())
        low = bounds[:, 0, 2] < wheels.level - slack
        # If much is below the wheels, they aren't on the ground: tracks are around them, or skirts.
        low = low if low.sum() <= max(2, count // 10) else none
        # What reaches beyond the wheels doesn't hang between them.
        first, last = _joint_bounds(bounds[wheeled])
        beyond_wheels = ((bounds[:, 0] < first) & (bounds[:, 1] > last))[:, :2].all(axis=1)
        under = loose & beyond_wheels & (bounds[:, 1, 2] < wheels.level + slack)
    hidden = np.array([piece.hidden for piece in pieces], bool)
    regular = loose & [_is_regular_primitive(piece, own) for piece, own in zip(pieces, whole.points, strict=True)]
    apart = far = sheets = around = none
    if count > 1:
        rest, gap = np.empty_like(bounds), np.empty(count)  # around all others, and to the nearest of them
        for i, own in enumerate(bounds):
            others = np.delete(bounds, i, axis=0)
            rest[i] = _joint_bounds(others)
            gap[i] = np.maximum(others[:, 0] - own[1], own[0] - others[:, 1]).max(axis=1).min()
        size, extent = np.ptp(bounds, axis=1), np.ptp(rest, axis=1)
        length = extent.max(axis=1)
        sheets = loose & (size.min(axis=1) <= MAX_FLAT_THICKNESS_SHARE * size.max(axis=1))
        sheets &= np.maximum(rest[:, 0] - bounds[:, 0], bounds[:, 1] - rest[:, 1]).max(axis=1) > MIN_OUTREACH_SHARE * length
        around = loose & ((size > MIN_BULK_RATIO * extent).sum(axis=1) >= 2)
        apart = loose & (gap >= MIN_GAP_SHARE * length)
        small = np.linalg.norm(size, axis=1) < MAX_THING_DIAGONAL_SHARE * np.linalg.norm(extent, axis=1)
        far = apart & small & (gap >= MIN_FAR_GAP_SHARE * length)
    signs = {
        "hidden from the viewport, but rendered": hidden,
        "reaching below the wheels": low,
        "as regular as a new mesh of Blender's": regular,
        "not touching the rest": apart,
        "a flat sheet that sticks out of the rest": sheets,
    }
    sure_parts = bounds[~np.any([*signs.values(), around], axis=0)]
    backdrops = (sheets | around) & [
        _is_backdrop(own, meshes[p.mesh], sure_parts) for p, own in zip(pieces, whole.points, strict=True)
    ]
    named = apart & [first_matching_pattern(piece.name, STRAY_WORDS) is not None for piece in pieces]
    sure = backdrops | named | (hidden & (regular | sheets)) | under
    reasons = (
        (backdrops, "a sheet that lies under the rest and rises beside it"),
        (named, "named like a stage or a figure, and not touching the vehicle"),
        (hidden & regular, "hidden from the viewport, and a regular primitive"),
        (hidden & sheets, "hidden from the viewport, and a sheet that sticks out"),
        (under, "under all of the wheels"),
        (far & ~sure, "far from the rest"),
        (regular & low & ~sure, "a regular primitive that reaches below the wheels"),
        (sheets & low & ~sure, "a sheet that reaches below the wheels and out"),
    )
    out = {i: why for mask, why in reasons for i in np.flatnonzero(mask).tolist() if i not in wanted}
    out_doubts = [
        Doubt(
            DoubtKind.LEFT_OUT,
            f"{pieces[i].name!r}: {why}; left out, set keep = {names_as_config_value([pieces[i].name])} if it is part of it",
        )
        for i, why in out.items()
        if not sure[i]
    ]
    strays = []
    area = np.array([triangle_areas(p[meshes[m.mesh].faces]).sum() for p, m in zip(whole.points, pieces, strict=True)])
    seen = np.isin(np.arange(count), list(out)) | ((area > MIN_HULL_SURFACE_SHARE * area.sum()) & ~sheets)
    for what, mask in signs.items():
        own = np.flatnonzero(mask & ~seen)
        share = float(area[own].sum() / max(area.sum(), 1e-30))
        if len(own) and (drop := exclusive_piece_patterns(own.tolist(), [*pieces, *left_out])):
            names = quote_names((pieces[i].name for i in own), most=MAX_LISTED_NAMES)
            much = share > MAX_DROPPED_SURFACE_SHARE
            text = f"{names}: {what}" + (f", {100 * share:.0f} % of its surface" if much else "")
            strays.append(Stray(text, drop, small=not much or bool(sheets[own].all())))
        seen |= mask
    return out, out_doubts, strays


def _is_regular_primitive(piece: Piece, points: Float[np.ndarray, "v 3"]) -> bool:
    named = [word for word in name_words(piece.name) if not word.isdigit()]
    off = points - points.mean(axis=0)
    moments = np.linalg.eigvalsh(off.T @ off)
    alike = bool(moments[0] > 0.9 * moments[2] > 0)
    return alike and ((named == ["cube"] and len(points) in (8, 24)) or named in (["sphere"], ["icosphere"]))


def _is_backdrop(own: Float[np.ndarray, "v 3"], mesh: Mesh, sure: Float[np.ndarray, "n 2 3"]) -> bool:
    """Return whether a piece is a studio backdrop: level below the sure parts, wider, and nothing above them."""
    if not len(sure):
        return False
    low, high = _joint_bounds(sure)
    own_low, own_high = own.min(axis=0), own.max(axis=0)
    slack = MAX_SUNK_SHARE * (high - low)[2]
    wider = (own_low < low)[:2].all() and (own_high > high)[:2].all()
    larger = np.prod((own_high - own_low)[:2]) > MIN_STAGE_AREA_RATIO * np.prod((high - low)[:2])
    if not (wider and larger and abs(own_low[2] - low[2]) < slack):
        return False
    corners = own[mesh.faces]
    near = ((corners.min(axis=1) < high) & (corners.max(axis=1) > low))[:, :2].all(axis=1)
    return bool(near.any() and (corners[near][..., 2] < low[2] + slack).all())


def _joint_bounds(bounds: Float[np.ndarray, "n 2 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    return bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
