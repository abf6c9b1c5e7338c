"""Results of a study: arms with intervals, pairs of arms, the worth of synthetic images, and bins.

Every run has the same test pictures, resampled in the same way, so the difficulty of pictures
cancels in differences. Intervals include the spread of seeds, so they cover other trainings.

Efron and Tibshirani, An Introduction to the Bootstrap, 1993, sections 8 and 13.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hulldown.training.evaluation.average_precision import AP_NAMES
from hulldown.training.evaluation.bootstrap import (
    combined_error_and_freedom,
    difference_interval,
    resampled_standard_error,
    share_interval,
)
from hulldown.training.evaluation.evaluate import Evaluation, Threshold, best_threshold, equal_count_threshold
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.metrics import RATIO_METRICS
from hulldown.training.evaluation.predictions import read_predictions
from hulldown.training.study.arms import ARM_KINDS, ArmKind
from hulldown.training.study.study_folder import StudyRun

COUNT_MEASURES = ("tp", "fp", "fn")
MEASURE_TITLES = {
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
RATIO_MEASURES = tuple(MEASURE_TITLES)[len(COUNT_MEASURES) :]


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A finished run, and its figures on the test pictures."""

    run: StudyRun
    photographs: int
    evaluation: Evaluation
    values: Mapping[str, float]  # each of `COUNT_MEASURES` and `RATIO_MEASURES`
    resampled: Mapping[str, Float[np.ndarray, " r"]]  # measure -> (r,) values in every resample of the test positions


@dataclass(frozen=True, eq=False, slots=True)
class Cell:
    """An arm at a fraction, with its runs of all seeds."""

    arm: str
    fraction: float | None
    photographs: float  # its number of photographs, the mean over seeds
    judged: Mapping[int, Judged]

    @property
    def name(self) -> str:
        """Arm and share of the photographs, such as "mixed at 25 %"."""
        return self.arm if self.fraction is None else f"{self.arm} at {100 * self.fraction:.10g} %"


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """A measure of a cell, or a difference of two cells."""

    value: float  # the mean over seeds; nan if a run doesn't define it
    # its interval for other test sets and, with several seeds, other trainings; nan if there is none
    ends: Float[np.ndarray, "2"]

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval excludes 0."""
        return bool(self.ends[0] > 0.0 or self.ends[1] < 0.0)


def evaluate_run(
    run: StudyRun,
    labels: Mapping[str, Labels],
    detections: Mapping[str, Path],
    *,
    photographs: int,
    threshold: float | None = None,
    iou: float = 0.5,
) -> Judged:
    """Evaluate a run on the test pictures; without `threshold`, as many detections count as there are labels."""
    predictions = read_predictions(detections["test"], labels["test"], name=run.name)
    if threshold is not None:
        chosen = Threshold(threshold, "given")
    elif "valid" not in labels:
        chosen = Threshold(equal_count_threshold(labels["test"], predictions), "count")
    else:
        best = best_threshold(labels["valid"], read_predictions(detections["valid"], labels["valid"]), iou=iou)
        # A detector without any detection there is given the highest threshold.
        chosen = Threshold(1.0 if best is None else best, "validation")
    evaluation = Evaluation(labels["test"], predictions, threshold=chosen, iou=iou)
    values, resampled = evaluation.values(), evaluation.resampled_metrics()
    return Judged(
        run,
        photographs,
        evaluation,
        {key: values[key] for key in MEASURE_TITLES},
        {key: resampled[key] for key in RATIO_MEASURES},
    )


def group_runs_into_cells(runs: Sequence[Judged]) -> list[Cell]:
    """Group runs by arm and fraction, in the order of the study."""
    groups: dict[tuple[str, float | None], dict[int, Judged]] = {}
    for one in runs:
        groups.setdefault((one.run.arm, one.run.fraction), {})[one.run.seed] = one
    return [
        Cell(arm, fraction, float(np.mean([one.photographs for one in by_seed.values()])), by_seed)
        for (arm, fraction), by_seed in groups.items()
    ]


def estimate_measure(cell: Cell, measure: str, *, minus: Cell | None = None) -> Estimate:
    """Return a measure of a cell; with `minus`, its difference from that cell over their common seeds, at least one."""
    seeds = sorted(cell.judged.keys() & (minus or cell).judged.keys())
    values, again = _seed_values_and_resamples(cell, measure, seeds)
    if minus is not None:
        before, before_again = _seed_values_and_resamples(minus, measure, seeds)
        values, again = values - before, again - before_again
    labels = cell.judged[seeds[0]].evaluation.position_label_counts
    positions = int((labels > 0).sum())
    error, freedom = combined_error_and_freedom(
        resampled_standard_error(again.mean(axis=0), positions),
        values.std(ddof=1) / np.sqrt(len(seeds)) if len(seeds) > 1 else 0.0,
        test_freedom=positions - 1,
        seed_freedom=len(seeds) - 1,
    )
    value = float(values.mean())
    if minus is not None:
        return Estimate(value, difference_interval(value, error, freedom=freedom, labels=labels.sum()))
    trials = labels.sum() if measure in (*RATIO_METRICS, *AP_NAMES) else np.inf
    return Estimate(value, share_interval(value, error, freedom=freedom, trials=trials))


def _seed_values_and_resamples(
    cell: Cell, measure: str, seeds: Sequence[int]
) -> tuple[Float[np.ndarray, " seeds"], Float[np.ndarray, "seeds r"]]:
    runs = [cell.judged[seed] for seed in seeds]
    return np.array([one.values[measure] for one in runs]), np.stack([one.resampled[measure] for one in runs])


def cell_pairs_to_compare(found: Sequence[Cell]) -> list[tuple[Cell, Cell]]:
    """Return pairs of cells with common seeds: with real, synthetic, later arms with mixed, named arms with base."""
    by_key = {(cell.arm, cell.fraction): cell for cell in found}
    fractions = [cell.fraction for cell in found if cell.fraction is not None]
    whole = max(fractions, default=None)
    wanted: list[tuple[Cell | None, Cell]] = []
    for cell in found:
        if cell.arm != "real":
            wanted.append((by_key.get(("real", whole if cell.fraction is None else cell.fraction)), cell))
        base = next(iter(cell.judged.values())).run.base
        later = "mixed" if ARM_KINDS.get(cell.arm, ArmKind()).beyond_mixed else base
        if later not in (cell.arm, "real"):
            wanted.append((by_key.get((later, cell.fraction)), cell))
    return [(first, second) for first, second in wanted if first is not None and first.judged.keys() & second.judged.keys()]


class Equivalent(NamedTuple):
    """How many more photographs the real arm needs to be as good as a cell; inf: above `most`, the largest shown."""

    photographs: float
    interval: list[float]
    most: float


def equivalent_photographs(real: Sequence[Cell], cell: Cell, measure: str) -> Equivalent | None:
    """Return the worth of a cell's synthetic images in photographs; None if no difference from real is shown."""
    seeds = sorted(set(cell.judged).intersection(*(one.judged for one in real)))
    ordered = sorted(real, key=lambda one: one.photographs)
    if len(ordered) < 2 or not seeds or not estimate_measure(ordered[-1], measure, minus=ordered[0]).ends[0] > 0.0:
        return None
    same = next((one for one in ordered if one.fraction == cell.fraction), None)
    if cell.fraction is not None and (same is None or not estimate_measure(cell, measure, minus=same).excludes_zero):
        return None
    of_seeds = [_seed_values_and_resamples(one, measure, seeds) for one in (*ordered, cell)]
    counts = np.array([one.photographs for one in ordered])
    own = cell.photographs if cell.fraction is not None else 0.0
    values = np.array([[each.mean()] for each, _ in of_seeds])
    at = photographs_needed(counts, values[:-1], values[-1])[0] - own
    # Seeds are resampled too, the same ones in every cell.
    times = of_seeds[0][1].shape[1]
    chosen = np.random.default_rng([len(seeds), 3]).integers(0, len(seeds), (len(seeds), times))
    again = np.stack([each[chosen, np.arange(times)].mean(axis=0) for _, each in of_seeds])
    in_resamples = photographs_needed(counts, again[:-1], again[-1]) - own
    # Some resamples are infinite, so interval ends are resamples themselves, without interpolation.
    ends = np.quantile(in_resamples, [0.025, 0.975], method="inverted_cdf")
    if ends[0] <= 0.0 <= ends[1]:
        return None
    return Equivalent(float(at), ends.tolist(), float(counts[-1] - own))


def photographs_needed(
    counts: Float[np.ndarray, " n"], curve: Float[np.ndarray, "n r"], wanted: Float[np.ndarray, " r"]
) -> Float[np.ndarray, " r"]:
    """Return the fewest photographs with a value of a rising curve, interpolated in logarithms; inf if none."""
    rising = np.maximum.accumulate(np.nan_to_num(curve), axis=0)
    wanted = np.nan_to_num(wanted)
    first = (rising >= wanted).argmax(axis=0)  # the fraction that reaches it, if one does
    drawing = np.arange(len(wanted))
    after, before = rising[first, drawing], np.where(first > 0, rising[first - 1, drawing], 0.0)
    part = np.where(after > before, (wanted - before) / np.where(after > before, after - before, 1.0), 1.0)
    between = counts[first - 1] * (counts[first] / counts[first - 1]) ** part
    found = np.where(first > 0, between, counts[0] * part)
    return np.where((rising >= wanted).any(axis=0), found, np.inf)


def interval_ends_or_none(ends: Float[np.ndarray, "2"]) -> list[float] | None:
    """Return an interval's ends; None without an interval."""
    return None if np.isnan(ends).any() else ends.tolist()
