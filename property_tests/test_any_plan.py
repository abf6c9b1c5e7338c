"""Reading, checking, drawing, and rendering any edited plan gives at most one line of error."""

from __future__ import annotations

import copy
import json
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hulldown.base.errors import ConfigError
from hulldown.dataset.store.reservations import plan_file_key
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_planned_library, refuse_changed_assets
from hulldown.plan.pictures.preview import Artist
from hulldown.plan.plan_file import Plan, read_plan
from hulldown.plan.row import Row
from hulldown.plan.summary import summarize_plan
from hulldown.planning.check import find_plan_row_problems
from hulldown.planning.planner import Planner
from hulldown.planning.write import write_plan
from hulldown.property_tests.any_values import MANY, containers, refusal, values_of
from hulldown.render.blender.messages import CyclesSettings
from hulldown.render.jobs import make_mask_job, make_render_job
from hulldown.render.outline import Outline
from hulldown.tests.builders.planning_assets import hills, small_assets, small_config
from hulldown.tests.builders.render_plans import library_of

ASSETS = small_assets(hills("hills", cells=6, size=120.0, trees=2), vehicles=["t72"], distractors=True)
ASSETS = replace(ASSETS, distractors={"car": ASSETS.distractors["car"]})
NAMES = {"t72", "car", "hills"}


def config(*, images: int = 1, vehicles: int = 1, distractors: int = 0, background_share: float = 0.0) -> Config:
    """A config for a plan of a few rows, since each plan is made again."""
    return small_config(
        assets={
            "vehicles": [{"path": "t72.blend", "category": "tank"}],
            "distractors": [{"path": "car.blend"}],
            "sceneries": [{"path": "hills.blend"}],
        },
        budget={
            "images_per_class": images,
            "images_per_position": 2,
            "background_share": background_share,
            "background_distractors": 1.0,
        },
        placement={"vehicles_per_image": vehicles, "companion_distance": [9, 30], "distractors_per_image": distractors},
        camera={"visibility_rays": 4},
        weather={"fog": 0.5},
    )


# Two images of a position, a companion, a distractor, and a background.
CONFIGS = [config(images=2), config(vehicles=2), config(distractors=1), config(background_share=0.5)]
LIBRARY = library_of(ASSETS)
SETTINGS = CyclesSettings(samples=1, denoise=False, adaptive_threshold=0.0, bounces=0)
values = st.integers() | values_of(
    *(179.9999, 180, 2**53 + 2, 2**63, 10**400, -1e300, 5e-324, 1e9, [0, 0, 0, 0], [[1e308] * 4] * 4),
    np.eye(4).tolist(),
    *({"turret": 1e308}, {"visibility_m": 0}, {"visibility_m": 1e-300}, "hills", "bare", "leo", "t72", "gun", "noon"),
)
KEYS = ("left_out", "rejected", "planned", "vehicle", "bbox", "images", "config", "seed", "sceneries", "gun", "x")
change = st.tuples(
    *(st.integers(0, 4), st.integers(0, 2**16), st.integers(0, 2**16)),
    *(st.sampled_from(KEYS), values, st.sampled_from(["set", "set", "drop", "put", "scale"])),
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> list[list[bytes]]:
    """Lines of valid plans."""
    folder = tmp_path_factory.mktemp("sound")
    paths = [write_plan(made, ASSETS, folder / f"{i}.jsonl").path for i, made in enumerate(CONFIGS)]
    return [path.read_bytes().splitlines() for path in paths]


@lru_cache(maxsize=8)
def planner_of(header: str) -> Planner | None:
    """The library for checking a plan with this config, None if it names other assets.

    It's built once for an unchanged config.
    """
    config = Config.of(json.loads(header), path=Path("plan.jsonl"))
    return Planner(config, ASSETS) if {entry.name for entry in config.assets.entries} == NAMES else None


def change_line(line: dict[str, Any], at: int, which: int, key: str, new: Any, how: str) -> None:
    """Replace a value, key, or scale somewhere in a line."""
    place = (found := [each for each in containers(line) if each] or [line])[at % len(found)]
    keys = list(place) if isinstance(place, dict) else list(range(len(place)))
    one = keys[which % len(keys)] if keys else key
    if how == "put" and isinstance(place, dict):
        one = key
    if how == "drop" and keys:
        del place[one]
    elif how == "scale" and keys and isinstance(place[one], float):
        place[one] *= 1.0 + 1e-6 * which
    elif keys or isinstance(place, dict):
        place[one] = copy.deepcopy(new)  # later changes must not reach `new`


def job_of(row: Row, plan: Path) -> None:
    """Make a row's job for a worker, which refuses rows like `hulldown render`."""
    try:
        make_render_job(row, LIBRARY, SETTINGS, plan.parent / "1.png")
        make_mask_job(row, LIBRARY, plan.parent / "1.png")
    except ValueError as error:
        raise ConfigError(str(error), path=plan) from error


def used(path: Path) -> None:
    """Use a plan in every way except rendering it."""
    plans: list[Plan] = []
    messages = [refusal(lambda: plans.append(read_plan(path)))]
    for plan in plans:
        rows: list[Row] = []
        messages += [
            refusal(rows.extend, plan),
            refusal(load_planned_library, plan),
            refusal(refuse_changed_assets, plan, ASSETS),
            refusal(check, plan),
            refusal(summarize_plan, plan),
            refusal(Outline, plan),
            refusal(plan_file_key, path),
            *(refusal(job_of, row, path) for row in rows),
            *(refusal(draw, plan, row) for row in rows[:1]),
        ]
    assert all("\n" not in line and len(line) < 5000 for line in messages)


def check(plan: Plan) -> None:
    """Check a plan, unless it names other assets."""
    if planner := planner_of(json.dumps(plan.header.config)):
        find_plan_row_problems(plan, planner)


def draw(plan: Plan, row: Row) -> None:
    """Draw a preview, unless the plan names other assets."""
    if planner_of(json.dumps(plan.header.config)):
        Artist(plan, ASSETS).picture(row, width=8)


plans = st.integers(0, len(CONFIGS) - 1)


@MANY
@given(plans, st.lists(change, min_size=1, max_size=3))
def test_any_edited_plan_is_accepted_or_refused(sound: list[list[bytes]], which: int, changes: list) -> None:
    lines = [json.loads(line) for line in sound[which]]
    for number, *what in changes:
        change_line(lines[number % len(lines)], *what)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
        used(path)


@MANY
@given(plans, st.binary(max_size=80), st.integers(0, 2), st.booleans())
def test_any_bytes_in_a_plan_are_refused_in_one_line(
    sound: list[list[bytes]], which: int, content: bytes, number: int, alone: bool
) -> None:
    lines = sound[which]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.jsonl"
        path.write_bytes(content if alone else b"\n".join([*lines[:number], content, *lines[number + 1 :]]) + b"\n")
        used(path)
