"""The report of a study: report.json for programs; report.html, report.md, and charts for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.base.errors import HulldownError
from hulldown.base.files import replace_file
from hulldown.base.terminal import tracked
from hulldown.dataset.reports.charts import svg
from hulldown.training.detectors.detector import read_run
from hulldown.training.evaluation.detector_report import plain
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.study.manifest import RUNS_NAME, Manifest, PlannedRun, predictions_paths, read_manifest
from hulldown.training.study.results import (
    COUNTS,
    ENOUGH,
    MEASURES,
    TITLES,
    BinDifference,
    Cell,
    Equivalent,
    Estimate,
    Judged,
    bin_differences,
    cells,
    equivalent_photographs,
    estimate,
    judge,
    known_ends,
    pairs,
)
from hulldown.training.study.runs import is_finished, read_failures
from hulldown.training.study.study_page import charts_of, page, png

WORTH_BY = ("ap50", "f1", "recall")
MOST_BINS = 3  # reported bins of each sign


def write_report(study: Path | str) -> dict[str, Any]:
    """Compare the finished runs of a study, and write report and charts into its folder."""
    study = Path(study)
    report = compared_runs(study)
    charts = charts_of(report)
    for name, (_, figure) in charts.items():
        replace_file(study / f"{name}.png", png(figure))
        replace_file(study / f"{name}.svg", svg(figure))
    replace_file(study / "report.json", json.dumps(report, indent=2, ensure_ascii=False).encode() + b"\n")
    replace_file(study / "report.html", page(report, charts).encode())
    replace_file(study / "report.md", page(report, charts, layout="page.md").encode())
    return report


def compared_runs(study: Path | str) -> dict[str, Any]:
    """Compare the finished runs of a study.

    Parameters
    ----------
    study
        The study's folder, finished or not.

    Returns
    -------
    The contents of report.json.

    Raises
    ------
    HulldownError
        If it isn't a study, no run is finished, or test pictures have changed.
    """
    study = Path(study)
    manifest = read_manifest(study)
    finished = [run for run in manifest.runs if is_finished(study, manifest, run)]
    if not finished:
        raise HulldownError("no run is finished", path=study, remedy="run `hulldown study run` first")
    config, failures = manifest.config, read_failures(study)
    detections = [predictions_paths(study, manifest, run) for run in finished]
    labels = {which: read_labels(manifest.datasets[which].folder) for which in detections[0]}
    runs = [
        judge(run, labels, files, threshold=config.threshold, iou=config.iou)
        for run, files in tracked("evaluating", zip(finished, detections, strict=True), len(finished))
    ]
    return {
        **_compared(manifest, runs),
        "missing": {run.name: failures.get(run.name, "not run yet") for run in manifest.runs if run not in finished},
        "times": {run.name: _time(study, run) for run in finished},
    }


def _compared(manifest: Manifest, runs: Sequence[Judged]) -> dict[str, Any]:
    """Return the part of the report that is computed from detections and labels alone, so it's reproducible."""
    found = cells(runs)
    compared, real = pairs(found), [cell for cell in found if cell.arm == "real"]
    records = [_pair_record(first, second) for first, second in compared]
    summary = [record["measures"]["ap50"]["words"] for record in records]
    largest = max(real, key=lambda cell: cell.photographs, default=None)
    if largest is not None and (reached := estimate(largest, "ap50").value) < 0.5:
        summary.append(
            f"{largest.name} reaches an AP50 of {reached:.2f} only. A study whose best photographs teach "
            "so little can't show the worth of synthetic images. Use a larger budget, or clearer pictures."
        )
    bins = {
        f"{second.name} minus {first.name}": bin_differences(first, second)
        for first, second in compared
        if first.arm == "real" and second.arm in ("mixed", "balanced")
    }
    return plain({
        "study": _described(manifest),
        "summary": summary,
        "sureness": sureness(manifest, len(records) * len(MEASURES)),
        "cells": [_cell_record(cell) for cell in found],
        "pairs": records,
        "worth": [
            {
                "arm": cell.arm, "name": cell.name, "fraction": cell.fraction, "measure": measure,
                "photographs": one.photographs, "interval": one.interval,
                "words": worth_words(cell.name, measure, one),
            }
            for cell in found
            for measure in WORTH_BY
            if cell.arm != "real" and (one := equivalent_photographs(real, cell, measure)) is not None
        ],
        "bins": {
            name: {"words": bin_words(rows), "rows": [asdict(row) for row in rows]} for name, rows in bins.items()
        },
        "runs": [
            {
                **one.run.model_dump(exclude={"base", "sources", "settings"}),
                "threshold": one.evaluation.threshold.value, **one.values,
            }
            for one in runs
        ],
    })  # fmt: skip


def _described(manifest: Manifest) -> dict[str, Any]:
    config = manifest.config
    return {
        "classes": list(manifest.classes),
        "datasets": {name: one.model_dump(mode="json", exclude={"folder"}) for name, one in manifest.datasets.items()},
        "arms": [arm.name for arm in config.named_arms],
        **config.model_dump(include={"fractions", "seeds", "iou"}),
        "threshold": config.threshold or ("count" if config.valid is None else "validation"),
        "train": config.train.model_dump(mode="json", exclude={"seed", "weights"}),
        "runs": len(manifest.runs),
    }


def _cell_record(cell: Cell) -> dict[str, Any]:
    seeds, estimates = sorted(cell.judged), {key: estimate(cell, key) for key in MEASURES}
    return {
        "arm": cell.arm,
        "fraction": cell.fraction,
        "name": cell.name,
        "photographs": cell.photographs,
        "seeds": seeds,
        **{key: np.mean([cell.judged[seed].values[key] for seed in seeds]) for key in COUNTS},
        **{key: one.value for key, one in estimates.items()},
        "intervals": {key: known_ends(one.ends) for key, one in estimates.items()},
        "of_seeds": {key: [cell.judged[seed].values[key] for seed in seeds] for key in MEASURES},
    }


def _pair_record(first: Cell, second: Cell) -> dict[str, Any]:
    differences = {key: estimate(second, key, minus=first) for key in MEASURES}
    return {
        "first": first.name,
        "second": second.name,
        "fraction": second.fraction,
        "measures": {
            key: {
                "difference": one.value,
                "interval": known_ends(one.ends),
                "words": difference_words(first, second, key, one),
            }
            for key, one in differences.items()
        },
    }


def _time(study: Path, run: PlannedRun) -> float | None:
    """Seconds of a run's training; after a kill, of its last process."""
    seconds = read_run(study / RUNS_NAME / run.folder).figures.seconds
    return None if seconds is None else round(seconds, 1)


def difference_words(first: Cell, second: Cell, measure: str, found: Estimate) -> str:
    """Return a sentence about a pair of arms by one measure; `found` is second minus first."""
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


def worth_words(name: str, measure: str, found: Equivalent) -> str:
    """Return a sentence about the worth of a cell's synthetic images in photographs."""
    title = TITLES[measure]
    if np.isinf(found.photographs) and found.most <= 0:
        return f"By {title}, {name} is better than all photographs alone, so its worth has no upper bound."
    if np.isinf(found.photographs):
        much = f"more than the {found.most:.0f} further photographs"
    elif found.photographs < 0:
        much = f"minus {-found.photographs:.0f} photographs: fewer photographs alone are as good"
    else:
        much = f"{found.photographs:.0f} photographs"
    told = [f"{end:.0f}" if np.isfinite(end) else f"more than {found.most:.0f}" for end in found.interval]
    ends = " to ".join(dict.fromkeys(told))
    return f"By {title} the synthetic images of {name} are worth {much} (95 % interval: {ends})."


def bin_words(found: Sequence[BinDifference]) -> list[str]:
    """Return sentences about the bins with the largest gains and losses of recall whose interval excludes 0."""
    known = [(one, one.interval) for one in found if one.interval and one.labels >= ENOUGH]
    known.sort(key=lambda pair: -pair[0].difference)
    gained = [(one, ends) for one, ends in known if ends[0] > 0][:MOST_BINS]
    lost = [(one, ends) for one, ends in reversed(known) if ends[1] < 0][:MOST_BINS]
    return [
        f"{one.field} {one.bin}: recall {one.recall[0]:.2f} to {one.recall[1]:.2f}, {one.difference:+.2f} "
        f"({low:+.2f} to {high:+.2f}), {one.labels} labels"
        for one, (low, high) in (*gained, *lost)
    ]


def sureness(manifest: Manifest, compared: int) -> str:
    """Return a note on the meaning of the intervals, of which `compared` are of differences."""
    seeds, images = len(manifest.config.seeds), manifest.datasets["test"].images
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
