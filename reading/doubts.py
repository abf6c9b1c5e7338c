"""Doubts about vehicles and sceneries as they were read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hulldown.reading.pieces.asset_report import By, FileReport, Missing, ObjectRow
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import first_matching_pattern
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Piece, PieceRole
from hulldown.reading.pieces.wording import MAX_SENTENCE_NAMES, names_as_config_value, quote_names
from hulldown.reading.scenery.scenery_roles import is_water_name
from hulldown.reading.scenery.shape import MIN_LEVEL_SHARE, MIN_PIT_DEPTH_M, canopy_sheets_and_heights, enclosing_piece

MAX_VEHICLE_LENGTH_M = 60.0  # the longest road trains
MIN_VEHICLE_LENGTH_M = 0.8
MIN_SCENERY_EXTENT_M = 20.0
MAX_SCENERY_EXTENT_M = 200_000.0
MAX_UPRIGHT_GROUND_SHARE = 0.05  # of a scenery's height and length: narrower ground stands upright
MAX_CROWDED_SHARE = 0.05  # of the widest ground's area
LIKELY_LENGTHS = (2.0, 20.0)
UsedPieces = Sequence[tuple[Piece, PieceRole]]  # what is rendered, with its use
# Words for things of known height, their usual median height in meters, and words for parts of such things.
USUAL_HEIGHTS = {
    ("tree", "trees", "oak", "pine", "spruce", "fir", "birch", "palm"): (1.5, 80.0),
    ("house", "building", "church", "skyscraper"): (2.0, 400.0),
}
PARTS_OF_THINGS = (
    *("stump", "trunk", "log", "branch", "leaf", "leaves", "root", "bark", "sapling", "wall", "roof", "door", "window"),
    *("floor", "sign", "ruin", "frame", "stairs", "step", "base", "ground", "light", "cone", "number"),
)
USUAL_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.3048, 100.0, 10.0, 0.1)


def vehicle_doubts(report: FileReport, options: Options) -> tuple[Doubt, ...]:
    """Return doubts about a vehicle's size and dropped pieces."""
    return tuple(_vehicle_size_and_drop_doubts(report, options))


def _vehicle_size_and_drop_doubts(report: FileReport, options: Options) -> Iterator[Doubt]:
    length, width, height = report.size
    longest, across = max(report.size), max(length, width)
    if not MIN_VEHICLE_LENGTH_M <= longest <= MAX_VEHICLE_LENGTH_M:
        hint = likely_scale_text(longest, report.unit)
        text = f"the vehicle is {format_length(longest)} long; set scale{hint} if that is wrong"
        text += ", or list it under [[assets.sceneries]] if it's one" * (longest > MAX_VEHICLE_LENGTH_M)
        yield Doubt(DoubtKind.SCALE, text)
    if height > 1.5 * across and options.up is None:
        other = "z" if report.up == "y" else "y"
        text = f"it is {format_length(height)} high and {format_length(across)} long"
        yield Doubt(DoubtKind.UP, f'{text}; set up = "{other}" if it stands on its end')
    kept = [row for row in report.rows if row.use != "dropped"]
    asked = [row for row in report.rows if row.use == "dropped" and row.by is By.CONFIG]
    dropped = [row for row in report.rows if row.use == "dropped" and row.by is not By.CONFIG and row.triangles]
    if sum(row.triangles * row.count for row in dropped) > sum(row.triangles * row.count for row in kept):
        text = "more triangles are dropped than kept; name the vehicle's objects in `keep`"
        yield Doubt(DoubtKind.MOST_DROPPED, f"{text}: {quote_names(row.name for row in dropped)}")
    most = max(asked, key=_row_volume, default=None)
    if most and _row_volume(most) > max(map(_row_volume, kept), default=0.0):
        text = f"the config drops {most.name!r}, the largest piece; take it out of drop if it's the hull"
        yield Doubt(DoubtKind.LARGEST_DROPPED, text)
    yield from _missing_file_doubts(report.missing)


def _row_volume(row: ObjectRow) -> float:
    return math.prod(row.size)


def scenery_doubts(
    report: FileReport,
    pieces: Sequence[Piece],
    roles: Sequence[PieceRole],
    options: Options,
    *,
    wet: Sequence[str] = (),
    parked: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> tuple[Doubt, ...]:
    """Return doubts about a scenery, missing ground first. Ground in `wet` is partly water; `parked` are vehicles."""
    used = [(piece, role) for piece, role in zip(pieces, roles, strict=True) if role.use not in ("dropped", "removed")]
    return (
        *_scenery_role_doubts(used, options, wet, parked),
        *_ground_shape_doubts(used),
        *_surroundings_doubts(used),
        *_scenery_size_doubts(report, options),
        *_object_height_doubts(used, report, options),
        *_missing_file_doubts(report.missing),
    )


def _scenery_role_doubts(
    used: UsedPieces, options: Options, wet: Sequence[str], parked: Mapping[str, Sequence[str]]
) -> Iterator[Doubt]:
    if not any(role.use == "ground" for _, role in used):
        text = "NO GROUND: no object is ground by name or by shape, so vehicles are placed on the plane z = "
        proposed = _ground_proposal_text([piece for piece, role in used if role.use == "obstacle"])
        there = quote_names(piece.name for piece, _ in used)
        yield Doubt(DoubtKind.NO_GROUND, f"{text}ground.fallback_z; {proposed}; in the file is {there}")
    if parked:
        objects = list(dict.fromkeys(name for own in parked.values() for name in own))
        key = f"drop = {names_as_config_value(objects)}" if len(objects) <= MAX_SENTENCE_NAMES else "their objects in drop"
        text = f"vehicles stand in it and get no label: {quote_names(parked)}; if they're of your classes, set {key}, and "
        yield Doubt(DoubtKind.UNLABELED, f"{text}list them as vehicles")
    for use, keys in (("ground", "if it isn't, name it in not_ground"), ("water", "if it isn't, set water = []")):
        if found := [piece.name for piece, role in used if role.use == use and role.by is By.SHAPE]:
            yield Doubt(DoubtKind(use), f"taken as {use}: {quote_names(found)}, by shape; {keys}")
    if wet:
        text = f"taken as water: the faces of {quote_names(wet)} that wear water; if they are ground, set water = []"
        yield Doubt(DoubtKind.WATER, text)
    ground = [piece for piece, role in used if role.use == "ground" and options.water is None]
    dressed = [(p.name, m) for p in ground if p.name not in wet for m in p.materials if is_water_name(m)]
    for name, material in list(dict.fromkeys(dressed))[:MAX_SENTENCE_NAMES]:
        text = "if a part of it is water, make that an object of its own in Blender and name it in water"
        yield Doubt(DoubtKind.WATER, f"{name!r} is ground and wears {material!r}; {text}")
    for piece, role in used:
        if role.use == "obstacle" and role.by is By.SHAPE:
            yield Doubt(DoubtKind.NOT_GROUND, f"{piece.name!r} isn't used as ground, {role.why}")


def _ground_shape_doubts(used: UsedPieces) -> Iterator[Doubt]:
    grounds = [piece for piece, role in used if role.use == "ground"]
    if grounds and 0 < (main := max(grounds, key=lambda p: p.area)).level < MIN_LEVEL_SHARE:
        steep = f"{main.name!r} is ground, and {100 * (1 - main.level):.0f} % of it is steep"
        text = "if buildings are part of it, vehicles are placed on their roofs; make them objects of their own"
        yield Doubt(DoubtKind.STEEP_GROUND, f"{steep}: {text} in Blender")
    named = [piece for piece, role in used if role.use == "obstacle" and role.by is not By.SHAPE]
    low = np.min([piece.bounds[0] for piece in grounds], axis=0, initial=np.inf)
    high = np.max([piece.bounds[1] for piece in grounds], axis=0, initial=-np.inf)
    middles = [(piece, piece.bounds.mean(axis=0)) for piece in named if not (piece.hair or piece.scattered)]
    # Without hills on the horizon.
    level = [piece for piece, at in middles if ((at >= low) & (at <= high))[:2].all()]
    if grounds and _total_level_area(level) > _total_level_area(grounds):
        text = f"obstacles have more level surface than the ground, {quote_names(piece.name for piece in grounds)}"
        yield Doubt(DoubtKind.NOT_GROUND, f"{text}; {_ground_proposal_text(level)}")
    rest = [piece for piece, role in used if role.use in ("ground", "obstacle") and grounds and piece is not main]
    if len(grounds) > 1 and len(rest) > len(grounds):
        (left, front, _), (right, back, _) = (np.min([p.bounds[0] for p in rest], 0), np.max([p.bounds[1] for p in rest], 0))
        if (share := (right - left) * (back - front) / main.area) < MAX_CROWDED_SHARE:
            text = f"everything but {main.name!r} is in {100 * share:.1g} % of its area, and most positions are elsewhere"
            yield Doubt(DoubtKind.GROUND, f"{text}; to leave it out, set not_ground = {names_as_config_value([main.name])}")


def _surroundings_doubts(used: UsedPieces) -> Iterator[Doubt]:
    """Yield doubts about pieces above, below, and around everything else."""
    grounds = [piece for piece, role in used if role.use == "ground"]
    solid = [piece for piece, role in used if role.use == "obstacle" and not piece.hair]
    lowest = min((piece.bounds[0, 2] for piece in solid), default=-np.inf)
    if grounds and (depth := float(lowest - max(piece.bounds[1, 2] for piece in grounds))) > MIN_PIT_DEPTH_M:
        text = f"the ground, {quote_names(piece.name for piece in grounds)}, is {depth:.0f} m below everything else"
        yield Doubt(DoubtKind.NOT_GROUND, f"{text}; {_ground_proposal_text(solid)}")
    for sheet, above in canopy_sheets_and_heights(solid, [piece.bounds for piece in grounds]):
        name = names_as_config_value([sheet.name])
        text = f"{sheet.name!r} is a level sheet {above:.1f} m above the ground, and nothing is placed under it"
        keys = f"if it's ground, set ground = {name}, if it's water, set water = {name}, else drop = {name}"
        yield Doubt(DoubtKind.SHEET_ABOVE, f"{text}; {keys}")
    if around := enclosing_piece([piece for piece, role in used if role.use in ("obstacle", "ground")]):
        text = f"{around.name!r} is around everything else and hides the HDRI; if it is a sky, set "
        yield Doubt(DoubtKind.AROUND_ALL, f"{text}drop = {names_as_config_value([around.name])}")


def _scenery_size_doubts(report: FileReport, options: Options) -> Iterator[Doubt]:
    *sides, height = report.size
    across, other = max(sides), "z" if report.up == "y" else "y"
    if not MIN_SCENERY_EXTENT_M <= across <= MAX_SCENERY_EXTENT_M:
        text = f"the scenery is {format_length(across)} across; set scale if that is wrong (1 unit is {report.unit:g} m)"
        yield Doubt(DoubtKind.SCALE, text)
    if options.up is not None:
        return
    if height > across:
        text = f'it is {height:.0f} m high and {across:.0f} m across; set up = "{other}" if it lies on its side'
        yield Doubt(DoubtKind.UP, text)
    elif min(sides) < MAX_UPRIGHT_GROUND_SHARE * min(across, height):
        seen = " x ".join(map(format_length, sides))
        text = f'it stands on its edge: {seen} seen from above, {format_length(height)} high; set up = "{other}"'
        yield Doubt(DoubtKind.UP, text)


def _object_height_doubts(used: UsedPieces, report: FileReport, options: Options) -> Iterator[Doubt]:
    """Yield a doubt if trees or houses have unusual heights, as in a file with a toy's or a game's unit."""
    for words, (low, high) in USUAL_HEIGHTS.items() if options.scale is None else ():
        names = {
            p.name
            for p, _ in used
            if first_matching_pattern(p.name, words) and not first_matching_pattern(p.name, PARTS_OF_THINGS)
        }
        heights = [piece.size[2] for piece, role in used if role.use == "obstacle" and piece.name in names]
        median = float(np.median(heights)) if heights else low
        if not low <= median <= high:
            hint = likely_scale_text(median, report.unit, (2.0 * low, 20.0 * low))
            text = f"the median height of {quote_names(sorted(names), most=3)} is {format_length(median)}"
            yield Doubt(DoubtKind.SCALE, f"{text}; set scale{hint} if that is wrong")
            return


def _ground_proposal_text(among: Sequence[Piece]) -> str:
    able = [piece for piece in among if not (piece.hair or piece.scattered)]
    if not able:
        return "name what is to be ground in this scenery's `ground`"
    widest = max(able, key=lambda piece: (piece.level >= MIN_LEVEL_SHARE, piece.area))
    families: dict[str, list[Piece]] = {}
    for piece in able:
        families.setdefault(re.split(r"\d", piece.name, maxsplit=1)[0].rstrip("_- .") or piece.name, []).append(piece)
    stem, family = max(families.items(), key=lambda one: _total_level_area(one[1]))
    if len(family) > MAX_SENTENCE_NAMES and _total_level_area(family) > _total_level_area([widest]):
        return f"if it is the {len(family)} pieces {stem}..., give this scenery ground = {names_as_config_value([stem + '*'])}"
    return f"if it is {widest.name!r}, give this scenery ground = {names_as_config_value([widest.name])}"


def _total_level_area(pieces: Sequence[Piece]) -> float:
    return sum(piece.level * piece.area for piece in pieces)


def _missing_file_doubts(missing: Sequence[Missing]) -> Iterator[Doubt]:
    for one in missing:
        users = quote_names(one.wanted_by) if one.wanted_by else "the file"
        yield Doubt(DoubtKind.MISSING, f"{one.problem}: {one.path}, used by {users}")


def likely_scale_text(longest: float, unit: float, usual: tuple[float, float] = LIKELY_LENGTHS) -> str:
    """Return the usual unit that gives a vehicle a usual length, as " = 100 (now 1)", or only the present unit."""
    middle = math.sqrt(usual[0] * usual[1])
    best = min(USUAL_UNITS, key=lambda meters: abs(math.log(max(longest, 1e-9) / unit * meters / middle)))
    return f" = {best:g} (now {unit:g})" if usual[0] <= longest / unit * best <= usual[1] else f" (now {unit:g})"


def format_length(length: float) -> str:
    """Return a length in meters as people write it: "6,000 m", "5.42 cm"."""
    if length >= 100:
        return f"{length:,.0f} m"
    return f"{length:.3g} m" if length >= 1 else f"{100 * length:.3g} cm"
