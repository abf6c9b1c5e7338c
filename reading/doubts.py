"""Sentences for a person: what in a file looks as if it were not meant so."""

from __future__ import annotations

import math
from collections.abc import Sequence

from reading.build import Options
from reading.report import Missing, Row

LONGEST_VEHICLE = 60.0  # metres; the longest road trains
SHORTEST_VEHICLE = 0.8
SMALLEST_SCENERY = 20.0
LARGEST_SCENERY = 200_000.0
USUAL_LENGTH = 7.0
USUAL_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.3048, 100.0, 10.0, 0.1)
NAMES = 12  # how many names a sentence lists


def vehicle_doubts(
    size: tuple[float, float, float],
    rows: Sequence[Row],
    missing: Sequence[Missing],
    *,
    unit: float,
    options: Options,
) -> tuple[str, ...]:
    """What is strange about a vehicle's size, and about what is dropped of it."""
    doubts = []
    length, width, height = size
    longest = max(size)
    if not SHORTEST_VEHICLE <= longest <= LONGEST_VEHICLE:
        hint = _likely_scale(longest, unit)
        doubts.append(f"the vehicle is {_metres(longest)} long; set scale{hint} if that is wrong")
    if width > 1.2 * length and height <= width:
        doubts.append(f"it is longer across ({width:.1f} m) than along x ({length:.1f} m); set forward to +y or -y")
    elif height > 1.5 * max(length, width) and options.up is None:
        doubts.append(
            f'it is {height:.1f} m high and {max(length, width):.1f} m long; set up = "y" if it lies on its side'
        )
    dropped = [row for row in rows if row.use == "dropped" and row.triangles and "config" not in row.why]
    kept = sum(row.triangles * row.count for row in rows if row.use != "dropped")
    if sum(row.triangles * row.count for row in dropped) > kept:
        those = _names([row.name for row in dropped])
        doubts.append(f"more triangles are dropped than kept; `keep` what of it is the vehicle: {those}")
    return (*doubts, *_missing(missing))


def scenery_doubts(
    size: tuple[float, float, float], rows: Sequence[Row], missing: Sequence[Missing], *, unit: float, options: Options
) -> tuple[str, ...]:
    """What is strange about a scenery; that it has no ground first."""
    doubts = []
    if not any(row.use == "ground" for row in rows):
        there = _names([row.name for row in rows if row.triangles])
        doubts.append(
            f"NO GROUND: no object, mesh or collection has a name for ground, so vehicles stand on the plane "
            f"z = ground.fallback_z; name the ground in ground.include; in the file is {there}"
        )
    across, height = max(size[:2]), size[2]
    if not SMALLEST_SCENERY <= across <= LARGEST_SCENERY:
        doubts.append(f"the scenery is {_metres(across)} across; set scale if that is wrong (1 unit is {unit:g} m)")
    if height > across and options.up is None:
        doubts.append(f'it is {height:.0f} m high and {across:.0f} m across; set up = "y" if it lies on its side')
    return (*doubts, *_missing(missing))


def _missing(missing: Sequence[Missing]) -> list[str]:
    return [f"missing: {m.path}, used by {_names(list(m.wanted_by)) if m.wanted_by else 'the file'}" for m in missing]


def _names(names: Sequence[str]) -> str:
    unique = list(dict.fromkeys(names))
    more = f" and {len(unique) - NAMES} more" if len(unique) > NAMES else ""
    return ", ".join(repr(n) for n in unique[:NAMES]) + more if unique else "nothing"


def _likely_scale(longest: float, unit: float) -> str:
    """The usual unit that would make the likeliest vehicle of it."""
    usual = min(USUAL_UNITS, key=lambda metres: abs(math.log(max(longest, 1e-9) / unit * metres / USUAL_LENGTH)))
    return f" = {usual:g} (now {unit:g})" if 2.0 <= longest / unit * usual <= 20.0 else f" (now {unit:g})"


def _metres(length: float) -> str:
    if length >= 100:
        return f"{length:,.0f} m"
    return f"{length:.3g} m" if length >= 1 else f"{100 * length:.3g} cm"
