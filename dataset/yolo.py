"""Labels as Ultralytics' YOLO reads them: one text line a box, in shares of the image."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def class_numbers(categories: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    """Category id -> number from 0, in the order of the ids."""
    return {category_id: number for number, category_id in enumerate(sorted(c["id"] for c in categories))}


def label_lines(
    annotations: Sequence[Mapping[str, Any]], numbers: Mapping[int, int], width: int, height: int
) -> list[str]:
    """One line for each box: class, centre and size, in shares of the image; crowds are left out."""
    lines = []
    for annotation in annotations:
        if annotation.get("iscrowd"):
            continue
        x, y, w, h = annotation["bbox"]
        numbers_of_box = ((x + w / 2) / width, (y + h / 2) / height, w / width, h / height)
        # Nine digits: a millionth of a pixel of any image.
        lines.append(" ".join([str(numbers[annotation["category_id"]]), *(f"{n:.9f}" for n in numbers_of_box)]))
    return lines


def write_data_file(path: Path, categories: Sequence[Mapping[str, Any]], splits: Sequence[str]) -> None:
    """The ``data.yaml`` that names folders and classes."""
    numbers = class_numbers(categories)
    key = {"train": "train", "valid": "val", "test": "test"}
    lines = [f"{key[split]}: images/{split}" for split in splits]
    # JSON strings are YAML strings, whatever is in them.
    names = {numbers[c["id"]]: json.dumps(str(c["name"])) for c in categories}
    lines += ["names:", *(f"  {number}: {names[number]}" for number in sorted(names))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
