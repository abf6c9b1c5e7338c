"""Find variables that tell a plan's classes apart: a detector would learn them instead of the vehicles."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

from hulldown.plan.config.asset_sections import OWN
from hulldown.plan.row import Row

MIN_EXPECTED_IMAGES = 5.0  # expected images of a class below which values are merged
FALSE_POSITIVE_RATE = 1e-4  # false positive rate for one variable
MIN_CRAMERS_V = 0.1  # Cramér's V below which a dependency doesn't help a detector
REMEDIES = {
    "box height": 'camera.size_measure = "height" gives all classes the same',
    "scenery": "let all classes be planned on all sceneries",
    "paint": "give all classes the same paints",
}
Counts = Mapping[str, Mapping[str, Counter[str]]]


def nuisance_values(row: Row) -> dict[str, str]:
    """Return an image's nuisance variables; those that a position's images share are only in its first."""
    target = row.target
    assert target.bbox is not None  # a target has one
    step = math.floor(2.0 * math.log2(max(target.bbox.height, 1.0)))
    of_image = {
        "HDRI": row.hdri,
        "weather": row.weather.kind if row.weather else "clear",
        "box height": f"{2 ** (step / 2):.0f} to {2 ** ((step + 1) / 2):.0f} pixels",
        "exposure": f"{math.floor(row.exposure_ev)} to {math.floor(row.exposure_ev) + 1} EV",
    }
    if row.shot:
        return of_image
    paint = ", ".join(coat.color or OWN for coat in target.paint)
    return of_image | {
        "scenery": row.scenery,
        "number of companions": str(len(row.companions)),
        "number of distractors": str(len(row.distractors)),
        "paint": paint or "none",
    }


def shortcut_notes(counts: Counts) -> list[str]:
    """Return a line for each variable with a significant dependency on the class, from counts by variable and class."""
    lines = []
    for variable, by_class in counts.items():
        if dependency := _describe_dependency(by_class):
            remedy = f"; {REMEDIES[variable]}" if variable in REMEDIES else ""
            lines.append(f"{variable} tells classes apart: {dependency}{remedy}")
    return lines


def _describe_dependency(by_class: Mapping[str, Counter[str]]) -> str:
    """Describe the value and class that deviate most from independence; empty if chance explains them."""
    classes, total = list(by_class), sum(by_class.values(), Counter[str]())
    smallest, n = min(counts.total() for counts in by_class.values()), total.total()
    common = {value for value, count in total.items() if count * smallest / n >= MIN_EXPECTED_IMAGES}
    merged: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for category, counts in by_class.items():
        for value, count in counts.items():
            merged[value if value in common else "another"][category] += count
    table = np.array([[merged[value][category] for value in merged] for category in classes], dtype=np.float64)
    if min(table.shape) < 2:
        return ""
    # Pearson's chi-squared test; importing scipy.stats for it would take a third of a second.
    expected = np.outer(table.sum(axis=1), table.sum(axis=0)) / n
    statistic = float(((table - expected) ** 2 / expected).sum())
    likelihood = chdtrc(math.prod(side - 1 for side in table.shape), statistic)
    strength = math.sqrt(statistic / n / (min(table.shape) - 1))
    if likelihood >= FALSE_POSITIVE_RATE or strength < MIN_CRAMERS_V:
        return ""
    row, column = np.unravel_index(((table - expected) / np.sqrt(expected)).argmax(), table.shape)
    share, others = table[row, column] / table[row].sum(), np.delete(table, row, 0)
    rest = others[:, column].sum() / others.sum()
    return f"{list(merged)[column]} for {share:.0%} of {classes[row]} and {rest:.0%} of the others"
