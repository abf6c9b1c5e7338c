"""Budgets: exact for any counts, balanced at every beginning, positions that tile the images."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.planning.config.schema import BudgetSection
from hulldown.planning.search.budget import make_budget

CLASSES = st.lists(st.integers(1, 5), min_size=1, max_size=5)


@st.composite
def budgets(draw):
    """Models per class, a budget section, and what each class should get."""
    models = draw(CLASSES)
    categories = {f"{c}-{m}": f"class {c}" for c, n in enumerate(models) for m in range(n)}
    # The order in the config need not be by class.
    categories = {name: categories[name] for name in draw(st.permutations(list(categories)))}
    shots = draw(st.integers(1, 7))
    share = draw(st.sampled_from([0.0, 0.0, 0.05, 0.3, 0.9]))
    if draw(st.booleans()):
        positions = draw(st.integers(1, 9))
        section = BudgetSection(positions_per_vehicle=positions, images_per_position=shots, background_share=share)
        wanted = {f"class {c}": n * positions * shots for c, n in enumerate(models)}
    else:
        wanted = {f"class {c}": draw(st.integers(0, 60)) for c in range(len(models))}
        wanted["class 0"] += 1
        section = BudgetSection(images_per_class=wanted, images_per_position=shots, background_share=share)
    return categories, section, wanted


@given(budgets())
def test_every_class_gets_exactly_its_images_and_its_models_share_them(given_budget):
    categories, section, wanted = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    images = dict.fromkeys(budget.vehicles, 0)
    for v, shots in zip(p.vehicle.tolist(), p.shots.tolist(), strict=True):
        if v >= 0:
            images[budget.vehicles[v]] += shots
    for name, n in wanted.items():
        mine = [images[v] for v in categories if categories[v] == name]
        assert sum(mine) == n
        assert max(mine) - min(mine) <= 1
    targets = sum(wanted.values())
    assert p.shots[p.background].sum() == budget.backgrounds == budget.n_images - targets
    assert abs(budget.backgrounds - section.background_share * budget.n_images) <= 0.5 + 1e-9
    if section.positions_per_vehicle is not None:
        # Equation 1.
        assert targets == len(categories) * section.images_per_position * section.positions_per_vehicle


@given(budgets())
def test_positions_tile_the_images_and_number_each_vehicles_own(given_budget):
    categories, section, _ = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    assert p.first_image.tolist() == (np.cumsum(p.shots) - p.shots).tolist()
    assert 1 <= p.shots.min() <= p.shots.max() <= section.images_per_position
    for v in range(-1, len(budget.vehicles)):
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
    cls = np.searchsorted(budget.class_starts, p.vehicle[~p.background], side="right") - 1
    totals = budget.positions_per_class
    visited = np.zeros(len(totals), dtype=int)
    for c in cls.tolist():
        visited[c] += 1
        # A class is ahead of another only once that one has nothing left.
        behind = visited < visited[c] - 1
        assert (visited[behind] == totals[behind]).all()


@given(budgets())
def test_any_beginning_has_its_share_of_backgrounds(given_budget):
    categories, section, _ = given_budget
    budget = make_budget(section, categories)
    p = budget.positions(np.arange(budget.n_positions))
    so_far = np.cumsum(p.background)
    due = np.arange(1, budget.n_positions + 1) * budget.n_background_positions / budget.n_positions
    assert (np.abs(so_far - due) < 1.0).all()
