"""The report about a detector: the contents of report.json, rounded; undefined values are None."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from hulldown.base.indices import even_sample
from hulldown.training.evaluation.bins import BinFigures
from hulldown.training.evaluation.evaluate import DetectorComparison, Evaluation
from hulldown.training.evaluation.metrics import COUNT_METRICS, confusion_matrix, threshold_curves

DECIMAL_DIGITS = 6
CURVE_POINTS = 200
Ends = list[float | None]  # of an interval


class ReportedFigures(Struct, frozen=True, kw_only=True):
    """Figures over all classes, which alone have COCO's summary, or of one class."""

    tp: int
    fp: int
    fn: int
    precision: float | None
    recall: float | None
    f1: float | None
    mean_iou: float | None
    mean_confidence: float | None
    mean_confidence_tp: float | None
    mean_confidence_fp: float | None
    ap: float | None
    ap50: float | None
    ap75: float | None
    threshold: float
    threshold_source: str
    iou: float
    average_precision: dict[str, float | None] | UnsetType = UNSET
    intervals: dict[str, Ends]


class Confusion(Struct, frozen=True):
    """A confusion matrix: rows are true classes, columns detected ones."""

    classes: list[str]
    counts: list[list[int]]


class ReportedBin(Struct, frozen=True):
    """A bin of `BinFigures` as in report.json."""

    bin: str
    labels: int
    found: int
    recall: float | None
    recall_interval: Ends
    mean_iou: float | None
    detections: int | None
    precision: float | None
    precision_interval: Ends


class DetectorReport(Struct, frozen=True, kw_only=True):
    """The report about one file of detections."""

    dataset: str
    predictions: str
    iou: float
    threshold: float
    threshold_source: str
    images: int
    positions: int
    labels: int
    overall: ReportedFigures
    per_class: dict[str, ReportedFigures]
    confusion: Confusion
    curves: dict[str, list[float | None]]
    bins: dict[str, list[ReportedBin]]

    def lines(self) -> list[str]:
        """Return the overall figures as a line."""
        keys = ("precision", "recall", "f1", "ap50")
        values = ((key, getattr(self.overall, key)) for key in keys)
        figures = ", ".join(f"{key} {'undefined' if value is None else f'{value:.3f}'}" for key, value in values)
        return [f"{self.predictions}: {figures}"]


class ReportedComparison(Struct, frozen=True):
    """A `DetectorComparison` as in report.json."""

    first: str
    second: str
    difference: dict[str, float | None]
    intervals: dict[str, Ends]


class DetectorReports(Struct, frozen=True):
    """The reports about several files of detections by name, and comparisons with the first."""

    runs: dict[str, DetectorReport]
    comparisons: list[ReportedComparison]

    def lines(self) -> list[str]:
        """Return the overall figures of each file as a line."""
        return [line for one in self.runs.values() for line in one.lines()]


def detector_report(one: Evaluation) -> DetectorReport:
    """Return the report about one file of detections."""
    predictions = one.predictions
    listed = predictions.class_names
    names = [name if listed.count(name) == 1 else f"{name} ({c + 1})" for c, name in enumerate(listed)]
    curve = threshold_curves(one.matching)
    shown = even_sample(len(curve["threshold"]), CURVE_POINTS)
    return DetectorReport(
        dataset=str(one.labels.path),
        predictions=predictions.name,
        iou=one.matching.iou_threshold,
        threshold=one.threshold.value,
        threshold_source=one.threshold.source,
        images=len(one.labels.images),
        positions=one.labels.positions,
        labels=int((~one.labels.crowd).sum()),
        overall=_figures_for_report(one),
        per_class={name: _figures_for_report(one, c) for c, name in enumerate(names)},
        confusion=Confusion([*names, "background"], confusion_matrix(one.seen).tolist()),
        curves={key: rounded_json(values[shown]) for key, values in curve.items()},
        bins={found.field.name: _bins_for_report(found) for found in one.bins},
    )


def comparison_for_report(found: DetectorComparison) -> ReportedComparison:
    """Return a comparison in the form of the report."""
    return ReportedComparison(**rounded_json(asdict(found)))


def rounded_json(value: Any) -> Any:
    """Return numbers and arrays as rounded JSON values; None for nan and infinity."""
    if isinstance(value, Mapping):
        return {key: rounded_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return rounded_json(value.tolist())
    if isinstance(value, list | tuple):
        return [rounded_json(item) for item in value]
    if isinstance(value, float | np.floating):
        return round(float(value), DECIMAL_DIGITS) if math.isfinite(value) else None
    return value


def _figures_for_report(one: Evaluation, label: int | None = None) -> ReportedFigures:
    return ReportedFigures(
        **{key: int(value) if key in COUNT_METRICS else rounded_json(value) for key, value in one.values(label).items()},
        threshold=one.threshold.value,
        threshold_source=one.threshold.source,
        iou=one.matching.iou_threshold,
        average_precision=rounded_json(one.summary) if label is None else UNSET,
        intervals=rounded_json(one.intervals(label)),
    )


def _bins_for_report(found: BinFigures) -> list[ReportedBin]:
    figures = (rounded_json(getattr(found, key)) for key in BinFigures.__slots__ if key != "field")
    return [ReportedBin(*row) for row in zip(found.field.bins, *figures, strict=True)]
