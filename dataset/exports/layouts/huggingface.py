"""Hugging Face's image folder: pictures and ``metadata.jsonl``, for ``load_dataset("imagefolder", data_dir=...)``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import orjson

from hulldown.annotate.labels.mask import VisibleMask, label_area
from hulldown.annotate.records import Label
from hulldown.dataset.exports.layouts.splits import Splits, label_rings

SPLIT_FOLDERS = {"train": "train", "valid": "validation", "test": "test"}


def write_huggingface(splits: Splits, out: Path) -> None:
    """Write ``train``, ``validation`` and ``test``, each with its pictures and ``metadata.jsonl``."""
    labels = [label for items in splits.items.values() for item in items for label in item.image.labels]
    outlined = any(isinstance(label.read(VisibleMask).segmentation, list) for label in labels)
    for split, items in splits:
        folder = out / SPLIT_FOLDERS[split]
        folder.mkdir()
        with (folder / "metadata.jsonl").open("wb") as lines:
            for item in items:
                item.link(folder)
                record = {
                    **{"file_name": item.name, "image_id": item.image.id},
                    **{"width": item.image.width, "height": item.image.height},
                    "objects": _object_columns(item.image.labels, outlined),
                }
                lines.write(orjson.dumps(record) + b"\n")


def _object_columns(labels: Sequence[Label], outlined: bool) -> dict[str, object]:
    columns: dict[str, object] = {
        "id": [label.id for label in labels],
        "area": [label_area(label) for label in labels],
        "bbox": [label.bbox.tolist() for label in labels],
        "category": [label.category for label in labels],
        "iscrowd": [int(label.crowd) for label in labels],
    }
    if outlined:
        columns["segmentation"] = [label_rings(label) for label in labels]
    return columns
