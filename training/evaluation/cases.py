"""Crops of the worst misses, false positives, and matches."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from hulldown.annotate.drawing import BACKGROUND, contact_sheet
from hulldown.annotate.known import number
from hulldown.dataset.oriented import visible_corners
from hulldown.dataset.picture_files import read_pixels
from hulldown.dataset.reports.page import Facet, Tile
from hulldown.geometry.errors import DatasetError
from hulldown.geometry.files import replacing
from hulldown.training.evaluation.evaluate import Evaluation
from hulldown.training.evaluation.tide import CAUSES

OUTCOMES = ("missed", "false alarm", "found")
SHEETS = {"missed": "misses.png", "false alarm": "false_alarms.png"}
MOST = 60  # of each outcome
SHEET = 24  # of these on a sheet
TILE = (320, 240)
AROUND = 2.4  # widths of a box that its picture shows
LEAST = 96  # least pixels of a crop, for context
LABEL_COLOR, FOUND_COLOR = (0, 200, 120), (255, 120, 0)


def facets(one: Evaluation) -> list[Facet]:
    """Facets of cases: outcome, class, cause, and every field of bins."""
    causes = ("cause", "cause", [name for name in CAUSES if name != "missed"])
    bins = [(found.field.name, found.field.title, found.field.bins) for found in one.bins]
    return [("outcome", "outcome", OUTCOMES), *bins[:1], causes, *bins[1:]]


def thumbnails(one: Evaluation) -> tuple[list[Tile], str]:
    """The largest and most visible misses, the most confident false positives, and the matches of lowest IoU.

    The second value is the error of the first unreadable picture; it's empty if all were read.
    """
    visible = np.array([number(box.get("visible_fraction")) for box in one.labels.annotations], dtype=np.float64)
    visible = np.where((visible >= 0.0) & (visible <= 1.0), visible, 1.0)
    size = one.labels.xywh[:, 2] * one.labels.xywh[:, 3] * visible
    overlap = np.zeros(len(one.labels.label))
    overlap[one.seen.found] = one.matching.iou[one.matching.detection[one.seen.found]]
    cases = [
        *(("missed", k, one.labels) for k in _first(one.seen.missed, -size)),
        *(("false alarm", k, one.predictions) for k in _first(one.seen.false, -one.predictions.score)),
        *(("found", k, one.labels) for k in _first(one.seen.found, overlap)),
    ]
    crops: list[Image.Image] = [Image.new("RGB", TILE, BACKGROUND)] * len(cases)
    unread = ""
    for image in sorted({int(boxes.image[k]) for _, k, boxes in cases}):
        name = one.labels.images[image]["file_name"]
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
    return rows[np.argsort(order[rows], kind="stable")][:MOST].tolist()


def _about(one: Evaluation, outcome: str, k: int) -> tuple[list[str], dict[str, list[str]]]:
    """Caption and values in each facet of the k-th detection, if it's a false alarm, else of the k-th label."""
    false = outcome == "false alarm"
    boxes = one.predictions if false else one.labels
    name = one.predictions.class_names[boxes.label[k]]
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
    return [*caption, str(one.labels.images[boxes.image[k]]["file_name"])], values


def _cut(one: Evaluation, image: int, around: Float[np.ndarray, "4"], whole: Image.Image) -> Image.Image:
    """A box's surroundings at a tile's size, with the boxes of all labels and counted detections."""
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
