"""Masks and visible shares behind leaves cut out by a texture, compared with Cycles."""

import numpy as np
import pytest

from hulldown.render.cycles_masks import render_index_maps_of_rows, verify_masks
from hulldown.render.supervisor import render_remaining_images
from hulldown.tests.builders.blender_plans import make_plan
from hulldown.tests.oracles.rendered import assert_shows_plan

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def plan(own_worlds):
    return make_plan(
        own_worlds,
        seed=3,
        assets={"sceneries": [{"path": "wood.blend"}]},
        budget={"images_per_class": 6, "images_per_position": 1},
        camera={"target_fraction": [0.2, 0.4], "visible_fraction": [0.15, 0.9], "visibility_rays": 4096},
        render={"width": 192, "height": 108, "samples": 1, "denoise": False, "bounces": 2},
    )


def test_masks_and_visible_shares_in_a_wood_equal_those_of_cycles(plan, library, tmp_path):
    assert render_remaining_images(plan.path, tmp_path / "dataset", library=library).complete
    assert_shows_plan(tmp_path / "dataset", plan, library)
    report = verify_masks(tmp_path / "dataset", plan.path, count=len(plan), library=library)
    assert not [finding for finding in report.findings if finding.severity == "error"]
    assert min(row.mask_iou for row in report.rows) >= 0.99
    planned = np.array([row.target.visible_fraction for row in plan])
    found = render_index_maps_of_rows(plan, range(len(plan)), library)
    shown = np.array([(maps[0] == 1).sum() / (maps[1] == 1).sum() for maps in found])
    assert planned.min() < 0.7, "leaves hide something"
    # Each random point of the outline is hidden or not: with 4,096 rays, 99 of 100 shares are within 0.02.
    assert np.abs(planned - shown).max() <= 0.03
