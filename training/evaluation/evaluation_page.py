"""The HTML page of an evaluation, from its template: charts, and examples of misses, false positives, and matches."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.files import replacing
from hulldown.dataset.labels.oriented_box import visible_corners
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
from hulldown.dataset.reports.page import Facet, Tile, render
from hulldown.pictures.drawing import BACKGROUND, contact_sheet
from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.bins import BinFigures
from hulldown.training.evaluation.detector_report import DetectorReport
from hulldown.training.evaluation.evaluate import DetectorComparison, Evaluation
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.metrics import curves
from hulldown.training.evaluation.predictions import Predictions
from hulldown.training.evaluation.tide import CAUSES

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
OUTCOMES = ("missed", "false alarm", "found")
SHEETS = {"missed": "misses.png", "false alarm": "false_alarms.png"}
MOST_TILES = 60  # of each outcome
SHEET = 24  # of these on a sheet
TILE = (320, 240)
AROUND = 2.4  # widths of a box that its picture shows
LEAST = 96  # least pixels of a crop, for context
LABEL_COLOR, FOUND_COLOR = (0, 200, 120), (255, 120, 0)
WORDS = {"figures": FIGURES, "averages": AVERAGES, "meanings": MEANINGS, "sources": SOURCES}


def evaluation_page(one: Evaluation, report: DetectorReport, tiles: Sequence[Tile], unread: str) -> str:
    """Return the page about one file of detections, from its evaluation, its report, and its `thumbnails`."""
    loss, counts = one.errors.loss, report.confusion.counts
    return render(
        TEMPLATE,
        {
            **WORDS,
            "reports": {report.predictions: report},
            "columns": {"all classes": report.overall, **report.per_class},
            "most": MOST_TILES,
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
                f"recall by {found.field.title}": recall_bins(found, report.overall.recall or 0.0)
                for found in one.bins
                if (found.labels > 0).sum() > 1  # a single bin equals the whole
            },
            "fields": [found.field for found in one.bins],
        },
    )


def comparison_page(
    evaluations: Sequence[Evaluation], reports: Mapping[str, DetectorReport], compared: Sequence[DetectorComparison]
) -> str:
    """Return the page that compares files of detections, which have their own pages in folders of their names."""
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
            "columns": {name: report.overall for name, report in reports.items()},
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
    """Return the marker of a curve: a dot if it has one point."""
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


def facets(one: Evaluation) -> list[Facet]:
    """Facets of cases: outcome, class, cause, and every field of bins."""
    causes = ("cause", "cause", [name for name in CAUSES if name != "missed"])
    bins = [(found.field.name, found.field.title, found.field.bins) for found in one.bins]
    return [("outcome", "outcome", OUTCOMES), *bins[:1], causes, *bins[1:]]


def thumbnails(one: Evaluation) -> tuple[list[Tile], str]:
    """Return the largest and most visible misses, the most confident false positives, and the matches of lowest IoU.

    The second value is the error of the first unreadable picture; it's empty if all were read.
    """
    visible = np.array([label.visible_fraction for label in one.labels.annotations], dtype=np.float64)
    visible = np.where((visible >= 0.0) & (visible <= 1.0), visible, 1.0)
    size = one.labels.xywh[:, 2] * one.labels.xywh[:, 3] * visible
    overlap = np.zeros(len(one.labels.class_index))
    overlap[one.seen.found] = one.matching.iou[one.matching.detection[one.seen.found]]
    cases: list[tuple[str, int, Labels | Predictions]] = [
        *(("missed", k, one.labels) for k in _first(one.seen.missed, -size)),
        *(("false alarm", k, one.predictions) for k in _first(one.seen.false, -one.predictions.score)),
        *(("found", k, one.labels) for k in _first(one.seen.found, overlap)),
    ]
    crops: list[Image.Image] = [Image.new("RGB", TILE, BACKGROUND)] * len(cases)
    unread = ""
    for image in sorted({int(boxes.image[k]) for _, k, boxes in cases}):
        name = one.labels.images[image].file_name
        try:
            whole = Image.fromarray(read_pixels(one.labels.folder / name))
        except DatasetError as error:
            unread = unread or f"{name} {error.problem}"
            continue
        for row, (_, k, boxes) in enumerate(cases):
            if boxes.image[k] == image:
                crops[row] = _cut(one, image, boxes.xywh[k], whole)
    tiles = [Tile(_jpeg(crop), *_about(one, outcome, k)) for crop, (outcome, k, _) in zip(crops, cases, strict=True)]
    return tiles, unread


def write_sheets(folder: Path, tiles: Sequence[Tile]) -> None:
    """Write contact sheets of misses and of false positives, without which a sheet of an earlier report is removed."""
    for outcome, name in SHEETS.items():
        chosen = [tile for tile in tiles if tile.values["outcome"] == [outcome]][:SHEET]
        if not chosen:
            (folder / name).unlink(missing_ok=True)
            continue
        pictures = [Image.open(io.BytesIO(tile.picture)) for tile in chosen]
        captions = [", ".join(tile.caption[:2]) for tile in chosen]
        with replacing(folder / name) as file:
            contact_sheet(pictures, columns=6, tile_width=TILE[0], captions=captions).save(file, "PNG")


def _first(among: np.ndarray, order: np.ndarray) -> list[int]:
    rows = np.flatnonzero(among)
    return rows[np.argsort(order[rows], kind="stable")][:MOST_TILES].tolist()


def _about(one: Evaluation, outcome: str, k: int) -> tuple[list[str], dict[str, list[str]]]:
    """Caption and values in each facet of the k-th detection, if it's a false alarm, else of the k-th label."""
    false = outcome == "false alarm"
    boxes = one.predictions if false else one.labels
    name = one.predictions.class_names[boxes.class_index[k]]
    values = {"outcome": [outcome]}
    if false:
        caption = [f"{name} {one.predictions.score[k]:.2f}, false"]
        if one.errors.cause[k] >= 0:
            values["cause"] = [CAUSES[one.errors.cause[k]]]
            caption.append(f"cause: {CAUSES[one.errors.cause[k]]}")
    else:
        caption = [f"{name} {outcome}"]
        if outcome == "found":
            d = int(one.matching.detection[k])
            caption.append(f"confidence {one.predictions.score[d]:.2f}, IoU {one.matching.iou[d]:.2f}")
        caption.append(f"{boxes.xywh[k, 2]:.0f} x {boxes.xywh[k, 3]:.0f} px")
    for field in (found.field for found in one.bins):
        bins = field.of_detection if false else field.of_label
        if bins is not None and bins[k] >= 0:
            values[field.name] = [field.bins[bins[k]]]
    return [*caption, one.labels.images[boxes.image[k]].file_name], values


def _cut(one: Evaluation, image: int, around: Float[np.ndarray, "4"], whole: Image.Image) -> Image.Image:
    """Return a box's surroundings at a tile's size, with the boxes of all labels and counted detections."""
    center = around[:2] + around[2:] / 2.0
    ratio = TILE[0] / TILE[1]
    width = max(AROUND * around[2], AROUND * around[3] * ratio, LEAST)
    size = np.minimum([width, width / ratio], whole.size)
    low = np.clip(center - size / 2.0, 0.0, np.maximum(whole.size - size, 0.0))
    scale = min(TILE[0] / size[0], TILE[1] / size[1])
    inner = tuple(max(1, round(n * scale)) for n in size.tolist())
    cut = whole.resize((inner[0], inner[1]), Image.Resampling.BICUBIC, box=(*low, *np.minimum(low + size, whole.size)))
    pen = ImageDraw.Draw(cut)
    shown = (one.labels.image == image) & ~one.labels.crowd
    counted = ~one.seen.ignored & (one.predictions.image == image)
    if one.predictions.corners is not None:
        true = [visible_corners(one.labels.annotations[k], one.labels.images[image]) for k in np.flatnonzero(shown)]
        for rings, color in ((true, LABEL_COLOR), (one.predictions.corners[counted], FOUND_COLOR)):
            for ring in rings:
                pen.polygon([(x, y) for x, y in ((ring - low) * scale).tolist()], outline=color, width=2)
    else:
        found = one.predictions.xywh[counted]
        for boxes, color in ((one.labels.xywh[shown], LABEL_COLOR), (found, FOUND_COLOR)):
            for xywh in boxes:
                start, stop = (xywh[:2] - low) * scale, (xywh[:2] + xywh[2:] - low) * scale
                line = 3 if np.array_equal(xywh, around) else 2
                corners = (*(start - line), *np.maximum(stop + line - 1, start - line))
                pen.rectangle(tuple(float(n) for n in corners), outline=color, width=line)
    tile = Image.new("RGB", TILE, BACKGROUND)
    tile.paste(cut, ((TILE[0] - cut.width) // 2, (TILE[1] - cut.height) // 2))
    return tile


def _jpeg(picture: Image.Image) -> bytes:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=82)
    return file.getvalue()
