"""Labels that can be used: boxes inside their images, of which enough shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from hulldown.annotate.record_fields import MAX_BOX_OVERHANG_PX, TEXT_ROUNDING_PX
from hulldown.annotate.records import Image, Label, overhang_px
from hulldown.base.arguments import AtLeastZero, Share
from hulldown.base.errors import DatasetError

MAX_LISTED_BOXES = 10  # in an error


def clip_labels(images: Iterable[Image], *, folder: Path, clip: bool) -> list[Image]:
    """Clip boxes to their images; without `clip`, only overhangs of at most `MAX_BOX_OVERHANG_PX`."""
    found: list[Image] = []
    wrong: list[str] = []
    further = False
    for image in images:
        kept: list[Label] = []
        for label in image.labels:
            x, y, w, h = label.bbox.tolist()
            where = f"{image.file_name}: annotation {label.id}"
            by = overhang_px(label.bbox, *image.size)
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
                    kept.append(label.changed(bbox=box))
                elif not clip:
                    wrong.append(f"{where} has no area inside its image")
        found.append(image.labeled(kept))
    remedy = "correct them, or clip them with `hulldown export --clip`" if further else "correct or delete them"
    refuse_all(wrong, "box", folder, remedy=remedy)
    return found


def refuse_all(wrong: Sequence[str], what: str, folder: Path, *, remedy: str = "correct or delete them") -> None:
    """Raise one error that lists all problems, up to `MAX_LISTED_BOXES`, if there are any."""
    if wrong:
        more = (
            f", and {len(wrong) - MAX_LISTED_BOXES} more; `hulldown verify` lists all"
            if len(wrong) > MAX_LISTED_BOXES
            else ""
        )
        several = {"box": "boxes"}.get(what, f"{what}s")
        counted = f"1 {what}" if len(wrong) == 1 else f"{len(wrong)} {several}"
        raise DatasetError(
            f"{counted} cannot be used: {', '.join(wrong[:MAX_LISTED_BOXES])}{more}", path=folder, remedy=remedy
        )


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
                kept.append(label.changed(iscrowd=1) if below else label)
            elif not below and not label.crowd:
                kept.append(label)
        return kept


ALL_LABELS = LabelFloors()
