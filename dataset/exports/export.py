"""Write a dataset as folders for training tools, split into train, valid, and test."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import orjson

from hulldown.annotate.masks import extent
from hulldown.annotate.outlines import polygons
from hulldown.base.errors import DatasetError
from hulldown.base.files import all_or_nothing, is_done
from hulldown.base.terminal import reporting, say
from hulldown.dataset.exports.layouts import coco_folders, huggingface, kitti, voc, yolo
from hulldown.dataset.exports.layouts.splits import Item, Splits, flat_names, sound_pictures
from hulldown.dataset.exports.split import SPLITS, share_out
from hulldown.dataset.images import Image, Label
from hulldown.dataset.labels.mask import MASK
from hulldown.dataset.records import read_usable
from hulldown.dataset.usable_labels import ALL_LABELS, LabelFloors, clipped, refuse_all

# The function that writes each layout into an existing folder; docs/exports.md lists their readers.
LAYOUTS: Mapping[str, Callable[[Splits, Path], None]] = {
    "coco": coco_folders.write,
    "yolo": yolo.write,
    "rfdetr-yolo": partial(yolo.write, split_first=True),
    "yolo-obb": partial(yolo.write, lines=yolo.corner_lines),
    "yolo-pose": yolo.write_pose,
    "voc": voc.write,
    "kitti": kitti.write,
    "huggingface": huggingface.write,
}
WITH_POLYGONS = ("coco", "yolo", "rfdetr-yolo", "huggingface")


def export(
    dataset: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    layout: str = "coco",
    fractions: tuple[float, float, float] = (0.7, 0.2, 0.1),
    polygons_within: float | None = None,
    floors: LabelFloors = ALL_LABELS,
    clip: bool = False,
    allow_links: Sequence[Path | str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, int]:
    """Write a dataset as train, valid, and test; images are hard links if the disk allows, else copies.

    Parameters
    ----------
    dataset
        The folder of a COCO dataset.
    out
        A folder that does not exist or is empty.
    layout
        One of `LAYOUTS`.
    fractions
        See `dataset.exports.split.share_out`; the split does not depend on the floors.
    polygons_within
        Write masks as polygons without corners that move the outline by at most this many pixels; None: unchanged,
        or no masks if the layout has only polygons.
    floors
        Limits of full labels; by default all labels are kept.
    clip
        Clip boxes that leave their image, and drop those outside.
    allow_links
        Folders outside the dataset that symbolic links may lead to.
    progress
        Called with (done, all) after each image; None: a bar in a terminal or notebook.

    Returns
    -------
    Images in each split.

    Raises
    ------
    DatasetError
        If the dataset can't be read, pictures are missing, damaged, of another size, or links that lead elsewhere,
        masks or boxes are unusable, the layout has no polygons, or `out` isn't empty or can't be written.
        `out` is empty then.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from PIL import Image
    >>> from hulldown.dataset.coco import CocoDataset
    >>> folder, out = Path(mkdtemp()), Path(mkdtemp())
    >>> with CocoDataset.open(folder, categories=["truck"]) as dataset:
    ...     Image.new("RGB", (64, 48)).save(folder / "1.png")
    ...     _ = dataset.append({"file_name": "1.png", "width": 64, "height": 48}, [])
    >>> export(folder, out, layout="yolo", fractions=(1.0, 0.0, 0.0))
    {'train': 1, 'valid': 0, 'test': 0}
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout: expected one of {', '.join(LAYOUTS)}, got {layout!r}")
    if polygons_within is not None and layout not in WITH_POLYGONS:
        raise DatasetError(f"layout {layout} has no polygons", remedy=f"these have: {', '.join(WITH_POLYGONS)}")
    folder = Path(dataset)
    document = read_usable(folder)
    images = clipped(document.images, folder=folder, clip=clip)
    split_of = share_out(images, fractions=fractions)
    _check_masks(images, folder)
    pictures = sound_pictures(folder, images, [Path(each) for each in allow_links])
    items: dict[str, list[Item]] = {split: [] for split in SPLITS}
    for image, name, picture in zip(images, flat_names(images), pictures, strict=True):
        kept = floors.kept(image.labels)
        if polygons_within is not None:
            kept = [_outlined(label, image.size, polygons_within) for label in kept]
        items[split_of[image.id]].append(Item(image.labeled(kept), name, picture))
    categories = document.classes  # numbered as in training
    counts = {split: len(of_split) for split, of_split in items.items()}
    splits = Splits(folder, document.head, categories, items)
    key = _key(layout, splits)
    if is_done(Path(out), key):
        say(f"{out}: is complete already")
        return counts
    with reporting("linking images", progress) as advance, all_or_nothing(Path(out), key) as unfinished:
        LAYOUTS[layout](replace(splits, progress=advance), unfinished)
    return counts


def _key(layout: str, splits: Splits) -> str:
    """Return a hash of everything that determines an export, besides the content of pictures without a hash."""
    key = hashlib.sha256(orjson.dumps([layout, splits.coco_head]))
    for split, of_split in splits.items.items():
        for item in of_split:
            labels = [label.record for label in item.image.labels]
            key.update(orjson.dumps([split, item.image.record, labels, item.name]))
    return key.hexdigest()


def _check_masks(images: Sequence[Image], folder: Path) -> None:
    """Refuse unusable masks."""
    wrong = []
    for image in images:
        for label in image.labels:
            if mask := MASK.read(label).segmentation:
                try:
                    extent(mask, *image.size)
                except ValueError as error:
                    wrong.append(f"annotation {label.id}: {error}")
    refuse_all(wrong, "mask", folder)


def _outlined(label: Label, size: tuple[int, int], within: float) -> Label:
    """Return a label with its mask as polygons; crowds keep run lengths, as COCO's readers expect."""
    if label.crowd or not (mask := MASK.read(label).segmentation):
        return label
    return label.changed(segmentation=polygons(mask, *size, within=within))
