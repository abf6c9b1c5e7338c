"""Labels that can be used: boxes inside their images, of which enough shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from msgspec import Struct

from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import run_lengths
from hulldown.annotate.record_fields import MAX_BOX_OVERHANG_PX, TEXT_ROUNDING_PX
from hulldown.annotate.records import Image, Label, box_overhang_px
from hulldown.base.arguments import AtLeastZero, Share
from hulldown.base.errors import DatasetError

MAX_LISTED_BOXES = 10  # in an error
MIN_LARGEST_SIDE_PX = 2.0  # if no box has a longer side, boxes are in other units


class _CvatAttributes(Struct):
    rotation: float = 0.0  # degrees


class _CvatLabel(Struct):
    attributes: _CvatAttributes | None = None


def misread_boxes(images: Iterable[Image]) -> Iterator[tuple[str, str]]:
    """Find signs that boxes aren't what their author drew, each with its remedy."""
    labels = [label for image in images for label in image.labels if not label.crowd]
    upright = [label for label in labels if label.record.get("segmentation") or not _is_turned(label)]
    if lost := len(labels) - len(upright):
        remedy = "export them from CVAT as Ultralytics YOLO Oriented Bounding Boxes, or set bbox and delete rotation"
        yield f"{lost} boxes are CVAT's rotated rectangles without their rotation (attributes.rotation)", remedy
    if labels and max(label.bbox[2:].max() for label in labels) < MIN_LARGEST_SIDE_PX:
        remedy = "if boxes are shares of their pictures, multiply them by width and height"
        yield f"no box is {MIN_LARGEST_SIDE_PX:.0f} px wide or high", remedy


def _is_turned(label: Label) -> bool:
    attributes = label.read(_CvatLabel).attributes
    return attributes is not None and attributes.rotation % 180.0 != 0.0


def images_with_clipped_labels(images: Sequence[Image], *, folder: Path, clip: bool) -> list[Image]:
    """Return images whose boxes lie inside; without `clip`, only overhangs of `MAX_BOX_OVERHANG_PX` are cut."""
    for problem, remedy in misread_boxes(images):
        raise DatasetError(problem, path=folder, remedy=remedy)
    found: list[Image] = []
    wrong, wrong_masks = list[str](), list[str]()
    further = False
    for image in images:
        kept: list[Label] = []
        for label in image.labels:
            x, y, w, h = label.bbox.tolist()
            where = f"{image.file_name}: annotation {label.id}"
            if mask := label.read(VisibleMask).segmentation:
                try:
                    run_lengths(mask, *image.size)
                except ValueError as error:
                    wrong_masks.append(f"{where}: {error}")
            by = box_overhang_px(label.bbox, *image.size)
            if w <= 0 or h <= 0:
                wrong.append(f"{where} has no area")
            elif by <= TEXT_ROUNDING_PX:
                kept.append(label)
            elif not clip and by > MAX_BOX_OVERHANG_PX:
                further = True
                wrong.append(f"{where} leaves its image by {by:.4g} px")
            else:
                left, top = max(x, 0.0), max(y, 0.0)
                box = [left, top, min(x + w, image.width) - left, min(y + h, image.height) - top]
                if box[2] > 0 and box[3] > 0:
                    kept.append(label.with_fields(bbox=box))
                elif not clip:
                    wrong.append(f"{where} has no area inside its image")
        found.append(image.with_labels(kept))
    corrected = "write width and height, not right and bottom, or clip them with `hulldown export --clip`"
    remedy = corrected if further else "correct or delete them"
    refuse_listed_problems(wrong, "box", folder, remedy=remedy)
    refuse_listed_problems(wrong_masks, "mask", folder)
    return found


def refuse_listed_problems(wrong: Sequence[str], what: str, folder: Path, *, remedy: str = "correct or delete them") -> None:
    """Raise one error that lists all problems, at most `MAX_LISTED_BOXES`, if there are any."""
    if wrong:
        more = (
            f", and {len(wrong) - MAX_LISTED_BOXES} more; `hulldown verify` lists all" if len(wrong) > MAX_LISTED_BOXES else ""
        )
        several = {"box": "boxes"}.get(what, f"{what}s")
        counted = f"1 {what}" if len(wrong) == 1 else f"{len(wrong)} {several}"
        raise DatasetError(f"{counted} cannot be used: {', '.join(wrong[:MAX_LISTED_BOXES])}{more}", path=folder, remedy=remedy)


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class LabelFloors:
    """Limits of full labels; fields that a label lacks, such as a photograph's, are ignored.

    Parameters
    ----------
    min_box_px
        Least side of a label's box.
    min_visible_fraction
        Least visible fraction of a label.
    max_truncated_fraction
        Largest truncated fraction of a label.
    below
        Labels beyond these limits get iscrowd = 1, or are left out, as always in yolo.
    """

    min_box_px: AtLeastZero = 0.0
    min_visible_fraction: Share = 0.0
    max_truncated_fraction: Share = 1.0
    below: Annotated[Literal["ignored", "left_out"], Parameter(name_transform=str)] = "ignored"

    def kept_labels(self, labels: Iterable[Label]) -> list[Label]:
        """Return the kept labels, in order; ignored ones stay ignored, or are dropped with the others."""
        kept: list[Label] = []
        for label in labels:
            below = (
                min(label.bbox[2:]) < self.min_box_px
                or label.visible_fraction < self.min_visible_fraction  # nan, if it isn't known
                or label.truncated_fraction > self.max_truncated_fraction
            )
            if self.below == "ignored":
                kept.append(label.with_fields(iscrowd=1) if below else label)
            elif not below and not label.crowd:
                kept.append(label)
        return kept


ALL_LABELS = LabelFloors()
