"""Training datasets as arrays, checked before training, and their pictures with labels as training draws them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import orjson
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.box_table import BoxTable
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import decode_mask
from hulldown.annotate.records import Label
from hulldown.assets.picture_files import read_picture, read_pixels
from hulldown.base.errors import ConfigError, DatasetError
from hulldown.dataset.images import LabeledImages
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.usable_labels import images_with_clipped_labels
from hulldown.dataset.verification.check_pictures import near_duplicate_pairs, perceptual_hash

CHECK_THREADS = 4  # they check pictures before training


@dataclass(frozen=True, eq=False, slots=True)
class Sample:
    """A picture and its labels."""

    picture: UInt8[np.ndarray, "h w 3"]
    xywh: Float[np.ndarray, "n 4"]  # boxes, pixels
    class_index: Int[np.ndarray, " n"]
    masks: tuple[Bool[np.ndarray, "h w"], ...] = ()  # mask of each box; empty if they are unknown or don't count

    def resized_sample(self, width: int, height: int) -> Sample:
        """Return the sample with each side resized by its own factor."""
        import cv2  # not at the top: pictures are checked without the extra

        was_height, was_width = self.picture.shape[:2]
        if (was_width, was_height) == (width, height):
            return self
        shrinks = width * height < was_width * was_height
        return Sample(
            cv2.resize(self.picture, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR),
            self.xywh * ([width / was_width, height / was_height] * 2),
            self.class_index,
            tuple(
                cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5
                for mask in self.masks
            ),
        )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class LabeledPictures(BoxTable):
    """A dataset's n pictures and m boxes, by the pictures' names; classes are numbered alike in all sources."""

    name: str  # the user's name for it
    folder: Path
    file_names: tuple[str, ...]  # relative to the folder
    sizes: tuple[tuple[int, int], ...]  # width and height of each, pixels
    segmentations: tuple[object, ...]  # COCO's segmentation of each box; None if it has none
    digest: str

    def __len__(self) -> int:
        return len(self.file_names)

    @property
    def has_all_masks(self) -> bool:
        """Whether every box has a mask."""
        return None not in self.segmentations

    def read_sample(self, i: int, *, masks: bool = False) -> Sample:
        """Return picture i with its labels, without masks or with those of all boxes, which must have one."""
        boxes = slice(*np.searchsorted(self.image, [i, i + 1]))
        width, height = self.sizes[i]
        decoded = (decode_mask(segmentation, width, height) for segmentation in self.segmentations[boxes] if masks)
        pixels = read_pixels(self.folder / self.file_names[i], (width, height))
        return Sample(pixels, self.xywh[boxes], self.class_index[boxes], tuple(decoded))


def read_classes_and_sources(
    folders: Mapping[str, str | os.PathLike[str]], *, classes: Sequence[str] | None = None
) -> tuple[tuple[str, ...], tuple[LabeledPictures, ...]]:
    """Read datasets without crowds; return `classes`, or by name those of the first, and each dataset's labels."""
    sources = {name: _read_checked_dataset(Path(folder)) for name, folder in folders.items()}
    known, of = (list(classes), "the detector") if classes is not None else ([], "")
    for name, found in sources.items():
        own = _class_names(found)
        if not of:
            known, of = own, name
        if sorted(own) != sorted(known):
            raise DatasetError(
                f"the classes of {name} are {_join_quoted_names(own)}, those of {of} are {_join_quoted_names(known)}",
                path=Path(folders[name]), remedy="give the same classes the same names in both, and leave none out",
            )  # fmt: skip
    return tuple(known), tuple(_make_source(name, Path(folders[name]), found, known) for name, found in sources.items())


def should_follow_masks(asked: bool | None, sources: Sequence[LabeledPictures]) -> bool:
    """Return whether turned boxes follow masks in all datasets: as `asked`, or if every box has one."""
    lacking = [source.name for source in sources if not source.has_all_masks]
    if asked and lacking:
        raise ConfigError(f"masks = true: {lacking[0]} has boxes without masks", remedy="leave masks out")
    return not lacking if asked is None else asked


@dataclass(frozen=True, eq=False, slots=True)
class CheckedPictures:
    """Hashes of a source's pictures."""

    sha256: str  # SHA-256 of records and pictures
    digests: tuple[bytes, ...]
    # perceptual hash of each picture, see `dataset.verification.check_pictures`
    hashes: tuple[Bool[np.ndarray, "256"] | None, ...]


def hash_source_pictures(
    sources: Sequence[LabeledPictures], *, progress: Callable[[int, int], None] | None = None
) -> dict[str, CheckedPictures]:
    """Read every picture of every source; return their hashes by the source's name."""
    checked, done, total = {}, 0, sum(map(len, sources))
    with ThreadPoolExecutor(CHECK_THREADS) as pool:
        for source in sources:
            found: list[tuple[bytes, Bool[np.ndarray, "256"] | None]] = []
            paths = [source.folder / name for name in source.file_names]
            for one in pool.map(_digest_and_perceptual_hash, paths, source.sizes):
                found.append(one)
                done += 1
                if progress is not None:
                    progress(done, total)
            digests, hashes = zip(*found, strict=True)
            whole = hashlib.sha256(source.digest.encode() + b"".join(digests))
            checked[source.name] = CheckedPictures(whole.hexdigest(), digests, hashes)
    return checked


def describe_shared_pictures(
    first: LabeledPictures, second: LabeledPictures, checked: Mapping[str, CheckedPictures]
) -> list[str]:
    """Describe the near duplicates between two sources."""
    ones, others = checked[first.name], checked[second.name]
    pairs = set(map(tuple, near_duplicate_pairs(ones.hashes, others.hashes).tolist()))
    rows = {digest: i for i, digest in enumerate(ones.digests)}  # pictures without contrast have only this hash
    pairs |= {(rows[digest], j) for j, digest in enumerate(others.digests) if digest in rows}
    return [
        f"{second.file_names[j]} of {second.name} shows the same as {first.file_names[i]} of {first.name}"
        for i, j in sorted(pairs)
    ]


def _digest_and_perceptual_hash(path: Path, size: tuple[int, int]) -> tuple[bytes, Bool[np.ndarray, "256"] | None]:
    picture = read_picture(path, size)
    assert picture.pixels is not None
    return hashlib.sha256(picture.content).digest(), perceptual_hash(picture.pixels)


def _read_checked_dataset(folder: Path) -> LabeledImages:
    found = read_usable_dataset(folder)
    if not found.images:
        raise DatasetError("has no images", path=folder, remedy="name a dataset that has some")
    return replace(found, images=tuple(images_with_clipped_labels(found.images, folder=folder, clip=False)))


def _class_names(found: LabeledImages) -> list[str]:
    return list(dict.fromkeys(category.name for category in found.classes))


def _make_source(name: str, folder: Path, found: LabeledImages, classes: Sequence[str]) -> LabeledPictures:
    images = sorted(found.images, key=lambda image: image.file_name)
    counted = [[label for label in image.labels if not label.crowd] for image in images]
    boxes = [sorted(labels, key=lambda label: label.id) for labels in counted]
    learned = [
        [image.file_name, *image.size, list(map(_learned_label_values, labels))]
        for image, labels in zip(images, boxes, strict=True)
    ]
    return LabeledPictures(
        class_names=tuple(classes),
        image=np.repeat(np.arange(len(images)), [len(labels) for labels in boxes]),
        class_index=np.array([classes.index(label.category) for label in chain(*boxes)], dtype=np.int64),
        xywh=np.array([label.bbox for label in chain(*boxes)], dtype=np.float64).reshape(-1, 4),
        name=name,
        folder=folder,
        file_names=tuple(image.file_name for image in images),
        sizes=tuple(image.size for image in images),
        segmentations=tuple(label.read(VisibleMask).segmentation or None for label in chain(*boxes)),
        digest=hashlib.sha256(orjson.dumps(learned)).hexdigest(),
    )


def _learned_label_values(label: Label) -> list[object]:
    return [label.record["bbox"], label.category, label.read(VisibleMask).segmentation]


def _join_quoted_names(names: Sequence[str]) -> str:
    return ", ".join(repr(name) for name in sorted(names)) or "none"
