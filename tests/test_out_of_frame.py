"""A companion outside the frame has no box: every reader of a plan accepts it, and it isn't labeled."""

import pytest

from hulldown.planning.preview import Artist
from hulldown.planning.summary import summarize
from hulldown.planning.write import write_plan
from hulldown.render.annotations import Segmenter, annotation_records
from hulldown.tests.planning_assets import small_assets, small_config


@pytest.fixture(scope="module")
def assets():
    return small_assets()


@pytest.fixture(scope="module")
def plan(assets, tmp_path_factory):
    config = small_config(
        budget={"images_per_class": 4}, placement={"vehicles_per_image": 2, "companion_distance": [30, 40]}
    )
    return write_plan(config, assets, tmp_path_factory.mktemp("out_of_frame") / "plan.jsonl")


@pytest.fixture(scope="module")
def outside(plan):
    rows = [row for row in plan if row.companions[0].bbox is None]
    assert rows
    return rows


def test_its_numbers_are_null(outside):
    for row in outside:
        (companion,) = row.companions
        assert (companion.visible_fraction, companion.truncated_fraction) == (0.0, 1.0)


def test_it_is_not_labeled(outside, assets):
    segmenter = Segmenter(assets.vehicles, assets.sceneries)
    for row in outside:
        assert row.labeled == [row.target]
        (record,) = annotation_records(row, segmenter.segmentations(row))
        assert record["bbox"] == list(row.target.bbox)


def test_it_is_counted_and_previewed(plan, outside, assets):
    assert sum(summarize(plan).counts["companions"].values()) == len(plan)
    assert Artist(plan, assets).picture(outside[0], width=64).width == 64
