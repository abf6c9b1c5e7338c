"""Whether a row read from a plan holds numbers where numbers belong: a plan is text that people edit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any


def _number(value: Any) -> bool:
    # By type, since True is an int too; what was read from JSON is finite.
    return type(value) is float or type(value) is int


def _whole(value: Any) -> bool:
    return type(value) is int


def _counts(value: Any) -> bool:
    return type(value) is int and value >= 0


def _pixels(value: Any) -> bool:
    return type(value) is int and value >= 1


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _numbers(value: Any) -> bool:
    # A sum refuses what is no number, quicker than a look at each.
    try:
        sum(value)
    except TypeError:
        return False
    return True


def _pose(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 4
        and [type(row) for row in value] == _FOUR_LISTS
        and [len(row) for row in value] == _FOURS
        and _numbers(chain(*value))
    )


_FOUR_LISTS, _FOURS = [list] * 4, [4] * 4


def _box(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 4 and _numbers(value)


def _box_or_none(value: Any) -> bool:
    return value is None or _box(value)


def _angles(value: Any) -> bool:
    return isinstance(value, dict) and _numbers(value.values())


def _weather(value: Any) -> bool:
    return value is None or (isinstance(value, dict) and _number(value.get("visibility_m")))


Kind = tuple[str, Callable[[Any], bool]]
_A_NUMBER: Kind = ("a number", _number)
_A_COUNT: Kind = ("a whole number of at least 0", _counts)
_A_SIZE: Kind = ("a whole number of at least 1", _pixels)
_A_NAME: Kind = ("a name", _text)
_A_POSE: Kind = ("a 4x4 matrix", _pose)
_A_BOX: Kind = ("[x, y, width, height]", _box)
_A_BOX_OR_NONE: Kind = ("[x, y, width, height] or null", _box_or_none)

_TARGET: dict[str, Kind] = {
    "vehicle": _A_NAME,
    "category": _A_NAME,
    "world_from_vehicle": _A_POSE,
    "articulation": ("angles by name", _angles),
    "bbox": _A_BOX,
    "bbox_amodal": _A_BOX_OR_NONE,
    "visible_fraction": _A_NUMBER,
    "truncated_fraction": _A_NUMBER,
    "slope_deg": _A_NUMBER,
    "gap": _A_NUMBER,
    "penetration": _A_NUMBER,
    "tries": _A_COUNT,
}
_COMPANION = {**_TARGET, "bbox": _A_BOX_OR_NONE}
_ROW: dict[str, Kind] = {
    "index": _A_COUNT,
    "image_id": _A_SIZE,
    "file_name": _A_NAME,
    "scenery": _A_NAME,
    "position": _A_COUNT,
    "shot": _A_COUNT,
    "world_from_camera": _A_POSE,
    "fov_x_deg": _A_NUMBER,
    "width": _A_SIZE,
    "height": _A_SIZE,
    "hdri": _A_NAME,
    "hdri_yaw_deg": _A_NUMBER,
    "strength": _A_NUMBER,
    "weather": ('null or {"visibility_m": metres}', _weather),
    "sample_seed": ("a whole number", _whole),
    **_TARGET,
    "rejected": ("counts by reason", _angles),
}


def misfit(row: Mapping[str, Any]) -> str | None:
    """What a row holds that is of the wrong kind, in words; None if nothing is.

    Parameters
    ----------
    row
        An image of a plan that has all its keys.
    """
    if wrong := _first_misfit(row, _ROW, ""):
        return wrong
    companions = row["companions"]
    if not isinstance(companions, list) or not all(isinstance(one, dict) for one in companions):
        return "has companions that are no list of vehicles"
    for k, companion in enumerate(companions):
        if wrong := _first_misfit(companion, _COMPANION, f"companions[{k}]."):
            return wrong
    return None


def _first_misfit(record: Mapping[str, Any], kinds: Mapping[str, Kind], where: str) -> str | None:
    for key, (expected, fits) in kinds.items():
        try:
            value = record[key]
        except KeyError:
            return f"lacks {where}{key}"
        if not fits(value):
            return f"has {where}{key} {value!r:.60}, expected {expected}"
    return None
