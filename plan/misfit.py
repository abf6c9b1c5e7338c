"""Error messages for damaged lines of a plan."""

from __future__ import annotations

from typing import Any, get_type_hints

import msgspec
from msgspec import Struct

from hulldown.base.outside import convert_value
from hulldown.plan.row import PlannedVehicle, decoded_pose, row_fields


def explain_damage(line: bytes, kind: type[Struct], error: Exception) -> str:
    """Explain why a line isn't a record of its kind, `Row` or `Header`, as the end of a sentence about the line."""
    try:
        record = msgspec.json.decode(line)
    except (msgspec.DecodeError, ValueError, RecursionError) as mistake:
        return f"is no JSON ({mistake})"
    if not isinstance(record, dict):
        return f"is {type(record).__name__}, not an image"
    return _first_problem(record, kind, "") or f"can't be used ({error})"


def _first_problem(record: dict[str, object], kind: type[Struct], path: str) -> str | None:
    """Return the first missing or wrong field of a record at a path; None if there is none."""
    declared, hints = row_fields(kind), get_type_hints(kind, include_extras=True)
    lacking = [name for name, field in declared.items() if name not in record and not field.optional]
    if lacking:
        return f"lacks {', '.join(path + name for name in (lacking[:1] if path else lacking[:3]))}"
    for key, field in declared.items():
        if key not in record or _is_kind(value := record[key], hints[key]):
            continue
        within = value if key == "planned" and isinstance(value, list) else []
        inner = (
            _first_problem(each, PlannedVehicle, f"{key}[{i}].")
            for i, each in enumerate(within)
            if _is_kind(each, dict)
        )
        return next(filter(None, inner), None) or f"has {path}{key} {value!r:.60}, expected {field.expected}"
    return None


def _is_kind(value: object, kind: Any) -> bool:
    """Return whether a value of JSON has a declared type and range."""
    try:
        convert_value(value, kind, dec_hook=decoded_pose)
    except (msgspec.ValidationError, ValueError, OverflowError, SystemError):  # the last two: of integers without end
        return False
    return True
