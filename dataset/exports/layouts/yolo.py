"""Labels as YOLO readers have them: one text line a label, in shares of the image.

References
----------
Ultralytics documentation, "Object detection datasets" and "Instance segmentation datasets".
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.annotate.outlines import bridged
from hulldown.dataset.exports.shares import Shares, rings_of


def write(shares: Shares, out: Path) -> None:
    """Write ``images/train``, ``labels/train`` and so on, as Ultralytics has it."""
    folders = {split: (Path("images", split), Path("labels", split)) for split, _ in shares}
    _write(shares, out, folders)


def write_for_rfdetr(shares: Shares, out: Path) -> None:
    """Write ``train/images``, ``train/labels`` and so on, as RF-DETR and Roboflow have it."""
    folders = {split: (Path(split, "images"), Path(split, "labels")) for split, _ in shares}
    _write(shares, out, folders)


def label_lines(
    annotations: Sequence[Mapping[str, Any]], numbers: Mapping[int, int], width: int, height: int
) -> list[str]:
    """One line for each label, in shares of the image; crowds are left out, as YOLO has none.

    Class, centre and size of its box; or, where a label has polygons, class and corners for all of them, since readers
    take a file for one or the other. Several polygons are bridged into one.
    """
    labels = [annotation for annotation in annotations if not annotation.get("iscrowd")]
    outlined = any(isinstance(label.get("segmentation"), list) and label["segmentation"] for label in labels)
    lines = []
    for label in labels:
        x, y, w, h = label["bbox"]
        if outlined:
            corners = bridged([np.reshape(ring, (-1, 2)) for ring in rings_of(label)])
            numbers_of_label = (corners / [width, height]).ravel()
        else:
            numbers_of_label = np.array([(x + w / 2) / width, (y + h / 2) / height, w / width, h / height])
        # Nine digits: a millionth of a pixel of any image.
        lines.append(" ".join([str(numbers[label["category_id"]]), *(f"{n:.9f}" for n in numbers_of_label)]))
    return lines


def _write(shares: Shares, out: Path, folders: Mapping[str, tuple[Path, Path]]) -> None:
    numbers = shares.class_numbers
    for split, items in shares:
        pictures, texts = (out / folder for folder in folders[split])
        pictures.mkdir(parents=True)
        texts.mkdir(parents=True)
        for item in items:
            item.link(pictures)
            lines = label_lines(item.labels, numbers, item.image["width"], item.image["height"])
            (texts / f"{item.stem}.txt").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    key = {"train": "train", "valid": "val", "test": "test"}
    data = [f"{key[split]}: {pictures.as_posix()}" for split, (pictures, _) in folders.items()]
    # JSON strings are YAML strings, whatever is in them.
    names = [json.dumps(shares.class_names[category["id"]]) for category in shares.categories]
    data += ["names:", *(f"  {number}: {name}" for number, name in enumerate(names))]
    (out / "data.yaml").write_text("\n".join(data) + "\n", encoding="utf-8")
