"""Doubts about vehicles and sceneries as they were read."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from hulldown.reading.pieces.asset_report import By, FileReport, Missing, ObjectRow
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Piece, PieceRole
from hulldown.reading.pieces.wording import MOST_NAMES, as_key, quoted
from hulldown.reading.scenery.scenery_roles import is_water_name
from hulldown.reading.scenery.shape import LEVEL, PUDDLE, canopies, enclosing, sheets_between

LONGEST_VEHICLE = 60.0  # meters; the longest road trains
SHORTEST_VEHICLE = 0.8
SMALLEST_SCENERY = 20.0
LARGEST_SCENERY = 200_000.0
EDGE = 0.05  # of a scenery's height and length: largest width of ground that stands upright
LIKELY_LENGTHS = (2.0, 20.0)
USUAL_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.3048, 100.0, 10.0, 0.1)


def vehicle_doubts(report: FileReport, options: Options) -> tuple[Doubt, ...]:
    """Return doubts about a vehicle's size and dropped pieces."""
    doubts = []
    length, width, height = report.size
    longest, rows = max(report.size), report.rows
    if not SHORTEST_VEHICLE <= longest <= LONGEST_VEHICLE:
        hint = likely_scale(longest, report.unit)
        doubts.append(
            Doubt(DoubtKind.SCALE, f"the vehicle is {length_said(longest)} long; set scale{hint} if that is wrong")
        )
    if height > 1.5 * max(length, width) and options.up is None:
        doubts.append(
            Doubt(
                DoubtKind.UP,
                f"it is {length_said(height)} high and {length_said(max(length, width))} long; "
                'set up = "y" if it lies on its side',
            )
        )
    dropped = [row for row in rows if row.use == "dropped" and row.triangles and row.by is not By.CONFIG]
    kept = [row for row in rows if row.use != "dropped"]
    if sum(row.triangles * row.count for row in dropped) > sum(row.triangles * row.count for row in kept):
        names = quoted([row.name for row in dropped])
        doubts.append(
            Doubt(
                DoubtKind.MOST_DROPPED,
                f"more triangles are dropped than kept; name the vehicle's objects in `keep`: {names}",
            )
        )
    asked = [row for row in rows if row.use == "dropped" and row.by is By.CONFIG]
    most = max(asked, key=_volume, default=None)
    if most and _volume(most) > max(map(_volume, kept), default=0.0):
        doubts.append(
            Doubt(
                DoubtKind.LARGEST_DROPPED,
                f"the config drops {most.name!r}, the largest piece; take it out of drop if it's the hull",
            )
        )
    return (*doubts, *_missing(report.missing))


def _volume(row: ObjectRow) -> float:
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
    doubts = []
    used = [(piece, role) for piece, role in zip(pieces, roles, strict=True) if role.use not in ("dropped", "removed")]
    if not any(role.use == "ground" for _, role in used):
        doubts.append(
            Doubt(
                DoubtKind.NO_GROUND,
                "NO GROUND: no object is ground by name or by shape, so vehicles are placed on the plane z = "
                f"ground.fallback_z; {_proposed_ground([p for p, r in used if r.use == 'obstacle'])}; in the file is "
                + quoted([piece.name for piece, _ in used]),
            )
        )
    if parked:
        objects = list(dict.fromkeys(name for own in parked.values() for name in own))
        key = f"drop = {as_key(objects)}" if len(objects) <= MOST_NAMES else "their objects in drop"
        doubts.append(
            Doubt(
                DoubtKind.UNLABELED,
                f"vehicles stand in it and get no label: {quoted(parked)}; if they're of your classes, set {key}, and "
                "list them as vehicles",
            )
        )
    for use, keys in (("ground", "if it isn't, name it in not_ground"), ("water", "if it isn't, set water = []")):
        if found := [piece.name for piece, role in used if role.use == use and role.by is By.SHAPE]:
            doubts.append(Doubt(DoubtKind(use), f"taken as {use}: {quoted(found)}, by shape; {keys}"))
    if wet:
        doubts.append(
            Doubt(
                DoubtKind.WATER,
                f"taken as water: the faces of {quoted(wet)} that wear water; if they are ground, set water = []",
            )
        )
    doubts += _perhaps_water(used, wet) if options.water is None else []
    for piece, role in used:
        if role.use == "obstacle" and role.by is By.SHAPE:
            doubts.append(
                Doubt(
                    DoubtKind.NOT_GROUND,
                    f"{piece.name!r} isn't used as ground, {role.why}",
                )
            )
    grounds = [piece for piece, role in used if role.use == "ground"]
    if grounds and 0 < (main := max(grounds, key=lambda p: p.area)).level < LEVEL:
        doubts.append(
            Doubt(
                DoubtKind.STEEP_GROUND,
                f"{main.name!r} is ground, and {100 * (1 - main.level):.0f} % of it is steep: if buildings are part of "
                "it, vehicles are placed on their roofs; make them objects of their own in Blender",
            )
        )
    solid = [piece for piece, role in used if role.use == "obstacle" and not piece.hair]
    for sheet, above in canopies(solid, [piece.bounds for piece in grounds]):
        name = as_key([sheet.name])
        doubts.append(
            Doubt(
                DoubtKind.SHEET_ABOVE,
                f"{sheet.name!r} is a level sheet {above:.1f} m above the ground, and nothing is placed under it; if "
                f"it's ground, set ground = {name}, if it's water, set water = {name}, else drop = {name}",
            )
        )
    if around := enclosing([piece for piece, role in used if role.use in ("obstacle", "ground")]):
        doubts.append(
            Doubt(
                DoubtKind.AROUND_ALL,
                f"{around.name!r} is around everything else and hides the HDRI; if it is a sky, set "
                f"drop = {as_key([around.name])}",
            )
        )
    *sides, height = report.size
    across = max(sides)
    if not SMALLEST_SCENERY <= across <= LARGEST_SCENERY:
        doubts.append(
            Doubt(
                DoubtKind.SCALE,
                f"the scenery is {length_said(across)} across; set scale if that is wrong (1 unit is "
                f"{report.unit:g} m)",
            )
        )
    other = "z" if report.up == "y" else "y"
    if height > across and options.up is None:
        doubts.append(
            Doubt(
                DoubtKind.UP,
                f'it is {height:.0f} m high and {across:.0f} m across; set up = "{other}" if it lies on its side',
            )
        )
    elif min(sides) < EDGE * min(across, height) and options.up is None:
        seen = " x ".join(map(length_said, sides))
        doubts.append(
            Doubt(
                DoubtKind.UP,
                f'it stands on its edge: {seen} seen from above, {length_said(height)} high; set up = "{other}"',
            )
        )
    return (*doubts, *_missing(report.missing))


def _perhaps_water(used: Sequence[tuple[Piece, PieceRole]], wet: Sequence[str]) -> list[Doubt]:
    """Return doubts about possible water: parts of the ground's mesh, and small sheets without a name."""
    ground = [piece for piece, role in used if role.use == "ground"]
    dressed = [(p.name, m) for p in ground if p.name not in wet for m in p.materials if is_water_name(m)]
    doubts = [
        Doubt(
            DoubtKind.WATER,
            f"{name!r} is ground and wears {material!r}; if a part of it is water, make that an object of its own in "
            "Blender and name it in water",
        )
        for name, material in list(dict.fromkeys(dressed))[:MOST_NAMES]
    ]
    open_ = [i for i, (_, role) in enumerate(used) if role.use == "obstacle" and role.by is By.DEFAULT]
    found = sheets_between([piece for piece, _ in used], open_, [piece.bounds for piece in ground], least=PUDDLE)
    if found:
        names = quoted([used[i][0].name for i in found])
        doubts.append(
            Doubt(
                DoubtKind.PERHAPS_WATER,
                f"perhaps water: {names}, flat sheets that ground rises above; if so, name them in water",
            )
        )
    return doubts


def _proposed_ground(among: Sequence[Piece]) -> str:
    """Return the config line that makes the widest of these pieces ground."""
    able = [piece for piece in among if not (piece.hair or piece.scattered)]
    if not able:
        return "name what is to be ground in this scenery's `ground`"
    widest = max(able, key=lambda piece: (piece.level >= LEVEL, piece.area))
    families: dict[str, list[Piece]] = {}
    for piece in able:
        families.setdefault(re.split(r"\d", piece.name, maxsplit=1)[0].rstrip("_- .") or piece.name, []).append(piece)
    stem, family = max(families.items(), key=lambda one: _level_area(one[1]))
    if len(family) > MOST_NAMES and _level_area(family) > _level_area([widest]):
        return f"if it is the {len(family)} pieces {stem}..., give this scenery ground = {as_key([stem + '*'])}"
    return f"if it is {widest.name!r}, give this scenery ground = {as_key([widest.name])}"


def _level_area(pieces: Sequence[Piece]) -> float:
    """Return square meters of pieces seen from above that are nearly level."""
    return sum(piece.level * piece.area for piece in pieces)


def _missing(missing: Sequence[Missing]) -> list[Doubt]:
    return [
        Doubt(
            DoubtKind.MISSING,
            f"{m.problem}: {m.path}, used by {quoted(m.wanted_by) if m.wanted_by else 'the file'}",
        )
        for m in missing
    ]


def likely_scale(longest: float, unit: float, usual: tuple[float, float] = LIKELY_LENGTHS) -> str:
    """Return the usual unit that makes it a vehicle of a usual length, as " = 100 (now 1)"; without, if none does."""
    middle = math.sqrt(usual[0] * usual[1])
    best = min(USUAL_UNITS, key=lambda meters: abs(math.log(max(longest, 1e-9) / unit * meters / middle)))
    return f" = {best:g} (now {unit:g})" if usual[0] <= longest / unit * best <= usual[1] else f" (now {unit:g})"


def length_said(length: float) -> str:
    """Return a length in meters as people write it: "6,000 m", "5.42 cm"."""
    if length >= 100:
        return f"{length:,.0f} m"
    return f"{length:.3g} m" if length >= 1 else f"{100 * length:.3g} cm"
