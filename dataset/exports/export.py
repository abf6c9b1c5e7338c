"""Write a dataset as folders for training tools, split into train, valid, and test."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import orjson
from cyclopts import Parameter

from hulldown.annotate import outlines
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.records import Label
from hulldown.base.arguments import FROM_ZERO, AnyPath, make_option_parser
from hulldown.base.errors import DatasetError
from hulldown.base.outputs import DONE_NAME, OutputFolder
from hulldown.base.terminal import print_message, progress_bar
from hulldown.dataset.exports.layouts import coco_folders, huggingface, kitti, voc, yolo
from hulldown.dataset.exports.layouts.splits import ExportedImage, Splits, checked_paths_and_hashes, unique_flat_file_names
from hulldown.dataset.exports.split import SPLIT_NAMES, split_name_by_image_id
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.usable_labels import ALL_LABELS, LabelFloors, images_with_clipped_labels

# The function that writes each layout into an existing folder; docs/exports.md lists their readers.
LAYOUTS: Mapping[str, Callable[[Splits, Path], None]] = {
    "coco": coco_folders.write_coco_folders,
    "yolo": yolo.write_yolo,
    "rfdetr-yolo": partial(yolo.write_yolo, split_first=True),
    "yolo-obb": partial(yolo.write_yolo, lines=yolo.oriented_box_lines),
    "yolo-pose": yolo.write_yolo_pose,
    "voc": voc.write_voc,
    "kitti": kitti.write_kitti,
    "huggingface": huggingface.write_huggingface,
}
WITH_POLYGONS = ("coco", "yolo", "rfdetr-yolo", "huggingface")
POLYGONS_WITHIN_PX = 0.3


def _parse_split_shares(text: str) -> tuple[float, float, float]:
    train, valid, test = map(float, text.split(","))
    if not (min(train, valid, test) >= 0 and abs(train + valid + test - 1.0) <= 1e-6):
        raise ValueError(text)
    return train, valid, test


SPLIT_PARSER = make_option_parser("three shares that add up to 1, such as 0.7,0.2,0.1", _parse_split_shares, metavar="A,B,C")


def export_dataset(
    dataset: AnyPath,
    output: AnyPath,
    *,
    layout: Annotated[str, Parameter(name="--format", choices=tuple(LAYOUTS))] = "coco",
    fractions: Annotated[tuple[float, float, float], SPLIT_PARSER, Parameter(name="--split")] = (0.7, 0.2, 0.1),
    polygons: Annotated[float | bool, FROM_ZERO] = False,
    floors: LabelFloors = ALL_LABELS,
    clip: bool = False,
    allow_links: Sequence[AnyPath] = (),
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, int]:
    """Split a dataset for training.

    Reads a dataset; writes train, valid, and test, in which shots of one position stay together. Images are hard links
    if the disk allows, else copies.

    Parameters
    ----------
    dataset
        The folder of a COCO dataset.
    output
        A folder that does not exist or is empty.
    layout
        The layout of folders and labels; docs/exports.md lists their readers.
    fractions
        Shares of train, valid, and test; the split doesn't depend on the limits of labels.
    polygons
        Write masks as polygons without corners that move the outline by at most this many pixels, 0.3 if it's only
        switched on. Else masks are unchanged, or left out if the layout has only polygons.
    floors
        Limits of full labels; by default all labels are kept.
    clip
        Clip boxes that leave their image by more than a pixel too, and drop those outside.
    allow_links
        Folder outside the dataset that symbolic links may lead to; may be repeated.
    progress
        Called with (done, all) after each image; None: a bar in a terminal or notebook.

    Returns
    -------
    Images in each split.

    Raises
    ------
    DatasetError
        If the dataset can't be read, pictures are missing, damaged, of another size, or links that lead elsewhere,
        masks or boxes are unusable, the layout has no polygons, or `output` isn't empty or can't be written.
        `output` is empty then.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from PIL import Image
    >>> from hulldown.dataset.coco import CocoDataset
    >>> folder, out = Path(mkdtemp()), Path(mkdtemp())
    >>> with CocoDataset.open(folder, categories=["truck"]) as dataset:
    ...     Image.new("RGB", (64, 48)).save(folder / "1.png")
    ...     _ = dataset.append({"file_name": "1.png", "width": 64, "height": 48}, [])
    >>> export_dataset(folder, out, layout="yolo", fractions=(1.0, 0.0, 0.0))
    {'train': 1, 'valid': 0, 'test': 0}
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout: expected one of {', '.join(LAYOUTS)}, got {layout!r}")
    if polygons is not False and layout not in WITH_POLYGONS:
        raise DatasetError(f"layout {layout} has no polygons", remedy=f"these have: {', '.join(WITH_POLYGONS)}")
    folder, out = Path(dataset), Path(output)
    within = POLYGONS_WITHIN_PX if polygons is True else float(polygons)
    allowed = [Path(each) for each in allow_links]
    document = read_usable_dataset(folder, allowed)
    images = images_with_clipped_labels(document.images, folder=folder, clip=clip)
    split_of = split_name_by_image_id(images, fractions=fractions)
    pictures = checked_paths_and_hashes(folder, images, allowed)
    items: dict[str, list[ExportedImage]] = {split: [] for split in SPLIT_NAMES}
    for image, name, (picture, digest) in zip(images, unique_flat_file_names(images), pictures, strict=True):
        kept = floors.kept_labels(image.labels)
        if polygons is not False:
            kept = [_label_with_polygons(label, image.size, within) for label in kept]
        items[split_of[image.id]].append(ExportedImage(image.with_labels(kept), name, picture, digest))
    categories = document.classes  # numbered as in training
    counts = {split: len(of_split) for split, of_split in items.items()}
    splits = Splits(folder, document.head, categories, items)
    key = _export_key(layout, splits)
    with OutputFolder(out, "export", [DONE_NAME], inputs=[folder]) as target:
        if target.finish_earlier_run(key):
            print_message(f"{out}: is complete already")
            return counts
        with progress_bar("linking images", progress) as advance, target.stage_content(key) as unfinished:
            LAYOUTS[layout](replace(splits, progress=advance), unfinished)
    return counts


def _export_key(layout: str, splits: Splits) -> str:
    key = hashlib.sha256(orjson.dumps([layout, splits.coco_head]))
    for split, of_split in splits.items.items():
        for item in of_split:
            labels = [label.record for label in item.image.labels]
            key.update(orjson.dumps([split, item.image.record, labels, item.name, item.sha256]))
    return key.hexdigest()


def _label_with_polygons(label: Label, size: tuple[int, int], within: float) -> Label:
    """Return a label with its mask as polygons; crowds keep run lengths, as COCO's readers expect."""
    if label.crowd or not (mask := label.read(VisibleMask).segmentation):
        return label
    return label.with_fields(segmentation=outlines.mask_polygons(mask, *size, within=within))
