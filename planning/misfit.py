"""What is wrong with a line of a plan, in words: a plan is text that people edit."""

from __future__ import annotations

import re

import msgspec
from msgspec import Struct

from hulldown.planning.row import PlannedVehicle, fields

_PLACE = re.compile(
    r"`(?:key in )?\$\.?(?P<path>(?:(?P<list>companions|distractors)\[(?P<at>\d+)\]\.?)?(?P<key>\w*))[^`]*`$"
)


def misfit(line: bytes, kind: type[Struct], error: Exception) -> str:
    """Why a line of JSON is no record of its kind, as the end of a sentence that begins with the line.

    Parameters
    ----------
    line
        What could not be decoded.
    kind
        `Row` or `Header`.
    error
        What the decoder said.
    """
    try:
        record = msgspec.json.decode(line)
    except (msgspec.DecodeError, ValueError, RecursionError) as mistake:
        return f"is no JSON ({mistake})"
    if not isinstance(record, dict):
        return f"is {type(record).__name__}, not an image"
    if lacking := _lacking(record, kind):
        return f"lacks {', '.join(lacking[:3])}"
    found = _PLACE.search(str(error))
    assert found is not None, error
    path, key, known, value = found["path"], found["key"], fields(kind), record
    if found["at"] is not None:
        beside = record[found["list"]][int(found["at"])]
        if isinstance(beside, dict):
            if lacking := _lacking(beside, PlannedVehicle):
                return f"lacks {path.rstrip('.').partition('.')[0]}.{lacking[0]}"
            known, value = fields(PlannedVehicle), beside
        else:
            path = key = found["list"]
    return f"has {path.rstrip('.')} {value[key]!r:.60}, expected {known[key].expected}"


def _lacking(record: dict[str, object], kind: type[Struct]) -> list[str]:
    return [name for name, field in fields(kind).items() if name not in record and not field.optional]
