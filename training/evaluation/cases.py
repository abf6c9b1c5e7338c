"""Crops of the worst misses, false positives, and matches."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from hulldown.annotate.drawing import BACKGROUND, contact_sheet
from hulldown.dataset.oriented import visible_corners
from hulldown.dataset.picture_files import read_pixels
from hulldown.dataset.reports.page import Facet, Tile
from hulldown.geometry.errors import DatasetError
from hulldown.training.evaluation.evaluate import Evaluation
from hulldown.training.evaluation.tide import CAUSES

OUTCOMES = ("missed", "false alarm", "found")
MOST = 60  # of each outcome
SHEET = 24  # of these on a sheet
TILE = (320, 240)
AROUND = 2.4  # widths of a box that its picture shows
LEAST = 96  # least pixels of a crop, for context
LABEL_COLOR, FOUND_COLOR = (0, 200, 120), (255, 120, 0)


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """A box to show.

    Parameters
    ----------
    image
        Index of its image.
    xywh
        The label's box, or the false positive's.
    caption
        Lines about it.
    values
        Its value in each facet.
    """

    image: int
    xywh: Float[np.ndarray, "4"]
    caption: tuple[str, ...]
    values: dict[str, str]


def facets(one: Evaluation) -> list[Facet]:
    """Facets of cases: outcome, class, cause, and every field of bins."""
    causes = Facet("cause", "cause", [name for name in CAUSES if name != "missed"])
    bins = [Facet(found.field.name, found.field.title, found.field.bins) for found in one.bins]
    return [Facet("outcome", "outcome", OUTCOMES), *bins[:1], causes, *bins[1:]]


def thumbnails(one: Evaluation) -> tuple[list[Tile], str]:
    """The largest and most visible misses, the most confident false positives, and the matches of lowest IoU.

    The second value is the error of the first unreadable picture; it's empty if all were read.
    """
    visible = np.array([_share(box.get("visible_fraction")) for box in one.labels.annotations], dtype=np.float64)
    size = one.labels.xywh[:, 2] * one.labels.xywh[:, 3] * visible
    overlap = np.zeros(len(one.labels.label))
    overlap[one.seen.found] = one.matching.iou[one.matching.detection[one.seen.found]]
    cases = [
        *(_label_case(one, k, "missed") for k in _first(one.seen.missed, -size)),
        *(_false_alarm(one, k) for k in _first(one.seen.false, -one.predictions.score)),
        *(_label_case(one, k, "found") for k in _first(one.seen.found, overlap)),
    ]
    crops: list[Image.Image] = [Image.new("RGB", TILE, BACKGROUND)] * len(cases)
    unread = ""
    for image in sorted({case.image for case in cases}):
        name = one.labels.images[image]["file_name"]
        try:
            whole = Image.fromarray(read_pixels(one.labels.folder / name))
        except DatasetError as error:
            unread = unread or f"{name} {error.problem}"
            continue
        for k, case in enumerate(cases):
            if case.image == image:
                crops[k] = _cut(one, case, whole)
    return [Tile(_jpeg(crop), case.caption, case.values) for case, crop in zip(cases, crops, strict=True)], unread


def sheet(tiles: Sequence[Tile], outcome: str) -> Image.Image | None:
    """A contact sheet of the first thumbnails of an outcome; None if there are none."""
    chosen = [tile for tile in tiles if tile.values["outcome"] == outcome][:SHEET]
    pictures = [Image.open(io.BytesIO(tile.picture)) for tile in chosen]
    captions = [", ".join(tile.caption[:2]) for tile in chosen]
    return contact_sheet(pictures, columns=6, tile_width=TILE[0], captions=captions) if chosen else None


def _first(among: np.ndarray, order: np.ndarray) -> list[int]:
    rows = np.flatnonzero(among)
    return rows[np.argsort(order[rows], kind="stable")][:MOST].tolist()


def _label_case(one: Evaluation, k: int, outcome: str) -> Case:
    image, xywh = int(one.labels.image[k]), one.labels.xywh[k]
    name = one.labels.class_names[one.labels.label[k]]
    lines = [f"{name} {outcome}", f"{xywh[2]:.0f} x {xywh[3]:.0f} px", str(one.labels.images[image]["file_name"])]
    if outcome == "found":
        d = int(one.matching.detection[k])
        lines.insert(1, f"confidence {one.predictions.score[d]:.2f}, IoU {one.matching.iou[d]:.2f}")
    values = {f.field.name: f.field.bins[f.field.of_label[k]] for f in one.bins if f.field.of_label[k] >= 0}
    return Case(image, xywh, tuple(lines), {"outcome": outcome, **values})


def _false_alarm(one: Evaluation, d: int) -> Case:
    image, xywh = int(one.predictions.image[d]), one.predictions.xywh[d]
    cause = CAUSES[one.errors.cause[d]] if one.errors.cause[d] >= 0 else ""
    name = one.predictions.class_names[one.predictions.label[d]]
    lines = (
        f"{name} {one.predictions.score[d]:.2f}, false",
        *([f"cause: {cause}"] if cause else []),
        str(one.labels.images[image]["file_name"]),
    )
    values = {
        f.field.name: f.field.bins[f.field.of_detection[d]]
        for f in one.bins
        if f.field.of_detection is not None and f.field.of_detection[d] >= 0
    }
    outcome = {"outcome": "false alarm"} | ({"cause": cause} if cause else {})
    return Case(image, xywh, lines, outcome | values)


def _cut(one: Evaluation, case: Case, whole: Image.Image) -> Image.Image:
    """A case's surroundings at a tile's size, with the boxes of all labels and counted detections."""
    center = case.xywh[:2] + case.xywh[2:] / 2.0
    ratio = TILE[0] / TILE[1]
    width = max(AROUND * case.xywh[2], AROUND * case.xywh[3] * ratio, LEAST)
    size = np.minimum([width, width / ratio], whole.size)
    low = np.clip(center - size / 2.0, 0.0, np.maximum(whole.size - size, 0.0))
    scale = min(TILE[0] / size[0], TILE[1] / size[1])
    inner = tuple(max(1, round(n * scale)) for n in size.tolist())
    cut = whole.resize((inner[0], inner[1]), Image.Resampling.BICUBIC, box=(*low, *np.minimum(low + size, whole.size)))
    pen = ImageDraw.Draw(cut)
    shown = (one.labels.image == case.image) & ~one.labels.crowd
    counted = (one.seen.true | one.seen.false) & (one.predictions.image == case.image)
    if one.predictions.corners is not None:
        true = [
            visible_corners(one.labels.annotations[k], one.labels.images[case.image]) for k in np.flatnonzero(shown)
        ]
        for rings, color in ((true, LABEL_COLOR), (one.predictions.corners[counted], FOUND_COLOR)):
            for ring in rings:
                pen.polygon([(x, y) for x, y in ((ring - low) * scale).tolist()], outline=color, width=2)
    else:
        found = one.predictions.xywh[counted]
        for boxes, color in ((one.labels.xywh[shown], LABEL_COLOR), (found, FOUND_COLOR)):
            for xywh in boxes:
                start, stop = (xywh[:2] - low) * scale, (xywh[:2] + xywh[2:] - low) * scale
                line = 3 if np.array_equal(xywh, case.xywh) else 2
                corners = (*(start - line), *np.maximum(stop + line - 1, start - line))
                pen.rectangle(tuple(float(n) for n in corners), outline=color, width=line)
    tile = Image.new("RGB", TILE, BACKGROUND)
    tile.paste(cut, ((TILE[0] - cut.width) // 2, (TILE[1] - cut.height) // 2))
    return tile


def _share(value: object) -> float:
    return float(value) if isinstance(value, int | float) and 0.0 <= value <= 1.0 else 1.0


def _jpeg(picture: Image.Image) -> bytes:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=82)
    return file.getvalue()
