"""An evaluation for machines: report.json and metrics.csv."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.bins import BinFigures, worst
from hulldown.training.evaluation.evaluate import Evaluation
from hulldown.training.evaluation.metrics import FIGURES, figures
from hulldown.training.evaluation.tide import CAUSES

DIGITS = 6
COUNTS = ("tp", "fp", "fn")
COLUMNS = ("predictions", "scope", *COUNTS, *FIGURES, *AVERAGES, "threshold", "threshold_source", "iou")
CURVE_POINTS = 200


def report(one: Evaluation) -> dict[str, Any]:
    """All that is written about one file of detections; what is not defined is None."""
    predictions = one.predictions
    names = class_keys(predictions.class_names)
    return {
        "dataset": str(one.labels.path),
        "predictions": predictions.name,
        "iou": one.matching.iou_threshold,
        "threshold": one.threshold.value,
        "threshold_source": one.threshold.source,
        "images": len(one.labels.images),
        "positions": one.positions,
        "labels": int((~one.labels.crowd).sum()),
        "overall": {
            **_record(one, one.sums.sum(axis=0), {key: one.average.summary[key] for key in AVERAGES}),
            "average_precision": plain(one.average.summary),
            "intervals": plain(one.intervals()),
        },
        "per_class": {
            name: {
                **_record(one, one.sums[c], {key: getattr(one.average, key)[c] for key in AVERAGES}),
                "intervals": plain(one.intervals(c)),
            }
            for c, name in enumerate(names)
        },
        "confusion": {"classes": [*names, "background"], "counts": one.confusion.tolist()},
        "errors": {name: {"count": count, "ap50": plain(one.errors.loss[name])} for name, count in causes(one).items()},
        "curves": {key: plain(values) for key, values in _thinned(one).items()},
        "bins": {found.field.name: _bins(found) for found in one.bins},
        "worst_bins": worst(one.bins),
    }


def causes(one: Evaluation) -> dict[str, int]:
    """How often each cause is met above the threshold: false detections, and missed labels that none was for."""
    confident = one.predictions.score >= one.threshold.value
    counts = {name: int((confident & (one.errors.cause == k)).sum()) for k, name in enumerate(CAUSES)}
    missed = one.seen.missed.copy()
    missed[one.errors.meant[confident & (one.errors.meant >= 0)]] = False
    return {**counts, "missed": int(missed.sum())}


def metrics_csv(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """Of each file of detections, one line for all classes (``overall``) and one for each (``per_class.NAME``)."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for name, one in reports.items():
        rows = {"overall": one["overall"], **{f"per_class.{label}": row for label, row in one["per_class"].items()}}
        writer.writerows({**row, "predictions": name, "scope": scope} for scope, row in rows.items())
    return text.getvalue()


def class_keys(names: Sequence[str]) -> list[str]:
    """The names of classes, numbered where two have the same."""
    return [name if names.count(name) == 1 else f"{name} ({c + 1})" for c, name in enumerate(names)]


def plain(value: Any) -> Any:
    """Numbers and arrays as JSON has them, rounded; None for nan."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return None if math.isnan(value) else round(float(value), DIGITS)
    return value


def _record(one: Evaluation, sums: Float[np.ndarray, "6"], averages: Mapping[str, float]) -> dict[str, Any]:
    return {
        **{key: int(sums[k]) for k, key in enumerate(COUNTS)},
        **plain(figures(sums)),
        **plain(dict(averages)),
        "threshold": one.threshold.value,
        "threshold_source": one.threshold.source,
        "iou": one.matching.iou_threshold,
    }


def _bins(found: BinFigures) -> list[dict[str, Any]]:
    defined = found.field.of_detection is not None
    return [
        {
            "bin": name,
            "labels": int(found.labels[b]),
            "found": int(found.found[b]),
            "recall": plain(found.recall[b]),
            "recall_interval": plain(found.recall_interval[:, b]),
            "mean_iou": plain(found.mean_iou[b]),
            "detections": int(found.detections[b]) if defined else None,
            "precision": plain(found.precision[b]),
            "precision_interval": plain(found.precision_interval[:, b]),
        }
        for b, name in enumerate(found.field.bins)
    ]


def _thinned(one: Evaluation) -> dict[str, Float[np.ndarray, " k"]]:
    """The curves at two hundred of their thresholds."""
    curve = one.curves
    rows = np.unique(np.linspace(0, max(len(curve.threshold) - 1, 0), CURVE_POINTS).round().astype(int))
    rows = rows[: len(curve.threshold)]
    return {key: getattr(curve, key)[rows] for key in ("threshold", "precision", "recall", "f1")}
