"""Whether a plan is what its config and assets give, and whether its labels are those of its poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any

import msgspec
import orjson

from hulldown.assets.library import Assets
from hulldown.geometry.errors import ConfigError
from hulldown.planning.plan_file import Plan
from hulldown.planning.planner import BLOCK, Planner
from hulldown.planning.relabel import relabeled
from hulldown.planning.row import PlannedVehicle, Row, encode, fields

ROUNDING = 1e-6  # largest difference of a number from another processor's: meters, degrees, pixels, shares
MOST = 1000  # findings that are listed
LONGEST = 80  # characters of a value in a finding


def check_plan(plan: Plan, assets: Assets, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Where a plan differs from the plan that its config gives, and labels from those of its poses.

    Parameters
    ----------
    plan
        The plan.
    assets
        The assets it was made from.
    progress
        Called with the number of images checked and of all images.

    Returns
    -------
    One line for each finding; nothing if all is well.

    Raises
    ------
    ConfigError
        If a line of the plan is damaged, or its config can't be met.
    """
    planner = Planner(plan.config, assets, more_of=plan.header.more_of, poses=plan.header.poses)
    followed, known = plan.header.photographs, planner.assets.photographs
    if followed is not None and (known is None or known.sha256 != followed.sha256):
        raise ConfigError(
            f"the boxes of camera.like ({followed.path}) aren't what they were when this was planned",
            path=plan.path,
            remedy="plan again with `hulldown plan`, or bring the old file back",
        )
    return check_rows(plan, planner, progress=progress)


def check_rows(plan: Plan, planner: Planner, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """`check_plan` with the planner of the plan's config, which several plans may share."""
    budget, findings, hidden = planner.budget, [], 0
    if len(plan) != budget.n_images:
        findings.append(f"{len(plan)} images, the budget is {budget.n_images}")
    if list(plan.header.left_out) != list(planner.pairs.left_out):
        findings.append("the header's left_out differs from what its config gives")
    rows, start, done = iter(plan), 0, 0
    while found := list(islice(rows, 1)):
        stop = min(start + BLOCK, budget.n_positions)
        wanted = planner.rows(start, stop) if start < stop else []
        found += islice(rows, max(len(wanted), 1) - 1)
        for row, planned in zip(found, wanted, strict=False):
            if encode(row) != encode(planned):
                lines = list(_findings(row, planned, planner)) if len(findings) < MOST else [""]
                hidden += max(len(findings) + len(lines) - MOST, 0)
                findings += lines[: MOST - len(findings)]
        start, done = stop, done + len(found)
        if progress:
            progress(done, len(plan))
    return findings + ([f"and {hidden:,} more"] if hidden else [])


def _findings(row: Row, planned: Row, planner: Planner) -> Iterator[str]:
    """What is wrong with a row that isn't the planned one."""
    own = relabeled(row, planner.config, planner.stage)
    inconsistent = dict(_differences(row, own)) if own else {}
    for key, (value, wanted) in inconsistent.items():
        yield f"image {row.index}: {key} is {value}, its poses give {wanted}"
    for key, (value, wanted) in _differences(row, planned):
        if key not in inconsistent:
            yield f"image {row.index}: {key} is {value}, planned is {wanted}"


def _differences(row: Row, other: Row) -> Iterator[tuple[str, tuple[str, str]]]:
    """The fields of a row and of its vehicles that differ, with both values as the file has them."""
    one, two = (orjson.loads(encode(each)) for each in (row, other))
    guests = ("companions", "distractors")
    yield from _differing(one, two, [key for key in fields(Row) if key not in guests])
    for kind in guests:
        if len(one[kind]) != len(two[kind]):
            yield f"number of {kind}", (str(len(one[kind])), str(len(two[kind])))
        for k, pair in enumerate(zip(one[kind], two[kind], strict=False)):
            yield from _differing(*pair, fields(PlannedVehicle), f"{kind}[{k}].")


def _differing(
    one: Mapping[str, Any], two: Mapping[str, Any], keys: Any, place: str = ""
) -> Iterator[tuple[str, tuple[str, str]]]:
    for key in keys:
        pair = one.get(key), two.get(key)  # some fields aren't written where they are null
        if not _alike(*pair):
            yield place + key, (_shown(pair[0]), _shown(pair[1]))


def _alike(one: Any, two: Any) -> bool:
    """Whether two JSON values are the same up to rounding."""
    if isinstance(one, float) and isinstance(two, float):
        return math.isclose(one, two, rel_tol=0.0, abs_tol=ROUNDING)
    if isinstance(one, list) and isinstance(two, list):
        return len(one) == len(two) and all(map(_alike, one, two))
    if isinstance(one, dict) and isinstance(two, dict):
        return one.keys() == two.keys() and all(_alike(one[key], two[key]) for key in one)
    return bool(one == two)


def _shown(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= LONGEST else text[:LONGEST] + "..."
