"""Labels that can be used: boxes inside their images, of which enough shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hulldown.assets.coco_types import Record
from hulldown.base.errors import DatasetError
from hulldown.dataset.attributes import number
from hulldown.dataset.store.seals import changed

ROUNDED = 1e-6  # pixels: rounding error of decimal text
SLIGHT = 1.0  # pixels that a box may leave its image by without being refused
LISTED = 10  # boxes that an error names


def labeled_categories(categories: Iterable[Record], annotations: Iterable[Record]) -> list[Record]:
    """Return categories in the order of ids, without parents of others that label nothing, as Roboflow writes them.

    Examples
    --------
    >>> found = [{"id": 0, "name": "army", "supercategory": "none"}, {"id": 1, "name": "tank", "supercategory": "army"}]
    >>> [category["name"] for category in labeled_categories(found, [{"category_id": 1}])]
    ['tank']
    """
    ordered = sorted(categories, key=lambda category: category["id"])
    used = {annotation["category_id"] for annotation in annotations}
    parents = {c.get("supercategory") for c in ordered if c.get("supercategory") != c["name"]}
    return [category for category in ordered if category["id"] in used or category["name"] not in parents]


def clipped_boxes(annotations: Iterable[Record], images: Iterable[Record], *, folder: Path, clip: bool) -> list[Record]:
    """Return annotations whose boxes lie inside their images; those of other images are left out.

    Parameters
    ----------
    annotations
        Usable COCO annotation records, see `dataset.records.check_usable`.
    images
        COCO image records.
    folder
        The dataset, for errors.
    clip
        Clip every box and leave out those that are outside altogether; else only boxes that leave their image by up to
        `SLIGHT` pixels are clipped.

    Raises
    ------
    DatasetError
        Naming every box without area, and without `clip` every box that leaves its image farther (up to `LISTED`).
    """
    kept: list[Record] = []
    wrong: list[str] = []
    further = False
    known = {image["id"]: image for image in images}
    for annotation in annotations:
        if (image := known.get(annotation["image_id"])) is None:
            continue
        x, y, w, h = annotation["bbox"]
        where = f"{image['file_name']}: annotation {annotation['id']}"
        by = beyond(annotation["bbox"], image["width"], image["height"])
        if w <= 0 or h <= 0:
            wrong.append(f"{where} has no area")
        elif by <= ROUNDED:
            kept.append(annotation)
        elif not clip and by > SLIGHT:
            further = True
            wrong.append(f"{where} leaves its image by {by:.4g} px")
        else:
            left, top = max(x, 0.0), max(y, 0.0)
            box = [left, top, min(x + w, image["width"]) - left, min(y + h, image["height"]) - top]
            if box[2] > 0 and box[3] > 0:
                kept.append(changed(annotation, bbox=box))
            elif not clip:
                wrong.append(f"{where} has no area inside its image")
    remedy = "correct them, or clip them with `hulldown export --clip`" if further else "correct or delete them"
    refuse_all(wrong, "box", folder, remedy=remedy)
    return kept


def refuse_all(wrong: Sequence[str], what: str, folder: Path, *, remedy: str = "correct or delete them") -> None:
    """Raise one error that lists all problems, up to `LISTED`, if there are any.

    Raises
    ------
    DatasetError
        If there are any.
    """
    if wrong:
        more = f", and {len(wrong) - LISTED} more; `hulldown verify` lists all" if len(wrong) > LISTED else ""
        several = {"box": "boxes"}.get(what, f"{what}s")
        counted = f"1 {what}" if len(wrong) == 1 else f"{len(wrong)} {several}"
        raise DatasetError(f"{counted} cannot be used: {', '.join(wrong[:LISTED])}{more}", path=folder, remedy=remedy)


def beyond(bbox: list[float], width: int, height: int) -> float:
    """Return the pixels that a box reaches beyond its image; at most 0 if it doesn't."""
    x, y, w, h = bbox
    return max(-x, -y, x + w - width, y + h - height)


@dataclass(frozen=True, slots=True)
class LabelFloors:
    """Limits of full labels; fields that a label lacks, such as a photograph's, are ignored.

    Parameters
    ----------
    min_box_px
        Least width and height of its box.
    min_visible_fraction, max_truncated_fraction
        Least visible and largest truncated fraction.
    below
        Labels that show less: ``"ignored"``: they get ``iscrowd`` 1; ``"left_out"``: they're dropped.
    """

    min_box_px: float = 0.0
    min_visible_fraction: float = 0.0
    max_truncated_fraction: float = 1.0
    below: Literal["ignored", "left_out"] = "ignored"

    def kept(self, annotations: Sequence[Record]) -> list[Record]:
        """Return the kept annotations, in order; ignored ones stay ignored, or are dropped with the others."""
        kept: list[Record] = []
        for annotation in annotations:
            below = (
                min(annotation["bbox"][2:]) < self.min_box_px
                or number(annotation.get("visible_fraction")) < self.min_visible_fraction  # nan, if it isn't known
                or number(annotation.get("truncated_fraction")) > self.max_truncated_fraction
            )
            if self.below == "ignored":
                kept.append(changed(annotation, iscrowd=1) if below else annotation)
            elif not below and not annotation.get("iscrowd"):
                kept.append(annotation)
        return kept


ALL_LABELS = LabelFloors()
