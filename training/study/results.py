"""Results of a study: arms with intervals, pairs of arms, the worth of synthetic images, and bins.

Every run has the same test pictures, resampled in the same way, so the difficulty of pictures
cancels in differences. Intervals include the spread of seeds, so they cover other trainings.

References
----------
Efron and Tibshirani, An Introduction to the Bootstrap, 1993, sections 8 and 13.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from hulldown.training.evaluation.average_precision import AVERAGES, class_mean
from hulldown.training.evaluation.bootstrap import (
    combined_error,
    difference_interval,
    ratio_error,
    share_interval,
    standard_error,
)
from hulldown.training.evaluation.evaluate import Evaluation
from hulldown.training.evaluation.metrics import SHARES, SUMS, figures, ratio
from hulldown.training.study.manifest import PlannedRun

COUNTS = ("tp", "fp", "fn")
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
MEASURES = tuple(TITLES)[len(COUNTS) :]
COMPARED = ("f1", "recall", "precision", "ap50", "ap", "mean_iou", "mean_confidence")
ENOUGH = 10  # least labels of a reported bin


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A finished run and its figures on the test pictures.

    Parameters
    ----------
    run
        The run.
    evaluation
        Its evaluation.
    values
        Each of `COUNTS` and `MEASURES`.
    resampled
        Measure -> (r,) values in every resample of the test positions.
    """

    run: PlannedRun
    evaluation: Evaluation
    values: Mapping[str, float]
    resampled: Mapping[str, Float[np.ndarray, " r"]]


@dataclass(frozen=True, eq=False, slots=True)
class Cell:
    """An arm at a fraction: its runs of all seeds.

    Parameters
    ----------
    arm, fraction
        Which.
    photographs
        Its number of photographs, the mean over seeds.
    judged
        Its runs, by seed.
    """

    arm: str
    fraction: float | None
    photographs: float
    judged: Mapping[int, Judged]

    @property
    def name(self) -> str:
        """Its name."""
        return self.arm if self.fraction is None else f"{self.arm} at {100 * self.fraction:.10g} %"


@dataclass(frozen=True, eq=False, slots=True)
class Difference:
    """The difference of a measure, second minus first.

    Parameters
    ----------
    value
        The mean over seeds.
    ends
        (2,) its interval; nan if there is none.
    """

    value: float
    ends: Float[np.ndarray, "2"]

    @property
    def shown(self) -> bool:
        """Whether the interval excludes 0."""
        return bool(self.ends[0] > 0.0 or self.ends[1] < 0.0)


def judged(run: PlannedRun, evaluation: Evaluation) -> Judged:
    """Evaluate a run."""
    sums = evaluation.sums.sum(axis=0)
    values = {**dict(zip(SUMS, sums, strict=True)), **figures(sums), **evaluation.average.summary}
    averages = class_mean(evaluation.averages_resampled)
    resampled = {**figures(evaluation.resampled.sum(axis=1)), **dict(zip(AVERAGES, averages.T, strict=True))}
    return Judged(
        run, evaluation, {key: float(values[key]) for key in TITLES}, {key: resampled[key] for key in MEASURES}
    )


def cells(runs: Sequence[Judged]) -> list[Cell]:
    """Group runs by arm and fraction, in the study's order."""
    groups: dict[tuple[str, float | None], dict[int, Judged]] = {}
    for one in runs:
        groups.setdefault((one.run.arm, one.run.fraction), {})[one.run.seed] = one
    return [
        Cell(arm, fraction, float(np.mean([one.run.photographs for one in by_seed.values()])), by_seed)
        for (arm, fraction), by_seed in groups.items()
    ]


def mean(cell: Cell, measure: str) -> float:
    """The mean over seeds of a count or measure; nan if a run doesn't define it."""
    return float(np.mean([one.values[measure] for one in cell.judged.values()]))


def resampled_means(cell: Cell, measure: str, seeds: Sequence[int]) -> Float[np.ndarray, " r"]:
    """The mean over seeds of a measure in every resample of the test positions."""
    return np.mean([cell.judged[seed].resampled[measure] for seed in seeds], axis=0)


def cell_interval(cell: Cell, measure: str) -> Float[np.ndarray, "2"]:
    """The interval of a measure for other test sets and, with several seeds, other trainings."""
    seeds = sorted(cell.judged)
    values = np.array([cell.judged[seed].values[measure] for seed in seeds])
    positions, labels = _test_size(cell)
    error, freedom = _errors(resampled_means(cell, measure, seeds), values, positions)
    trials = labels if measure in (*SHARES, *AVERAGES) else np.inf
    return share_interval(values.mean(), error, freedom=freedom, trials=trials)


def difference(first: Cell, second: Cell, measure: str) -> Difference:
    """Second minus first over their common seeds, at least one."""
    seeds = sorted(set(first.judged) & set(second.judged))
    values = np.array([second.judged[s].values[measure] - first.judged[s].values[measure] for s in seeds])
    positions, labels = _test_size(first)
    again = resampled_means(second, measure, seeds) - resampled_means(first, measure, seeds)
    error, freedom = _errors(again, values, positions)
    return Difference(float(values.mean()), difference_interval(values.mean(), error, freedom=freedom, labels=labels))


def _test_size(cell: Cell) -> tuple[int, int]:
    """Number of positions with labels, and of labels, in the test pictures."""
    labels = next(iter(cell.judged.values())).evaluation.label_positions.sum(axis=1)
    return int((labels > 0).sum()), int(labels.sum())


def _errors(again: Float[np.ndarray, " r"], values: Float[np.ndarray, " seeds"], positions: int) -> tuple[Any, Any]:
    """Standard error and degrees of freedom of a mean over seeds, from resampled test positions and from the seeds."""
    several = len(values) > 1
    return combined_error(
        standard_error(again, positions),
        values.std(ddof=1) / np.sqrt(len(values)) if several else 0.0,
        test_freedom=positions - 1,
        seed_freedom=len(values) - 1,
    )


def pairs(found: Sequence[Cell]) -> list[tuple[Cell, Cell]]:
    """Pairs of cells to compare: each with real at its fraction, synthetic at the largest; later arms also with mixed.

    Named arms are compared with their base. Both cells must share a seed.
    """
    by_key = {(cell.arm, cell.fraction): cell for cell in found}
    fractions = [cell.fraction for cell in found if cell.fraction is not None]
    whole = max(fractions, default=None)
    wanted: list[tuple[Cell | None, Cell]] = []
    for cell in found:
        if cell.arm != "real":
            wanted.append((by_key.get(("real", whole if cell.fraction is None else cell.fraction)), cell))
        base = next(iter(cell.judged.values())).run.base
        later = "mixed" if cell.arm in ("matched", "balanced", "pretrain") else base
        if later not in (cell.arm, "real"):
            wanted.append((by_key.get((later, cell.fraction)), cell))
    return [(first, second) for first, second in wanted if first is not None and set(first.judged) & set(second.judged)]


class Equivalent(NamedTuple):
    """How many more photographs the real arm needs to be as good as a cell, with its interval; inf: more than `most`.

    `most` is the number of further photographs, the largest value that can be shown.
    """

    photographs: float
    interval: list[float]
    most: float


def equivalent_photographs(real: Sequence[Cell], cell: Cell, measure: str) -> Equivalent | None:
    """The worth of a cell's synthetic images in photographs; None if no difference is shown.

    Photographs must be shown to help: the real arm with the most must be better than that with the fewest. The cell
    must be shown to differ from the real arm with as many photographs, and the interval of its worth must exclude 0.
    """
    seeds = sorted(set(cell.judged).intersection(*(set(one.judged) for one in real)))
    ordered = sorted(real, key=lambda one: one.photographs)
    if len(ordered) < 2 or not seeds:
        return None
    helps = difference(ordered[0], ordered[-1], measure)
    same = next((one for one in ordered if one.fraction == cell.fraction), None)
    against_same = cell.fraction is None or (same is not None and difference(same, cell, measure).shown)
    if not helps.ends[0] > 0.0 or not against_same:
        return None
    counts = np.array([one.photographs for one in ordered])
    values = np.array([[np.mean([one.judged[s].values[measure] for s in seeds])] for one in (*ordered, cell)])
    own = cell.photographs if cell.fraction is not None else 0.0
    at = needed(counts, values[:-1], values[-1])[0] - own
    again = np.stack([_with_seeds(one, measure, seeds) for one in (*ordered, cell)])
    in_resamples = needed(counts, again[:-1], again[-1]) - own
    # Some resamples are infinite, so interval ends are resamples themselves, without interpolation.
    ends = np.quantile(in_resamples, [0.025, 0.975], method="inverted_cdf")
    if ends[0] <= 0.0 <= ends[1]:
        return None
    return Equivalent(float(at), ends.tolist(), float(counts[-1] - own))


def _with_seeds(cell: Cell, measure: str, seeds: Sequence[int]) -> Float[np.ndarray, " r"]:
    """A measure in every resample of test positions and seeds; cells with the same seeds share resamples."""
    each = np.stack([cell.judged[seed].resampled[measure] for seed in seeds])
    chosen = np.random.default_rng([len(seeds), 3]).integers(0, len(seeds), (len(seeds), each.shape[1]))
    return each[chosen, np.arange(each.shape[1])].mean(axis=0)


def needed(
    counts: Float[np.ndarray, " n"], curve: Float[np.ndarray, "n r"], wanted: Float[np.ndarray, " r"]
) -> Float[np.ndarray, " r"]:
    """The least number of photographs for a wanted value of a curve; inf if it's never reached.

    Between two fractions, a curve is linear in the logarithm of the count, and below the least fraction in the count
    itself, from 0. Falling parts are replaced by the maximum so far.

    Parameters
    ----------
    counts
        (n,) photographs, rising.
    curve
        (n, r) values at each count, in each resample.
    wanted
        (r,) wanted values.

    Examples
    --------
    >>> needed(np.array([10.0, 100.0]), np.array([[0.2, 0.2, 0.2], [0.4] * 3]), np.array([0.1, 0.3, 0.5])).round(1)
    array([ 5. , 31.6,  inf])
    """
    rising = np.maximum.accumulate(np.nan_to_num(curve), axis=0)
    wanted = np.nan_to_num(wanted)
    first = (rising >= wanted).argmax(axis=0)  # the fraction that reaches it, if one does
    drawing = np.arange(len(wanted))
    after, before = rising[first, drawing], np.where(first > 0, rising[first - 1, drawing], 0.0)
    part = np.where(after > before, (wanted - before) / np.where(after > before, after - before, 1.0), 1.0)
    between = counts[first - 1] * (counts[first] / counts[first - 1]) ** part
    found = np.where(first > 0, between, counts[0] * part)
    return np.where((rising >= wanted).any(axis=0), found, np.inf)


@dataclass(frozen=True, slots=True)
class BinDifference:
    """The difference of recall in a bin, second minus first.

    Parameters
    ----------
    field, bin
        Titles of the field and of the bin.
    labels
        Number of labels.
    recall
        Recall of first and second, means over seeds.
    difference, interval
        Their difference; None if there is no interval.
    """

    field: str
    bin: str
    labels: int
    recall: list[float]
    difference: float
    interval: list[float] | None


def bin_differences(first: Cell, second: Cell) -> list[BinDifference]:
    """Differences of recall, second minus first, in each bin of every field."""
    seeds = sorted(set(first.judged) & set(second.judged))
    found = []
    evaluation = first.judged[seeds[0]].evaluation
    labels = evaluation.labels
    for field in [one.field for one in evaluation.bins if len(one.field.bins) > 1]:
        known = (field.of_label >= 0) & ~labels.crowd
        hits = [
            np.mean([cell.judged[s].evaluation.seen.found[known] for s in seeds], axis=0, dtype=np.float64)
            for cell in (first, second)
        ]
        position = labels.position[labels.image[known]]
        cell_of = position * len(field.bins) + field.of_label[known]
        size = evaluation.positions * len(field.bins)
        sums = np.stack(
            [np.bincount(cell_of, weights=weight, minlength=size) for weight in (*hits, np.ones(len(cell_of)))], axis=1
        ).reshape(evaluation.positions, len(field.bins), 3)
        total = sums.sum(axis=0)
        gained = sums[:, :, 1] - sums[:, :, 0]
        value, there = ratio(gained.sum(axis=0), total[:, 2]), (sums[:, :, 2] > 0).sum(axis=0)
        change = difference_interval(value, ratio_error(gained, sums[:, :, 2]), freedom=there - 1, labels=total[:, 2])
        recalls = ratio(total[:, :2], total[:, 2:])
        found += [
            BinDifference(
                field.title, name, int(total[b, 2]), recalls[b].tolist(), float(recalls[b, 1] - recalls[b, 0]),
                known_ends(change[:, b]),
            )
            for b, name in enumerate(field.bins)
            if total[b, 2] > 0
        ]  # fmt: skip
    return found


def known_ends(ends: Float[np.ndarray, "2"]) -> list[float] | None:
    """The ends of an interval; None if there is none."""
    return None if np.isnan(ends).any() else ends.tolist()
