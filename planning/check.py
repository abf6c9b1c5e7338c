"""Compare a plan with a new plan of its config and assets, and its labels with its poses."""

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

ROUNDING = 1e-6  # tolerance of numbers from other processors: meters, degrees, pixels, shares
MOST = 1000  # listed findings
LONGEST = 80  # characters of a value in a finding


def check_plan(plan: Plan, assets: Assets, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Return a line for each difference of a plan from a new plan of its config, and of labels from poses.

    Parameters
    ----------
    plan, assets
        The plan, and the assets that it was made from.
    progress
        Called with the numbers of images checked so far and of all images.

    Raises
    ------
    ConfigError
        If a line of the plan is damaged, or no pose meets its config's limits.
    """
    planner = Planner(plan.config, assets, more_of=plan.header.more_of, poses=plan.header.poses)
    followed, photographs = plan.header.photographs, planner.assets.photographs
    if followed is not None and (photographs is None or photographs.sha256 != followed.sha256):
        raise ConfigError(
            f"the boxes of camera.like ({followed.path}) aren't what they were when this was planned",
            path=plan.path,
            remedy="plan again with `hulldown plan`, or bring the old file back",
        )
    return check_rows(plan, planner, progress=progress)


def check_rows(plan: Plan, planner: Planner, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """`check_plan` with the planner of the plan's config, which plans can share."""
    budget, findings, hidden = planner.budget, [], 0
    if len(plan) != budget.n_images:
        findings.append(f"{len(plan)} images, the budget is {budget.n_images}")
    if list(plan.header.left_out) != list(planner.pairs.left_out):
        findings.append("the header's left_out differs from what its config gives")
    rows, start, done = iter(plan), 0, 0
    while block := list(islice(rows, 1)):
        stop = min(start + BLOCK, budget.n_positions)
        wanted = planner.rows(start, stop) if start < stop else []
        block += islice(rows, max(len(wanted), 1) - 1)
        for row, planned in zip(block, wanted, strict=False):
            if encode(row) != encode(planned):
                lines = list(_findings(row, planned, planner)) if len(findings) < MOST else [""]
                hidden += max(len(findings) + len(lines) - MOST, 0)
                findings += lines[: MOST - len(findings)]
        start, done = stop, done + len(block)
        if progress:
            progress(done, len(plan))
    return findings + ([f"and {hidden:,} more"] if hidden else [])


def _findings(row: Row, planned: Row, planner: Planner) -> Iterator[str]:
    """Yield the differences of a row from the planned one."""
    new = relabeled(row, planner.config, planner.stage)
    inconsistent = dict(_differences(row, new)) if new else {}
    for key, (value, wanted) in inconsistent.items():
        yield f"image {row.index}: {key} is {value}, its poses give {wanted}"
    for key, (value, wanted) in _differences(row, planned):
        if key not in inconsistent:
            yield f"image {row.index}: {key} is {value}, planned is {wanted}"


def _differences(row: Row, planned: Row) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the fields of a row and of its vehicles that differ, with both values as in a file."""
    first, second = (orjson.loads(encode(each)) for each in (row, planned))
    extras = ("companions", "distractors")
    yield from _differing(first, second, [key for key in fields(Row) if key not in extras])
    for kind in extras:
        if len(first[kind]) != len(second[kind]):
            yield f"number of {kind}", (str(len(first[kind])), str(len(second[kind])))
        for k, pair in enumerate(zip(first[kind], second[kind], strict=False)):
            yield from _differing(*pair, fields(PlannedVehicle), f"{kind}[{k}].")


def _differing(
    first: Mapping[str, Any], second: Mapping[str, Any], keys: Any, place: str = ""
) -> Iterator[tuple[str, tuple[str, str]]]:
    for key in keys:
        pair = first.get(key), second.get(key)  # lines leave out some fields that are null
        if not _alike(*pair):
            yield place + key, (_shown(pair[0]), _shown(pair[1]))


def _alike(first: Any, second: Any) -> bool:
    """Whether two JSON values are equal up to rounding."""
    if isinstance(first, float) and isinstance(second, float):
        return math.isclose(first, second, rel_tol=0.0, abs_tol=ROUNDING)
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_alike, first, second))
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(_alike(first[key], second[key]) for key in first)
    return bool(first == second)


def _shown(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= LONGEST else text[:LONGEST] + "..."
