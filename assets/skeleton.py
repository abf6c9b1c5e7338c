"""The list of a dataset's keypoints, and the skeleton that connects them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import ConfigError


def category_fields(
    shapes: Iterable[VehicleShape],
    patterns: Sequence[str] | None,
    lines: Sequence[tuple[str, str]] | None,
    *,
    path: Path,
) -> dict[str, object]:
    """Return COCO's `keypoints` and `skeleton`, the same for all categories, so an image's labels are one array.

    `patterns`: the config's `annotate.keypoints`; None: no keypoints, and an empty result.
    `lines`: the config's `annotate.skeleton`; None: none.
    """
    if patterns is None:
        return {}
    there = list(dict.fromkeys(name for shape in shapes for name in shape.keypoint_names))
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in there):
            known = ", ".join(map(repr, there)) or "none"
            problem = f"annotate.keypoints: {pattern!r} matches no keypoint of a vehicle"
            raise ConfigError(problem, path=path, remedy=f"there are: {known}; give them in `keypoints` of a vehicle")
    lines = lines or ()
    names = [name for name in there if any(fnmatchcase(name, pattern) for pattern in patterns)]
    place = {name: i for i, name in enumerate(names, start=1)}
    for name in (name for line in lines for name in line if name not in place):
        problem = f"annotate.skeleton: {name!r} is no keypoint"
        raise ConfigError(problem, path=path, remedy=f"these are: {', '.join(map(repr, names))}")
    return {"keypoints": names, "skeleton": [[place[a], place[b]] for a, b in lines]}
