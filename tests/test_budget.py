"""Budgets: the position of an image, and errors of impossible budgets."""

import numpy as np
import pytest

from hulldown.geometry.errors import ConfigError
from hulldown.planning.config.schema import BudgetSection
from hulldown.planning.search.budget import make_budget

CATEGORIES = {"t72": "tank", "leo": "tank", "ural": "truck", "m1": "tank", "s300": "sam", "man": "truck"}


def test_position_of_an_image():
    budget = make_budget(BudgetSection(images_per_class=13, images_per_position=4), CATEGORIES)
    p = budget.positions(np.arange(budget.n_positions))
    expected = np.repeat(np.arange(budget.n_positions), p.shots)
    assert [budget.position_of(i) for i in range(budget.n_images)] == expected.tolist()
    with pytest.raises(ValueError, match=r"image: expected 0 to 38, got 39"):
        budget.position_of(39)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"images_per_class": {"tank": 1, "truck": 1}}, "no number for the class 'sam'"),
        ({"images_per_class": {"tank": 1, "truck": 1, "sam": 1, "jet": 1}}, "no vehicle has the class 'jet'"),
        ({"images_per_class": 0}, "no image would be made"),
        ({"positions_per_vehicle": 0}, "no image would be made"),
    ],
)
def test_an_impossible_budget_is_refused(section, message):
    with pytest.raises(ConfigError, match=message):
        make_budget(BudgetSection(**section), CATEGORIES)


def test_a_position_out_of_range_is_refused():
    budget = make_budget(BudgetSection(images_per_class=5), CATEGORIES)
    with pytest.raises(ValueError, match="index: expected positions 0 to"):
        budget.positions([budget.n_positions])
