"""Budgets: exact for any counts, balanced in every prefix, with positions that cover all images."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.plan.config.scene_sections import BudgetSection
from hulldown.planning.search.budget import make_budget

CLASSES = st.lists(st.integers(1, 5), min_size=1, max_size=5)


@st.composite
def budgets(draw):
    """Models with their classes, a budget section, each class's images, and the budget."""
    models = draw(CLASSES)
    categories = {f"{c}-{m}": f"class {c}" for c, n in enumerate(models) for m in range(n)}
    # The config doesn't need to be sorted by class.
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
    return categories, section, wanted, make_budget(section, categories)


def visited(budget, most):
    """Every position by simple iteration: classes take turns, and each gives the next position of its next model."""
    left = {v: int(n) for v, n in zip(budget.vehicles, budget.images, strict=True)}
    queues = np.split(np.array(budget.vehicles), budget.class_starts[1:-1])
    turn = [0] * len(queues)
    rows, count = [], dict.fromkeys(left, 0)
    while any(left.values()):
        for c, queue in enumerate(queues):
            if not any(left[v] for v in queue):
                continue
            v = queue[turn[c] % len(queue)]
            turn[c] += 1
            shots = min(left[v], most)
            rows.append((v, count[v], shots))
            count[v] += 1
            left[v] -= shots
    return rows


@given(budgets())
def test_positions_equal_taking_turns_one_by_one(given_budget):
    _, section, _, budget = given_budget
    p = budget.positions
    assert p.first_image.tolist() == (np.cumsum(p.shots) - p.shots).tolist()
    columns = (getattr(p, key)[~p.background].tolist() for key in ("vehicle", "ordinal", "shots"))
    turns = [(budget.vehicles[vehicle], ordinal, shots) for vehicle, ordinal, shots in zip(*columns, strict=True)]
    assert turns == visited(budget, section.images_per_position)
    assert p.ordinal[p.background].tolist() == list(range(np.count_nonzero(p.background)))
    assert (p.shots[p.background][:-1] == section.images_per_position).all()


@given(budgets())
def test_every_class_gets_exactly_its_images_shared_by_its_models(given_budget):
    categories, section, wanted, budget = given_budget
    p = budget.positions
    images = dict.fromkeys(budget.vehicles, 0)
    for v, shots in zip(p.vehicle.tolist(), p.shots.tolist(), strict=True):
        if v >= 0:
            images[budget.vehicles[v]] += shots
    for name, n in wanted.items():
        counts = [images[v] for v in categories if categories[v] == name]
        assert sum(counts) == n
        assert max(counts) - min(counts) <= 1
    targets = sum(wanted.values())
    backgrounds = p.shots[p.background].sum()
    assert backgrounds == budget.n_images - targets
    assert abs(backgrounds - section.background_share * budget.n_images) <= 0.5 + 1e-9
    if section.positions_per_vehicle is not None:
        # Equation 1.
        assert targets == len(categories) * section.images_per_position * section.positions_per_vehicle


@given(budgets())
def test_every_prefix_has_its_share_of_backgrounds(given_budget):
    *_, budget = given_budget
    p = budget.positions
    so_far = np.cumsum(p.background)
    due = np.arange(1, budget.n_planned_positions + 1) * p.background.mean()
    assert (np.abs(so_far - due) < 1.0).all()


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=6), st.integers(1, 200), st.integers(1, 4))
def test_images_are_in_proportion_to_weights_in_every_prefix(weights, n, most):
    weights[0] += 0.01
    names = [f"v{i}" for i in range(len(weights))]
    section = BudgetSection(images_per_class=n, images_per_position=most)
    budget = make_budget(section, dict.fromkeys(names, "tank"), dict(zip(names, weights, strict=True)))
    share = n * np.array(weights) / np.sum(weights)
    assert budget.n_images == n
    assert (np.abs(budget.images - share) <= 1.0 + 1e-6).all()
    p = budget.positions
    for v in range(len(names)):
        so_far = np.cumsum(p.vehicle == v)
        assert (np.abs(so_far - so_far[-1] * (np.arange(len(so_far)) + 1) / len(so_far)) <= len(names)).all()
