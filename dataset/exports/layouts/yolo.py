"""Labels for YOLO readers: one text line per label, in shares of the image.

Ultralytics documentation, "Object detection datasets", "Instance segmentation datasets", and "Oriented bounding box
datasets".
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from hulldown.annotate.labels.keypoints import Keypoints
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.labels.oriented_box import visible_rectangle_corners
from hulldown.annotate.outlines import bridge_rings
from hulldown.annotate.records import Label
from hulldown.base.errors import DatasetError
from hulldown.dataset.exports.layouts.splits import COMMON_SPLIT_NAMES, ExportedImage, Splits, label_rings

MakeLabelLines: TypeAlias = Callable[[ExportedImage, Mapping[int, int]], list[str]]


def box_or_polygon_lines(item: ExportedImage, numbers: Mapping[int, int]) -> list[str]:
    """Return a line for each label but crowds, in shares: a box, or polygons for all if any label has one."""
    labels = [label for label in item.image.labels if not label.crowd]
    masks = [label.read(VisibleMask).segmentation for label in labels]
    if any(isinstance(mask, list) and mask for mask in masks):
        corners = [bridge_rings([np.reshape(ring, (-1, 2)) for ring in label_rings(label)]) for label in labels]
        shares = [(each / item.image.size).ravel() for each in corners]
    else:
        shares = [_center_and_size_shares(label, item.image.size) for label in labels]
    return [_class_and_shares_line(numbers[label.category_id], each) for label, each in zip(labels, shares, strict=True)]


def _center_and_size_shares(label: Label, size: tuple[int, int]) -> Float[np.ndarray, "4"]:
    (x, y, w, h), (width, height) = label.bbox, size
    return np.array([(x + w / 2) / width, (y + h / 2) / height, w / width, h / height])


def oriented_box_lines(item: ExportedImage, numbers: Mapping[int, int]) -> list[str]:
    """Return one line for each label: class and corners of its oriented box; crowds are left out."""
    lines = []
    for label in item.image.labels:
        if not label.crowd:
            shares = visible_rectangle_corners(label, item.image) / item.image.size
            if (np.ptp(shares, axis=0) > 1.0).any():  # Ultralytics leaves out pictures with labels larger than they
                shares = shares.clip(0.0, 1.0)
            lines.append(_class_and_shares_line(numbers[label.category_id], shares.ravel()))
    return lines


def _class_and_shares_line(number: int, shares: Float[np.ndarray, " n"]) -> str:
    # Nine digits: a millionth of a pixel of any image.
    return " ".join([str(number), *(f"{n:.9f}" for n in shares)])


def write_yolo(
    splits: Splits,
    out: Path,
    *,
    lines: MakeLabelLines = box_or_polygon_lines,
    split_first: bool = False,
    more: Sequence[str] = (),
) -> None:
    """Write ``images/train``, ``labels/train``, and so on, as Ultralytics reads them."""
    numbers = {category.id: number for number, category in enumerate(splits.categories)}
    folders = {}
    for split, items in splits:
        pictures, texts = (Path(split, kind) if split_first else Path(kind, split) for kind in ("images", "labels"))
        folders[split] = pictures
        (out / pictures).mkdir(parents=True)
        (out / texts).mkdir(parents=True)
        for item in items:
            item.link(out / pictures)
            text = "".join(f"{line}\n" for line in lines(item, numbers))
            (out / texts / f"{item.stem}.txt").write_text(text, encoding="utf-8")
    data = [f"{COMMON_SPLIT_NAMES[split]}: {pictures.as_posix()}" for split, pictures in folders.items()]
    # Every JSON string is a YAML string.
    names = [json.dumps(category.name) for category in splits.categories]
    data += [*more, "names:", *(f"  {number}: {name}" for number, name in enumerate(names))]
    (out / "data.yaml").write_text("\n".join(data) + "\n", encoding="utf-8")


def write_yolo_pose(splits: Splits, out: Path) -> None:
    """Write ``images/train`` and so on, with boxes and keypoints: x, y, and COCO's v of each."""
    lists = [category.keypoints for category in splits.categories]
    if not lists or not (names := lists[0]) or any(each != names for each in lists):
        problem = "its categories have no keypoints" if not any(lists) else "its categories have different keypoints"
        raise DatasetError(problem, path=splits.folder, remedy="plan with annotate.keypoints, or export as coco")
    swapped = [re.sub("left|right", lambda side: {"left": "right", "right": "left"}[side[0]], name) for name in names]
    mirrored = [names.index(partner) if partner in names else i for i, partner in enumerate(swapped)]
    more = [f"kpt_shape: [{len(names)}, 3]", f"flip_idx: {mirrored}"]
    write_yolo(splits, out, lines=partial(_keypoint_lines, keypoints=len(names)), more=more)


def _keypoint_lines(item: ExportedImage, numbers: Mapping[int, int], *, keypoints: int) -> list[str]:
    lines = []
    for label in item.image.labels:
        if not label.crowd:
            points = np.reshape(label.read(Keypoints).keypoints or np.zeros(3 * keypoints), (-1, 3))
            shares = " ".join(f"{x:.9f} {y:.9f} {v:.0f}" for x, y, v in points / [*item.image.size, 1])
            box = _center_and_size_shares(label, item.image.size)
            lines.append(f"{_class_and_shares_line(numbers[label.category_id], box)} {shares}")
    return lines
