"""Counts that add up: round robin within a class, equation 1, and the order of positions."""

import numpy as np
import pytest

from hulldown.geometry.errors import ConfigError
from hulldown.planning.config.schema import BudgetSection
from hulldown.planning.search.budget import make_budget

CATEGORIES = {"t72": "tank", "leo": "tank", "ural": "truck", "m1": "tank", "s300": "sam", "man": "truck"}


def visited(budget):
    """Every position, one by one, in the obvious way: classes take turns, each gives its next model's next position."""
    left = {v: int(n) for v, n in zip(budget.vehicles, budget.images, strict=True)}
    queues = [
        [budget.vehicles[i] for i in range(budget.class_starts[c], budget.class_starts[c + 1])]
        for c in range(len(budget.class_starts) - 1)
    ]
    turn = [0] * len(queues)
    first, rows, count = 0, [], dict.fromkeys(left, 0)
    while any(left.values()):
        for c, queue in enumerate(queues):
            if not any(left[v] for v in queue):
                continue
            v = queue[turn[c] % len(queue)]
            turn[c] += 1
            shots = min(left[v], budget.shots)
            rows.append((v, count[v], shots, first))
            count[v] += 1
            left[v] -= shots
            first += shots
    return rows


@pytest.mark.parametrize(
    "section",
    [
        {"images_per_class": 140},
        {"images_per_class": 7, "images_per_position": 3},
        {"images_per_class": {"tank": 11, "truck": 2, "sam": 30}, "images_per_position": 4},
        {"images_per_class": {"tank": 0, "truck": 1, "sam": 0}},
        {"positions_per_vehicle": 3, "images_per_position": 2},
        {"images_per_class": 1, "images_per_position": 100},
    ],
)
def test_positions_equal_those_of_taking_turns_one_by_one(section):
    budget = make_budget(BudgetSection(**section), CATEGORIES)
    p = budget.positions(np.arange(budget.n_positions))
    rows = [
        (budget.vehicles[v], o, s, f)
        for v, o, s, f in zip(*(a.tolist() for a in (p.vehicle, p.ordinal, p.shots, p.first_image)), strict=True)
    ]
    assert rows == visited(budget)


def test_equation_1():
    budget = make_budget(BudgetSection(positions_per_vehicle=7, images_per_position=5), CATEGORIES)
    assert budget.n_images == len(CATEGORIES) * 5 * 7
    assert budget.images.tolist() == [35] * len(CATEGORIES)


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
def test_a_budget_that_makes_no_sense(section, message):
    with pytest.raises(ConfigError, match=message):
        make_budget(BudgetSection(**section), CATEGORIES)


def test_a_position_that_is_not_there():
    budget = make_budget(BudgetSection(images_per_class=5), CATEGORIES)
    with pytest.raises(ValueError, match="index: expected positions 0 to"):
        budget.positions([budget.n_positions])
