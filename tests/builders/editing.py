"""Datasets made here and elsewhere, and edits by hand as their owner might make them."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.dataset.coco import CocoDataset

PLAN = "a" * 64  # the key of a plan


def write_dataset(
    folder: Path,
    images: Iterable[Mapping],
    labels: Iterable[Mapping] = (),
    *,
    names: Sequence[str] = ("tank",),
    pictures: bool = True,
) -> Path:
    """Write records with ids from 1, 32 x 24 pixels, and the first class unless stated, and plain missing pictures."""
    coco = {
        "images": [{"id": i, "width": 32, "height": 24, **image} for i, image in enumerate(images, start=1)],
        "annotations": [{"id": k, "category_id": 1, **label} for k, label in enumerate(labels, start=1)],
        "categories": [{"id": number, "name": name} for number, name in enumerate(names, start=1)],
    }
    folder.mkdir(parents=True, exist_ok=True)
    for image in coco["images"] if pictures else ():
        path = folder / image["file_name"]
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            Image.new("RGB", (image["width"], image["height"]), (37 * image["id"] % 256, 90, 60)).save(path)
    (folder / "annotations.json").write_text(json.dumps(coco))
    return folder


def append(
    dataset: CocoDataset, name: str, picture: Image.Image, labels: Sequence[Mapping], *, hashed: bool = False, **more: Any
) -> None:
    """Save a picture in an open dataset, and append it with its labels and further fields."""
    path = dataset.folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)
    known = {PICTURE_HASH_KEY: hashlib.sha256(path.read_bytes()).hexdigest()} if hashed else {}
    dataset.append({"file_name": name, "width": picture.width, "height": picture.height, **known, **more}, labels)


def render(folder: Path, indices: Iterable[int], *, key: str = PLAN, hashed: bool = False) -> Path:
    """Add these images of a plan of six, with two annotations each, to a dataset."""
    with CocoDataset.open(folder, categories=["tank", "truck"]) as dataset:
        run = dataset.reserve_ids(key, images=6, annotations=12)
        for i in indices:
            labels = [{"id": run.annotation_offset + 2 * i + k, "category": "tank", "bbox": [0, 0, k, 3.5]} for k in (1, 2)]
            name, picture = run.dataset_file_name(f"images/{i + 1:08d}.png"), Image.new("RGB", (8, 6), (i, ord(key[0]), 7))
            append(dataset, name, picture, labels, hashed=hashed, id=run.image_offset + i + 1, shot=i)
    return folder


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Apply a function to the records of a dataset."""
    path = folder / "annotations.json"
    coco = json.loads(path.read_text())
    change(coco)
    path.write_text(json.dumps(coco))
