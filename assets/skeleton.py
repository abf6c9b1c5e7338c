"""The list of a dataset's keypoints, and the skeleton that connects them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import ConfigError

MUZZLE, TURRET = "muzzle", "turret"
WHEELS = ("wheel_front_left", "wheel_front_right", "wheel_rear_right", "wheel_rear_left")
DEFAULTS = (MUZZLE, TURRET, *WHEELS)
SKELETON = ((MUZZLE, TURRET), *zip(WHEELS, (*WHEELS[1:], WHEELS[0]), strict=True))


def category_fields(
    shapes: Iterable[VehicleShape],
    patterns: Sequence[str] | None,
    lines: Sequence[tuple[str, str]] | None,
    *,
    path: Path,
) -> dict[str, object]:
    """Return COCO's `keypoints` and `skeleton`, the same for all categories, so an image's labels are one array.

    `patterns`: the config's `annotate.keypoints`; None: no keypoints, and an empty result.
    `lines`: the config's `annotate.skeleton`; None: between the default keypoints.
    """
    if patterns is None:
        return {}
    there = dict.fromkeys(name for shape in shapes for name in shape.keypoint_names)
    ordered = [*(name for name in DEFAULTS if name in there), *(name for name in there if name not in DEFAULTS)]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in ordered):
            known = ", ".join(map(repr, ordered)) or "none"
            problem = f"annotate.keypoints: {pattern!r} matches no keypoint of a vehicle"
            raise ConfigError(problem, path=path, remedy=f"there are: {known}")
    names = [name for name in ordered if any(fnmatchcase(name, pattern) for pattern in patterns)]
    place = {name: i for i, name in enumerate(names, start=1)}
    if lines is None:
        lines = [line for line in SKELETON if place.keys() >= set(line)]
    for name in (name for line in lines for name in line if name not in place):
        problem = f"annotate.skeleton: {name!r} is no keypoint"
        raise ConfigError(problem, path=path, remedy=f"these are: {', '.join(map(repr, names))}")
    return {"keypoints": names, "skeleton": [[place[a], place[b]] for a, b in lines]}
