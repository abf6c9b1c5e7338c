"""Values that reveal a target's class are named, except those that chance explains."""

from collections import Counter

import numpy as np
import pytest

from hulldown.plan.summary import shortcut_notes, summarize_plan
from hulldown.tests.builders.planning_assets import plan, small_assets, small_config

ASSETS = small_assets()


def counted(values, classes):
    by_class = {}
    for value, category in zip(values, classes, strict=True):
        by_class.setdefault(str(category), Counter())[str(value)] += 1
    return {"HDRI": by_class}


@pytest.mark.parametrize("values", [2, 20, 500])
def test_chance_is_not_named(values):
    rng = np.random.default_rng(values)
    alarms = sum(len(shortcut_notes(counted(rng.integers(0, values, n), rng.integers(0, 3, n)))) for n in (10, 100, 1000) * 30)
    assert alarms == 0


def test_a_value_that_reveals_a_class_is_named():
    rng = np.random.default_rng(0)
    classes = rng.integers(0, 3, 600)
    hdris = np.where((classes == 2) & (rng.random(600) < 0.5), 9, rng.integers(0, 9, 600))
    (line,) = shortcut_notes(counted(hdris, classes))
    assert line.startswith("HDRI tells classes apart: 9 for ")
    assert " of 2 and 0% of the others" in line


def test_a_plan_has_no_shortcuts_unless_the_config_makes_one():
    budget = {"images_per_class": 150, "images_per_position": 1}
    plain = summarize_plan(plan(small_config(budget=budget), ASSETS))
    assert plain.shortcuts == ()
    paint = [{"materials": ["*"], "colors": ["#ff0000"]}]
    entries = [{"path": "vehicles/ural.blend", "category": "truck", "paint": paint}]
    summary = summarize_plan(plan(small_config(budget=budget, assets={"vehicles": entries}), ASSETS))
    (line,) = summary.shortcuts
    assert line.startswith("paint tells classes apart")
    assert line in summary.unmet_wish_notes()
