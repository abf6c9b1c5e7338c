"""The HTML page of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hulldown.dataset.reports.charts import LONGEST, differences, svg
from hulldown.dataset.reports.page import (
    Block,
    Chart,
    Charts,
    Gallery,
    Items,
    PageLink,
    PageSection,
    Table,
    Tile,
    Words,
    page,
)
from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.cases import MOST, facets
from hulldown.training.evaluation.evaluate import DetectorComparison, Evaluation
from hulldown.training.evaluation.evaluation_charts import losses, over_thresholds, precision_recall, recall_bins
from hulldown.training.evaluation.tide import CAUSES

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
FLATTERS = (
    "The threshold was chosen on the test set itself, so precision, recall, and F1 are too good: "
    "choose it on a validation set."
)
CONFUSION = (
    "Rows are true classes, columns detected ones. The background's row has false positives, its column "
    "misses. Detections without a match in their class are matched across classes."
)


def evaluation_page(one: Evaluation, report: Mapping[str, Any], tiles: Sequence[Tile], unread: str) -> str:
    """The page about one file of detections, from its evaluation, its `report.report`, and its `cases.thumbnails`."""
    sections = [
        PageSection("Examples", _looks(one, tiles, unread)),
        PageSection("How well", [_figures(report), Words(_sure(one))]),
        PageSection(
            "At other thresholds",
            [
                Charts(
                    [
                        Chart(precision_recall([one]), "precision over recall"),
                        Chart(over_thresholds(one), "precision, recall, and F1 over the confidence threshold"),
                    ]
                )
            ],
        ),
        PageSection("Confusion matrix", [Words(CONFUSION), _confusion(report)]),
        PageSection("Why", _why(one, report)),
        PageSection("Where", _where(one, report)),
    ]
    return page(f"{one.predictions.name} on {one.labels.path}", sections, above=operating_point(one))


def comparison_page(
    evaluations: Sequence[Evaluation],
    reports: Mapping[str, Mapping[str, Any]],
    compared: Sequence[DetectorComparison],
    folders: Mapping[str, str],
) -> str:
    """The page that compares several files of detections; `folders` have their own pages."""
    first = evaluations[0]
    rows = [
        [_title(key, *reports.values()), *(_with_interval(one["overall"], key) for one in reports.values())]
        for key in FIGURES
    ]
    changes = [
        (f"{FIGURES[key]}: {one.second[:LONGEST]}", one.difference[key], *one.intervals[key].tolist())
        for one in compared
        for key in COMPARED
    ]
    cells = [[name, number(value, sign="+"), _ends(low, high)] for name, value, low, high in changes]
    chart = differences(f"difference to {compared[0].first[:LONGEST]}, with 95 % intervals", changes)
    sections = [
        PageSection("At other thresholds", [Chart(precision_recall(evaluations), "precision over recall of each")]),
        PageSection("How well", [Table(["", *reports], rows), Words(_sure(first))]),
        PageSection(
            "Differences",
            [
                Words(
                    "Both have the same resamples of positions, so the difficulty of pictures cancels. An "
                    "interval that contains 0 shows no difference."
                ),
                Chart(svg(chart), "differences with their intervals"),
                Table([f"minus {compared[0].first}", "difference", "95 % interval"], cells),
            ],
        ),
        PageSection("Single reports", [PageLink(name, f"{folder}/report.html") for name, folder in folders.items()]),
    ]
    above = [paragraph for one in evaluations for paragraph in operating_point(one)]
    return page(f"{len(evaluations)} detectors on {first.labels.path}", sections, above=above)


def operating_point(one: Evaluation) -> list[Block]:
    """A sentence about the operating point."""
    source = one.threshold.source
    labels = int((~one.labels.crowd).sum())
    text = (
        f"{one.predictions.name}: {len(one.labels.images)} images, {labels} labels. Detections count from a "
        f"confidence of {one.threshold.value:.4g} ({SOURCES[source]}). They are true at an IoU of at least "
        f"{one.matching.iou_threshold:g} with a label of their class."
    )
    return [Words(text), *([Words(FLATTERS, warning=True)] if source == "test" else [])]


def _figures(report: Mapping[str, Any]) -> Table:
    columns = {"all classes": report["overall"], **report["per_class"]}
    rows = [[_title(key, report), *(_with_interval(one, key) for one in columns.values())] for key in FIGURES]
    return Table(["", *columns], rows)


def _sure(one: Evaluation) -> str:
    apart = "one per image" if one.positions == len(one.labels.images) else "shots of one place stay together"
    return (
        f"In brackets: 95 % intervals from resampling the {one.positions} positions ({apart}). They cover other "
        "test sets of this size and kind, not other trainings."
    )


def _confusion(report: Mapping[str, Any]) -> Table:
    names, counts = report["confusion"]["classes"], report["confusion"]["counts"]
    shades = [[n / max(sum(row), 1) for n in row] for row in counts]
    shades[-1] = [0.0] * len(names)
    return Table(["", *names], [[name, *map(str, row)] for name, row in zip(names, counts, strict=True)], shades=shades)


def _why(one: Evaluation, report: Mapping[str, Any]) -> list[Block]:
    rows = [
        [f"{name}: {MEANINGS[name]}", str(report["errors"][name]["count"]), _points(report["errors"][name]["ap50"])]
        for name in CAUSES
    ]
    drawn = [Chart(losses(one.errors.loss), "AP50 lost by cause")] if not np.isnan(one.errors.loss["missed"]) else []
    return [
        Words(
            "Causes after TIDE (Bolya et al., ECCV 2020), at an IoU of 0.5. Counts are above the threshold; points of "
            "AP50 are the gain of fixing that cause alone, over all confidences."
        ),
        Table(["cause", "count", "AP50 points"], rows),
        *drawn,
    ]


def _where(one: Evaluation, report: Mapping[str, Any]) -> list[Block]:
    overall = float(report["overall"]["recall"] or 0.0)
    told = report["worst_bins"]
    parts: list[Block] = [
        Items([f"Worst: {line}." for line in told])
        if told
        else Words("No bin with ten or more labels has a recall below the overall one."),
        Words(
            "Whiskers are 95 % intervals, for bins with at least five positions. The dashed line is the overall "
            "recall. Click a bin's name in a table to see its thumbnails."
        ),
        Charts(
            [
                Chart(recall_bins(found, overall), f"recall by {found.field.title}")
                for found in one.bins
                if (found.labels > 0).sum() > 1  # a single bin equals the whole
            ]
        ),
    ]
    for found in one.bins:
        rows = [
            [
                row["bin"],
                str(row["labels"]),
                str(row["found"]),
                ranged(row["recall"], row["recall_interval"]),
                ranged(row["precision"], row["precision_interval"]),
                number(row["mean_iou"]),
            ]
            for row in report["bins"][found.field.name]
        ]
        choose = [{found.field.name: row[0]} for row in rows]
        header = [found.field.title, "labels", "found", "recall", "precision", "mean IoU"]
        parts.append(Table(header, rows, f"by {found.field.title}", choose=choose))
    return parts


def _looks(one: Evaluation, tiles: Sequence[Tile], unread: str) -> list[Block]:
    parts: list[Block] = [
        Words(
            f"At most {MOST} of each outcome: the largest and most visible misses, the most confident false positives, "
            "the matches of lowest IoU. Green: labels. Orange: detections above the threshold."
        )
    ]
    if unread:
        parts.append(Words(f"Some pictures couldn't be read: {unread}", warning=True))
    return [*parts, Gallery(tiles, facets(one)) if tiles else Words("There are no examples.")]


def _title(key: str, *reports: Mapping[str, Any]) -> str:
    """A figure's title, with a warning if the threshold was chosen on the test set itself."""
    chosen = key not in AVERAGES and any(one["threshold_source"] == "test" for one in reports)
    return f"{FIGURES[key]}, at a threshold chosen on this set" if chosen else FIGURES[key]


def _with_interval(record: Mapping[str, Any], key: str) -> str:
    return ranged(record[key], record["intervals"].get(key))


def ranged(value: float | int | None, ends: Sequence[float | None] | None, *, sign: str = "") -> str:
    """Format a figure with its interval, if it has one; `sign` is ``"+"`` for differences."""
    if ends is None or value is None:
        return number(value, sign=sign)
    if None in ends:
        return f"{number(value, sign=sign)} (too few positions to tell)"
    return f"{number(value, sign=sign)} ({number(ends[0], sign=sign)} to {number(ends[1], sign=sign)})"


def number(value: float | int | None, *, sign: str = "") -> str:
    """Format a count, or a figure with three decimals."""
    return "–" if value is None or np.isnan(value) else f"{value:,}" if isinstance(value, int) else f"{value:{sign}.3f}"


def _points(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.1f}"


def _ends(low: float, high: float) -> str:
    return "–" if np.isnan(low) else f"{low:+.3f} to {high:+.3f}"
