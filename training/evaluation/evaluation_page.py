"""The HTML page of an evaluation: a table of figures, two charts, and sheets of misses and false positives."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from hulldown.annotate.labels.oriented_box import visible_rectangle_corners
from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.files import replace_file
from hulldown.dataset.reports.charts import (
    BLUE,
    GREEN,
    INK,
    MAX_NAME_CHARACTERS,
    RED,
    SERIES_COLORS,
    make_figure_and_axes,
    shorten_and_escape_name,
)
from hulldown.dataset.reports.page import render_page
from hulldown.pictures.sheets import BACKGROUND_COLOR, contact_sheet
from hulldown.training.evaluation.detector_report import DetectorReport
from hulldown.training.evaluation.evaluate import DetectorComparison, Evaluation
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.metrics import threshold_curves
from hulldown.training.evaluation.predictions import Predictions

PAGE_TEMPLATE = "training/evaluation/evaluation_page.html"
FIGURE_TITLES = {
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
COMPARED_METRICS = ("precision", "recall", "f1", "mean_iou", "mean_confidence", "ap", "ap50", "ap75")
THRESHOLD_SOURCES = {"given": "as given", "validation": "best F1 on the validation set"}
MAX_SHEET_TILES = 24
TILE_SIZE = (320, 240)
CROP_BOX_WIDTHS = 2.4
MIN_CROP_WIDTH_PX = 96  # for context
LABEL_COLOR, FOUND_COLOR = (0, 200, 120), (255, 120, 0)


def evaluation_page(one: Evaluation, report: DetectorReport, sheets: Mapping[str, bytes]) -> str:
    """Return the page about one file of detections, from its evaluation, its report, and its `write_error_sheets`."""
    return render_page(
        PAGE_TEMPLATE,
        {
            "figures": FIGURE_TITLES,
            "sources": THRESHOLD_SOURCES,
            "reports": {report.predictions: report},
            "columns": {"all classes": report.overall, **report.per_class},
            "curves": {
                "precision over recall": precision_recall_chart([one]),
                "precision, recall, and F1 over the confidence threshold": threshold_chart(one),
            },
            "sheets": sheets,
            "titles": {found.field.name: found.field.title for found in one.bins},
        },
    )


def comparison_page(
    evaluations: Sequence[Evaluation], reports: Mapping[str, DetectorReport], compared: Sequence[DetectorComparison]
) -> str:
    """Return the page that compares files of detections, which have their own pages in folders of their names."""
    return render_page(
        PAGE_TEMPLATE,
        {
            "figures": FIGURE_TITLES,
            "sources": THRESHOLD_SOURCES,
            "reports": reports,
            "columns": {name: report.overall for name, report in reports.items()},
            "curves": {"precision over recall of each": precision_recall_chart(evaluations)},
            "changes": [
                (f"{FIGURE_TITLES[key]}: {one.second[:MAX_NAME_CHARACTERS]}", one.difference[key], one.intervals[key].tolist())
                for one in compared
                for key in COMPARED_METRICS
            ],
        },
    )


def precision_recall_chart(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision over recall with operating points: of each class for one detector, or of several detectors."""
    figure, axes = make_figure_and_axes("precision over recall", 5.4, 3.6)
    colors = cycle(SERIES_COLORS)
    for one in evaluations:
        alone = len(evaluations) == 1
        curve, color = threshold_curves(one.matching), next(colors)
        name = "all classes" if alone else shorten_and_escape_name(one.predictions.name)
        axes.plot(curve["recall"], curve["precision"], curve_line_style(curve["recall"]), color=color, label=name)
        for label, name in enumerate(one.predictions.class_names if alone else ()):
            each = threshold_curves(one.matching, label=label)
            line, own = curve_line_style(each["recall"]), next(colors)
            axes.plot(each["recall"], each["precision"], line, color=own, linewidth=0.9, label=shorten_and_escape_name(name))
        at = np.searchsorted(-curve["threshold"], -one.threshold.value, side="right") - 1
        if at >= 0:
            axes.plot(curve["recall"][at], curve["precision"][at], "o", color=color)
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))
    axes.legend(fontsize=7, loc="lower left")
    return figure


def curve_line_style(values: np.ndarray) -> str:
    """Return the marker of a curve: a dot if the curve has one point."""
    return "-" if len(values) > 1 else "."


def threshold_chart(one: Evaluation) -> Figure:
    """Draw precision, recall, and F1 over the confidence from which detections count."""
    figure, axes = make_figure_and_axes("figures over the threshold (dotted: as evaluated)", 5.4, 3.6)
    curve = threshold_curves(one.matching)
    for key, color in (("precision", BLUE), ("recall", GREEN), ("f1", RED)):
        axes.plot(curve["threshold"], curve[key], curve_line_style(curve[key]), color=color, label=FIGURE_TITLES[key])
    axes.axvline(one.threshold.value, color=INK, linewidth=0.8, linestyle=":")
    axes.set(xlabel="confidence threshold", ylim=(0, 1.02))
    axes.legend(fontsize=7, loc="lower center")
    return figure


def write_error_sheets(folder: Path, one: Evaluation) -> dict[str, bytes]:
    """Write and return sheets of the largest misses and the most confident false positives; remove old ones."""
    sizes = np.sqrt(one.labels.xywh[:, 2] * one.labels.xywh[:, 3])
    chosen = {
        "misses.png": _ranked_tiles_by_caption(one, one.labels, one.seen.missed, sizes, "size {:.0f} px"),
        "false_alarms.png": _ranked_tiles_by_caption(
            one, one.predictions, one.seen.false, one.predictions.score, "confidence {:.2f}"
        ),
    }
    sheets = {}
    for name, tiles in chosen.items():
        (folder / name).unlink(missing_ok=True)
        if tiles:
            file = io.BytesIO()
            contact_sheet(list(tiles.values()), columns=6, tile_width=TILE_SIZE[0], captions=list(tiles)).save(file, "PNG")
            sheets[name] = file.getvalue()
            replace_file(folder / name, sheets[name])
    return sheets


def _ranked_tiles_by_caption(
    one: Evaluation, boxes: Labels | Predictions, among: Bool[np.ndarray, " n"], rank: Float[np.ndarray, " n"], word: str
) -> dict[str, Image.Image]:
    """Return pictures of the boxes of highest rank by caption; `word` formats the rank there."""
    rows = np.flatnonzero(among)
    tiles = {}
    for number, k in enumerate(rows[np.argsort(-rank[rows], kind="stable")][:MAX_SHEET_TILES].tolist(), start=1):
        tile, problem = _box_tile_and_problem(one, int(boxes.image[k]), boxes.xywh[k])
        name = one.predictions.class_names[boxes.class_index[k]]
        tiles[", ".join((f"{number}. {name}", word.format(rank[k]), *problem))] = tile
    return tiles


def _box_tile_and_problem(one: Evaluation, image: int, around: Float[np.ndarray, "4"]) -> tuple[Image.Image, tuple[str, ...]]:
    """Return a box's surroundings with all labels' and counted detections' boxes, and why it can't be read."""
    tile, name = Image.new("RGB", TILE_SIZE, BACKGROUND_COLOR), one.labels.images[image].file_name
    try:
        whole = Image.fromarray(read_pixels(one.labels.folder / name))
    except DatasetError as error:
        return tile, (f"{name} {error.problem}",)
    ratio = TILE_SIZE[0] / TILE_SIZE[1]
    width = max(CROP_BOX_WIDTHS * around[2], CROP_BOX_WIDTHS * around[3] * ratio, MIN_CROP_WIDTH_PX)
    size = np.minimum([width, width / ratio], whole.size)
    low = np.clip(around[:2] + (around[2:] - size) / 2.0, 0.0, np.maximum(whole.size - size, 0.0))
    scale = min(TILE_SIZE[0] / size[0], TILE_SIZE[1] / size[1])
    inner = tuple(max(1, round(n * scale)) for n in size.tolist())
    cut = whole.resize((inner[0], inner[1]), Image.Resampling.BICUBIC, box=(*low, *np.minimum(low + size, whole.size)))
    pen = ImageDraw.Draw(cut)
    shown = np.flatnonzero((one.labels.image == image) & ~one.labels.crowd)
    counted = ~one.seen.ignored & (one.predictions.image == image)
    true, found = list(_box_corners(one.labels.xywh[shown])), _box_corners(one.predictions.xywh[counted])
    if one.predictions.corners is not None:
        true = [visible_rectangle_corners(one.labels.annotations[k], one.labels.images[image]) for k in shown.tolist()]
        found = one.predictions.corners[counted]
    for outlines, color in ((true, LABEL_COLOR), (found, FOUND_COLOR)):
        for outline in outlines:
            pen.polygon([(x, y) for x, y in ((outline - low) * scale).tolist()], outline=color, width=2)
    tile.paste(cut, ((TILE_SIZE[0] - cut.width) // 2, (TILE_SIZE[1] - cut.height) // 2))
    return tile, ()


def _box_corners(xywh: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4 2"]:
    return xywh[:, None, :2] + xywh[:, None, 2:] * [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
