"""Error messages for damaged lines of a plan."""

from __future__ import annotations

import re

import msgspec
from msgspec import Struct

from hulldown.planning.plan.row import PlannedVehicle, fields

_PLACE = re.compile(r"`(?:key in )?\$\.?(?P<path>(?:(?P<list>planned)\[(?P<at>\d+)\]\.?)?(?P<key>\w*))[^`]*`$")


def misfit(line: bytes, kind: type[Struct], error: Exception) -> str:
    """Explain why a line isn't a record of its kind, `Row` or `Header`, as the end of a sentence about the line."""
    try:
        record = msgspec.json.decode(line)
    except (msgspec.DecodeError, ValueError, RecursionError) as mistake:
        return f"is no JSON ({mistake})"
    if not isinstance(record, dict):
        return f"is {type(record).__name__}, not an image"
    if lacking := _lacking(record, kind):
        return f"lacks {', '.join(lacking[:3])}"
    place = _PLACE.search(str(error))
    assert place is not None, error
    path, key, declared, value = place["path"], place["key"], fields(kind), record
    if place["at"] is not None:
        extra = record[place["list"]][int(place["at"])]
        if isinstance(extra, dict):
            if lacking := _lacking(extra, PlannedVehicle):
                return f"lacks {path.rstrip('.').partition('.')[0]}.{lacking[0]}"
            declared, value = fields(PlannedVehicle), extra
        else:
            path = key = place["list"]
    return f"has {path.rstrip('.')} {value[key]!r:.60}, expected {declared[key].expected}"


def _lacking(record: dict[str, object], kind: type[Struct]) -> list[str]:
    return [name for name, field in fields(kind).items() if name not in record and not field.optional]
