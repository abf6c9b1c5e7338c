"""Images without targets, and distractors: budgets, draws, labels, and planning."""

from collections import Counter

import numpy as np
import pytest

from hulldown.plan.config.scene_sections import PlacementSection
from hulldown.plan.row import encode_rows
from hulldown.planning.planner import Planner
from hulldown.planning.search.placing import extra_offsets
from hulldown.planning.search.tables import InstanceRole
from hulldown.tests.builders.planning_assets import DISTRACTOR_ENTRIES, plan, small_assets, small_config

ASSETS = small_assets(distractors=True)


def config_of(**sections):
    sections["assets"] = {"distractors": DISTRACTOR_ENTRIES, **sections.get("assets", {})}
    budget = {"images_per_class": 6, "background_share": 0.25, "images_per_position": 2}
    sections["budget"] = {**budget, **sections.get("budget", {})}
    return small_config(**sections)


@pytest.fixture(scope="module")
def rows():
    return list(plan(config_of(placement={"vehicles_per_image": [1, 3]}, seed=5), ASSETS))


def test_rows_without_backgrounds_and_distractors_are_unchanged():
    plain = Planner(small_config(), small_assets())
    none = {"distractors_per_image": 0}
    listed = Planner(small_config(assets={"distractors": DISTRACTOR_ENTRIES}, placement=none), ASSETS)
    assert encode_rows(listed.rows(0, 4)) == encode_rows(plain.rows(0, 4))


def test_backgrounds_are_counted_exactly_in_addition_to_classes(rows):
    assert Counter(row.target.category for row in rows if not row.background) == {"tank": 6, "truck": 6}
    backgrounds = [row for row in rows if row.background]
    assert len(backgrounds) == 4
    assert Counter(row.hides_target for row in backgrounds) == {True: 2, False: 2}
    for row in backgrounds:
        assert row.labeled == []
        assert row.companions == []
        assert {distractor.category for distractor in row.distractors} <= {None}
        assert (row.target in row.vehicles) == (row.target.category is None)


def test_distractors_are_labeled_only_if_they_have_a_class(rows):
    seen = Counter()
    for row in rows:
        for distractor in row.distractors:
            seen[distractor.vehicle] += 1
            assert distractor.category == {"bus": "bus"}.get(distractor.vehicle)
            if distractor.category is None:
                assert distractor.label == "none"
            if distractor.vehicle == "bales":
                assert row.scenery == "hills"
    assert set(seen) == {"car", "bales", "bus"}
    assert seen["car"] > seen["bus"]


def test_distractors_are_uniform_over_the_disk():
    """The squared distance is uniform."""
    shares, bearings = (np.arange(1000) + 0.5) / 1000, np.linspace(0.0, 1.0, 1000)
    limits = PlacementSection(distractor_distance=(10.0, 40.0))
    away = np.linalg.norm(
        extra_offsets(np.full(1000, InstanceRole.DISTRACTOR), limits, np.stack([shares, bearings], 1)), axis=1
    )
    shares = np.histogram(away**2, bins=10, range=(100.0, 1600.0))[0]
    assert shares.tolist() == [100] * 10
