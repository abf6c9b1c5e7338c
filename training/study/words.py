"""Sentences about a study's results, limited by their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hulldown.training.study.results import ENOUGH, BinDifference, Cell, Difference, Equivalent, mean

TITLES = {
    "tp": "TP",
    "fp": "FP",
    "fn": "FN",
    "precision": "precision",
    "recall": "recall",
    "f1": "F1",
    "mean_iou": "mean IoU",
    "mean_confidence": "mean confidence",
    "ap50": "AP50",
    "ap": "AP",
}
MOST_BINS = 3  # reported bins of each sign


def difference_words(first: Cell, second: Cell, measure: str, found: Difference) -> str:
    """A sentence about a pair of arms by one measure; `found` is second minus first."""
    title = TITLES[measure]
    if np.isnan(found.value):
        return f"{second.name} minus {first.name}: {title} is undefined without detections."
    if np.isnan(found.ends).any():
        return (
            f"{second.name} minus {first.name}: {title} {found.value:+.3f}, with too few test positions for an "
            "interval."
        )
    ends = f"{found.value:+.3f} ({found.ends[0]:+.3f} to {found.ends[1]:+.3f})"
    if found.shown:
        how = "higher" if found.ends[0] > 0 else "lower"
        return f"{second.name} has a {how} {title} than {first.name}: {ends}."
    return (
        f"Between {second.name} and {first.name} no difference of {title} is shown: {ends}. {second.name} may "
        f"be {abs(found.ends[0]):.3f} worse or {abs(found.ends[1]):.3f} better."
    )


def worth_words(found: Equivalent) -> str:
    """A sentence about the worth of synthetic images in photographs."""
    name, title = found.cell.name, TITLES[found.measure]
    if np.isinf(found.images) and found.most <= 0:
        return f"By {title}, {name} is better than all photographs alone, so its worth has no upper bound."
    if np.isinf(found.images):
        much = f"more than the {found.most:.0f} further photographs"
    elif found.images < 0:
        much = f"minus {-found.images:.0f} photographs: fewer photographs alone are as good"
    else:
        much = f"{found.images:.0f} photographs"
    low, high = found.ends
    told = [f"{end:.0f}" if np.isfinite(end) else f"more than {found.most:.0f}" for end in (low, high)]
    ends = " to ".join(dict.fromkeys(told))
    return f"By {title} the synthetic images of {name} are worth {much} (95 % interval: {ends})."


def bin_words(found: Sequence[BinDifference]) -> list[str]:
    """Sentences about the bins with the largest gains and losses of recall whose interval excludes 0."""
    sure = sorted(
        (one for one in found if one.change.shown and one.labels >= ENOUGH), key=lambda one: -one.change.value
    )
    gained = [one for one in sure if one.change.value > 0][:MOST_BINS]
    lost = [one for one in reversed(sure) if one.change.value < 0][:MOST_BINS]
    return [
        f"{one.field} {one.bin}: recall {one.recall[0]:.2f} to {one.recall[1]:.2f}, {one.change.value:+.2f} "
        f"({one.change.ends[0]:+.2f} to {one.change.ends[1]:+.2f}), {one.labels} labels"
        for one in (*gained, *lost)
    ]


def sureness(seeds: int, images: int, compared: int) -> str:
    """A note on the meaning of the intervals."""
    trainings = (
        "With one seed, they don't cover other trainings."
        if seeds == 1
        else f"They include the spread of the {seeds} seeds."
    )
    told = f"Intervals have 95 % confidence, from resampling the positions in the {images} test pictures. {trainings}"
    if not compared:
        return told
    return (
        f"{told} Of {compared} differences with such intervals, about {max(1, round(0.05 * compared))} would exclude "
        "0 by chance alone."
    )


def summary(measured: Sequence[tuple[Cell, Cell, Difference]], real: Cell | None) -> list[str]:
    """The summary's sentences."""
    lines = [difference_words(first, second, "f1", found) for first, second, found in measured]
    if real is not None and mean(real, "ap50") < 0.5:
        lines.append(
            f"{real.name} reaches an AP50 of {mean(real, 'ap50'):.2f} only. A study whose best photographs teach so "
            "little can't show the worth of synthetic images. Use a larger budget, or clearer pictures."
        )
    return lines
