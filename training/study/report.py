"""The report of a study: report.json for programs; report.html, report.md, and charts for people."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hulldown.dataset.reports.charts import svg
from hulldown.geometry.errors import HulldownError
from hulldown.geometry.files import replace_file
from hulldown.training.detectors.detector import read_run
from hulldown.training.evaluation.evaluate import Evaluation, Threshold, best_threshold
from hulldown.training.evaluation.labels import Labels, read_labels
from hulldown.training.evaluation.predictions import read_predictions
from hulldown.training.evaluation.report import plain
from hulldown.training.study.charts import png
from hulldown.training.study.manifest import RUNS_NAME, Manifest, PlannedRun, read_manifest
from hulldown.training.study.page import charts_of, page
from hulldown.training.study.results import (
    COMPARED,
    COUNTS,
    MEASURES,
    Cell,
    Equivalent,
    Judged,
    bin_differences,
    cell_interval,
    cells,
    difference,
    equivalent_photographs,
    judged,
    mean,
    pairs,
)
from hulldown.training.study.runs import is_finished, predictions_path, read_failures
from hulldown.training.study.words import bin_words, difference_words, summary, sureness, worth_words

WORTH_BY = ("f1", "recall", "ap50")


def write_report(study: Path | str, *, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Compare the finished runs of a study, and write report and charts into its folder."""
    study = Path(study)
    report = compared_runs(study, progress=progress)
    charts = charts_of(report)
    for name, figure in charts.items():
        replace_file(study / f"{name}.png", png(figure))
        replace_file(study / f"{name}.svg", svg(figure))
    replace_file(study / "report.json", json.dumps(report, indent=2, ensure_ascii=False).encode() + b"\n")
    replace_file(study / "report.html", page(report, charts).encode())
    replace_file(study / "report.md", page(report, charts, layout="page.md").encode())
    return report


def compared_runs(study: Path | str, *, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Compare the finished runs of a study.

    Parameters
    ----------
    study
        The study's folder, finished or not.
    progress
        Called with (runs evaluated, all).

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
    labels = read_labels(manifest.datasets["test"].folder)
    valid = read_labels(manifest.datasets["valid"].folder) if "valid" in manifest.datasets else None
    runs = []
    for done, run in enumerate(finished, start=1):
        runs.append(_judge(study, manifest, run, labels, valid))
        if progress is not None:
            progress(done, len(finished))
    found = _compared(manifest, runs)
    failures = read_failures(study)
    return {
        **found,
        "missing": {run.name: failures.get(run.name, "not run yet") for run in manifest.runs if run not in finished},
        "times": {run.name: _time(study, run) for run in finished},
    }


def _judge(study: Path, manifest: Manifest, run: PlannedRun, labels: Labels, valid: Labels | None) -> Judged:
    """A run's figures at its threshold."""
    config = manifest.config
    path = predictions_path(study, manifest, run, "test")
    threshold = Threshold(config.threshold, "given")
    if valid is not None:
        looked = read_predictions(predictions_path(study, manifest, run, "valid"), valid)
        best = best_threshold(valid, looked, iou=config.iou)
        # A detector without any detection there is given the highest threshold.
        threshold = Threshold(1.0 if best is None else best, "validation")
    predictions = read_predictions(path, labels, name=run.name)
    return judged(run, Evaluation(labels, predictions, threshold=threshold, iou=config.iou))


def _compared(manifest: Manifest, runs: Sequence[Judged]) -> dict[str, Any]:
    """The part of the report that is computed from detections and labels alone, so it's reproducible."""
    found = cells(runs)
    compared = [
        (first, second, {measure: difference(first, second, measure) for measure in COMPARED})
        for first, second in pairs(found)
    ]
    real = [cell for cell in found if cell.arm == "real"]
    others = [cell for cell in found if cell.arm != "real"]
    worths = [
        one
        for cell in others
        for measure in WORTH_BY
        if (one := equivalent_photographs(real, cell, measure)) is not None
    ]
    against_real = [(first, second) for first, second in pairs(found) if first.arm == "real" and second.arm == "mixed"]
    bins = {f"{second.name} minus {first.name}": bin_differences(first, second) for first, second in against_real}
    count = sum(len(by_measure) for _, _, by_measure in compared)
    largest = max(real, key=lambda cell: cell.photographs, default=None)
    return plain({
        "study": _described(manifest),
        "summary": summary([(first, second, by_measure["f1"]) for first, second, by_measure in compared], largest),
        "sureness": sureness(len(manifest.config.seeds), manifest.datasets["test"].images, count),
        "cells": [_cell_record(cell) for cell in found],
        "pairs": [
            {
                "first": first.name, "second": second.name, "fraction": second.fraction,
                "measures": {
                    key: {
                        "difference": one.value, "interval": _ends(one.ends),
                        "words": difference_words(first, second, key, one),
                    }
                    for key, one in by_measure.items()
                },
            }
            for first, second, by_measure in compared
        ],
        "worth": [_worth_record(one) for one in worths],
        "bins": {
            name: {
                "words": bin_words(rows),
                "rows": [
                    {
                        "field": row.field, "bin": row.bin, "labels": row.labels, "recall": list(row.recall),
                        "difference": row.change.value, "interval": _ends(row.change.ends),
                    }
                    for row in rows
                ],
            }
            for name, rows in bins.items()
        },
        "runs": [_run_record(one) for one in runs],
    })  # fmt: skip


def _described(manifest: Manifest) -> dict[str, Any]:
    config, train = manifest.config, manifest.config.train
    return {
        "classes": list(manifest.classes),
        "datasets": {name: one.model_dump(mode="json", exclude={"folder"}) for name, one in manifest.datasets.items()},
        "arms": list(config.arm_names),
        "fractions": list(config.fractions),
        "seeds": list(config.seeds),
        "threshold": "validation" if config.valid is not None else config.threshold,
        "iou": config.iou,
        "train": train.model_dump(mode="json", exclude={"seed", "weights"}),
        "runs": len(manifest.runs),
    }


def _cell_record(cell: Cell) -> dict[str, Any]:
    return {
        "arm": cell.arm,
        "fraction": cell.fraction,
        "name": cell.name,
        "photographs": cell.photographs,
        "seeds": sorted(cell.judged),
        **{key: mean(cell, key) for key in (*COUNTS, *MEASURES)},
        "intervals": {key: _ends(cell_interval(cell, key)) for key in MEASURES},
        "of_seeds": {key: [cell.judged[seed].values[key] for seed in sorted(cell.judged)] for key in MEASURES},
    }


def _worth_record(one: Equivalent) -> dict[str, Any]:
    return {
        "arm": one.cell.arm, "name": one.cell.name, "fraction": one.cell.fraction, "measure": one.measure,
        "photographs": one.images, "interval": one.ends,
        "words": worth_words(one),
    }  # fmt: skip


def _run_record(one: Judged) -> dict[str, Any]:
    run = one.run
    return {
        "name": run.name, "arm": run.arm, "fraction": run.fraction, "seed": run.seed, "folder": run.folder,
        "photographs": run.photographs, "drawn": dict(run.drawn), "threshold": one.evaluation.threshold.value,
        **one.values,
    }  # fmt: skip


def _time(study: Path, run: PlannedRun) -> float | None:
    """Seconds of a run's training; after a kill, of its last process."""
    seconds = read_run(study / RUNS_NAME / run.folder).get("figures", {}).get("seconds")
    return None if seconds is None else round(float(seconds), 1)


def _ends(ends: Float[np.ndarray, "2"]) -> list[float] | None:
    return None if np.isnan(ends).any() else [float(end) for end in ends]
