"""The HTML page of an evaluation, from its template, and its charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import (
    BLUE,
    COLORS,
    GREEN,
    INK,
    LONGEST,
    RED,
    axes_of,
    bars,
    differences,
    short,
)
from hulldown.dataset.reports.page import Tile, render
from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.bins import BinFigures
from hulldown.training.evaluation.cases import MOST, facets
from hulldown.training.evaluation.evaluate import DetectorComparison, Evaluation
from hulldown.training.evaluation.metrics import curves

TEMPLATE = "training/evaluation/evaluation_page.html"
FIGURES = {
    "tp": "true positives (TP)",
    "fp": "false positives (FP)",
    "fn": "false negatives (FN)",
    "precision": "precision",
    "recall": "recall",
    "f1": "F1",
    "mean_iou": "mean IoU of matches",
    "mean_confidence": "mean confidence",
    "mean_confidence_tp": "mean confidence of TP",
    "mean_confidence_fp": "mean confidence of FP",
    "ap": "AP (IoU 0.50 to 0.95)",
    "ap50": "AP50",
    "ap75": "AP75",
}
COMPARED = ("precision", "recall", "f1", "mean_iou", "mean_confidence", "ap", "ap50", "ap75")
MEANINGS = {
    "class": "right place, wrong class",
    "localization": "right class, too little overlap",
    "both": "wrong class, too little overlap",
    "duplicate": "a more confident detection has the label",
    "background": "no label nearby",
    "missed": "labels without any detection",
}
SOURCES = {
    "given": "as given",
    "validation": "best F1 on the validation set",
    "test": "best F1 on this test set itself",
}
WORDS = {"figures": FIGURES, "averages": AVERAGES, "meanings": MEANINGS, "sources": SOURCES}


def evaluation_page(one: Evaluation, report: Mapping[str, Any], tiles: Sequence[Tile], unread: str) -> str:
    """The page about one file of detections, from its evaluation, its `report.report`, and its `cases.thumbnails`."""
    loss, counts = one.errors.loss, report["confusion"]["counts"]
    return render(
        TEMPLATE,
        {
            **WORDS,
            "reports": {report["predictions"]: report},
            "columns": {"all classes": report["overall"], **report["per_class"]},
            "most": MOST,
            "unread": unread,
            "tiles": tiles,
            "facets": facets(one),
            "curves": {
                "precision over recall": precision_recall([one]),
                "precision, recall, and F1 over the confidence threshold": over_thresholds(one),
            },
            "shades": [*([n / max(sum(row), 1) for n in row] for row in counts[:-1]), [0.0] * len(counts)],
            "losses": None if np.isnan(loss["missed"]) else losses(loss),
            "recalls": {
                f"recall by {found.field.title}": recall_bins(found, float(report["overall"]["recall"] or 0.0))
                for found in one.bins
                if (found.labels > 0).sum() > 1  # a single bin equals the whole
            },
            "fields": [found.field for found in one.bins],
        },
    )


def comparison_page(
    evaluations: Sequence[Evaluation], reports: Mapping[str, Mapping[str, Any]], compared: Sequence[DetectorComparison]
) -> str:
    """The page that compares several files of detections, which have their own pages in folders of their names."""
    changes = [
        (f"{FIGURES[key]}: {one.second[:LONGEST]}", one.difference[key], *one.intervals[key].tolist())
        for one in compared
        for key in COMPARED
    ]
    title = f"difference to {compared[0].first[:LONGEST]}, with 95 % intervals"
    return render(
        TEMPLATE,
        {
            **WORDS,
            "reports": reports,
            "columns": {name: report["overall"] for name, report in reports.items()},
            "curves": {"precision over recall of each": precision_recall(evaluations)},
            "changes": changes,
            "differences": differences(title, changes),
        },
    )


def precision_recall(evaluations: Sequence[Evaluation]) -> Figure:
    """Precision over recall, with the operating points."""
    figure, axes = axes_of("precision over recall", 5.4, 3.6)
    colors = cycle(COLORS)
    for one, color in zip(evaluations, colors, strict=False):
        curve, name = curves(one.matching), short(one.predictions.name) if len(evaluations) > 1 else "all classes"
        axes.plot(curve["recall"], curve["precision"], marker_of(curve["recall"]), color=color, label=name)
        for label, class_name in enumerate(one.predictions.class_names if len(evaluations) == 1 else ()):
            each, name = curves(one.matching, label=label), short(class_name)
            line = marker_of(each["recall"])
            axes.plot(each["recall"], each["precision"], line, color=next(colors), linewidth=0.9, label=name)
        at = np.searchsorted(-curve["threshold"], -one.threshold.value, side="right") - 1
        if at >= 0:
            axes.plot(curve["recall"][at], curve["precision"][at], "o", color=color)
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))
    axes.legend(fontsize=7, loc="lower left")
    return figure


def marker_of(values: np.ndarray) -> str:
    """The marker of a curve: a dot if it has one point."""
    return "-" if len(values) > 1 else "."


def over_thresholds(one: Evaluation) -> Figure:
    """Precision, recall and F1 over the confidence from which detections count."""
    figure, axes = axes_of("figures over the threshold (dotted: as evaluated)", 5.4, 3.6)
    curve = curves(one.matching)
    for key, color in (("precision", BLUE), ("recall", GREEN), ("f1", RED)):
        label = "F1" if key == "f1" else key
        axes.plot(curve["threshold"], curve[key], marker_of(curve[key]), color=color, label=label)
    axes.axvline(one.threshold.value, color=INK, linewidth=0.8, linestyle=":")
    axes.set(xlabel="confidence threshold", ylim=(0, 1.02))
    axes.legend(fontsize=7, loc="lower center")
    return figure


def losses(loss: Mapping[str, float]) -> Figure:
    """AP50 that fixing each cause alone would gain."""
    points = {name: 100.0 * lost for name, lost in loss.items()}
    figure = bars("loss of AP50 by cause", points, width=5.4, color=RED)
    figure.axes[0].set(xlabel="gain of AP50 from fixing it alone, points")
    return figure


def recall_bins(found: BinFigures, overall: float) -> Figure:
    """Recall in the bins of a field, with intervals and numbers of labels."""
    rows = np.flatnonzero(found.labels > 0)[::-1]
    figure, axes = axes_of(f"recall by {found.field.title}", 3.75, 0.7 + 0.24 * len(rows))
    places = np.arange(len(rows))
    recall, ends = found.recall[rows], found.recall_interval[rows].T
    axes.barh(places, recall, color=BLUE, height=0.62, alpha=0.75)
    axes.errorbar(
        recall, places, xerr=np.clip(np.stack([recall - ends[0], ends[1] - recall]), 0, None),
        fmt="none", ecolor=INK, elinewidth=1, capsize=2,
    )  # fmt: skip
    axes.axvline(overall, color=RED, linewidth=0.9, linestyle="--")
    axes.set_yticks(places, [f"{short(found.field.bins[b])} (n {found.labels[b]})" for b in rows])
    axes.set_xlim(0, 1.02)
    return figure
