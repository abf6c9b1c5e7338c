"""Budgets: exact for any counts, balanced at every beginning, positions that tile the images."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planning.budget import make_budget
from planning.schema import BudgetSection

CLASSES = st.lists(st.integers(1, 5), min_size=1, max_size=5)


@st.composite
def budgets(draw):
    """Models per class, a budget section, and what each class should get."""
    models = draw(CLASSES)
    categories = {f"{c}-{m}": f"class {c}" for c, n in enumerate(models) for m in range(n)}
    # The order in the config need not be by class.
    categories = {name: categories[name] for name in draw(st.permutations(list(categories)))}
    shots = draw(st.integers(1, 7))
    if draw(st.booleans()):
        positions = draw(st.integers(1, 9))
        section = BudgetSection(positions_per_vehicle=positions, images_per_position=shots)
        wanted = {f"class {c}": n * positions * shots for c, n in enumerate(models)}
    else:
        wanted = {f"class {c}": draw(st.integers(0, 60)) for c in range(len(models))}
        wanted["class 0"] += 1
        section = BudgetSection(images_per_class=wanted, images_per_position=shots)
    return categories, section, wanted


@given(budgets())
def test_every_class_gets_exactly_its_images_and_its_models_share_them(given_budget):
    categories, section, wanted = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    images = dict.fromkeys(budget.vehicles, 0)
    for v, shots in zip(p.vehicle.tolist(), p.shots.tolist(), strict=True):
        images[budget.vehicles[v]] += shots
    for name, n in wanted.items():
        mine = [images[v] for v in categories if categories[v] == name]
        assert sum(mine) == n
        assert max(mine) - min(mine) <= 1
    assert budget.n_images == sum(wanted.values())
    if section.positions_per_vehicle is not None:
        # Equation 1.
        assert budget.n_images == len(categories) * section.images_per_position * section.positions_per_vehicle


@given(budgets())
def test_positions_tile_the_images_and_number_each_vehicles_own(given_budget):
    categories, section, _ = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    assert p.first_image.tolist() == (np.cumsum(p.shots) - p.shots).tolist()
    assert 1 <= p.shots.min() <= p.shots.max() <= section.images_per_position
    for v in range(len(budget.vehicles)):
        mine = p.vehicle == v
        assert p.ordinal[mine].tolist() == list(range(mine.sum()))
        assert (p.shots[mine][:-1] == section.images_per_position).all()


@given(budgets(), st.randoms(use_true_random=False))
def test_any_positions_asked_in_any_order_answer_the_same(given_budget, random):
    categories, section, _ = given_budget
    budget = make_budget(section, categories)
    everything = budget.positions(np.arange(budget.n_positions))
    some = np.array(random.choices(range(budget.n_positions), k=5))
    found = budget.positions(some)
    for key in ("vehicle", "ordinal", "shots", "first_image"):
        assert getattr(found, key).tolist() == getattr(everything, key)[some].tolist()
    image = random.randrange(budget.n_images)
    at = budget.position_of(image)
    assert 0 <= image - everything.first_image[at] < everything.shots[at]


@given(budgets())
def test_classes_take_turns(given_budget):
    categories, section, _ = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    cls = np.searchsorted(budget.class_starts, p.vehicle, side="right") - 1
    totals = budget.positions_per_class
    visited = np.zeros(len(totals), dtype=int)
    for c in cls.tolist():
        visited[c] += 1
        # A class is ahead of another only once that one has nothing left.
        behind = visited < visited[c] - 1
        assert (visited[behind] == totals[behind]).all()
