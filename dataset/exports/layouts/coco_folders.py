"""COCO as RF-DETR and Roboflow read it: ``train/_annotations.coco.json`` next to the pictures."""

from __future__ import annotations

from pathlib import Path

import orjson

from hulldown.annotate.coco_types import Record
from hulldown.dataset.exports.layouts.splits import Splits
from hulldown.dataset.store.document import COCO_NAME


def write_coco_folders(splits: Splits, out: Path) -> None:
    """Write ``train``, ``valid`` and ``test``, each with its pictures and records."""
    for split, items in splits:
        folder = out / split
        folder.mkdir()
        images: list[Record] = []
        labels: list[Record] = []
        for item in items:
            item.link(folder)
            images.append({**item.image.record, "file_name": item.name})
            labels += [label.record for label in item.image.labels]
        part = {**splits.coco_head, "images": images, "annotations": labels}
        (folder / COCO_NAME).write_bytes(orjson.dumps(part))
