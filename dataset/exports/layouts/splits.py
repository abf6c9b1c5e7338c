"""A dataset divided into splits, the input of every export layout."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath

from hulldown.annotate.coco_types import Record
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.annotate.records import Category, Image, Label
from hulldown.assets.picture_files import DECODER_THREADS, read_picture
from hulldown.base.errors import DatasetError
from hulldown.base.outside import file_sha256
from hulldown.dataset.store.placed_pictures import link_or_copy_file, resolve_own_picture
from hulldown.dataset.usable_labels import refuse_listed_problems

COMMON_SPLIT_NAMES = {"train": "train", "valid": "val", "test": "test"}  # most layouts call the splits so


@dataclass(frozen=True, eq=False, slots=True)
class ExportedImage:
    """An image of a dataset, and its picture in the export."""

    image: Image  # the image in the dataset, with the labels that are kept
    name: str  # name of its picture in the export: without folders, with a unique stem
    picture: Path  # the picture's file, links resolved
    sha256: str  # hash of the picture's file

    @property
    def stem(self) -> str:
        """The name without its suffix."""
        return PurePosixPath(self.name).stem

    def link(self, folder: Path, name: str | None = None) -> None:
        """Link or copy the picture into a folder, under its name or another."""
        link_or_copy_file(self.picture, folder / (name or self.name))


@dataclass(frozen=True, eq=False, slots=True)
class Splits:
    """A dataset divided into splits."""

    folder: Path
    head: Record  # its COCO dictionary without classes, images, and annotations
    categories: Sequence[Category]  # its classes in the order of their ids
    items: Mapping[str, Sequence[ExportedImage]]  # the images of each of `SPLIT_NAMES`, in the order of the dataset
    progress: Callable[[int, int], None] = lambda done, total: None  # called with (done, all) after each image

    def __iter__(self) -> Iterator[tuple[str, Iterator[ExportedImage]]]:
        done = count(1)
        for split, items in self.items.items():
            yield split, self._items_with_progress(items, done)

    @property
    def coco_head(self) -> dict[str, object]:
        """The COCO dictionary without images and annotations."""
        return {**self.head, "categories": [category.record for category in self.categories]}

    def _items_with_progress(self, items: Sequence[ExportedImage], done: Iterator[int]) -> Iterator[ExportedImage]:
        for item in items:
            yield item
            self.progress(next(done), sum(map(len, self.items.values())))


def checked_paths_and_hashes(folder: Path, images: Sequence[Image], allowed: Sequence[Path]) -> list[tuple[Path, str]]:
    """Return each picture's file, links resolved, and hash; a file with the hash in its record isn't decoded."""

    def checked(image: Image) -> tuple[Path, str] | str:
        name = image.file_name
        try:
            path = resolve_own_picture(folder, name, allowed)
            digest = file_sha256(path)
            read_picture(path, image.size, largest=0 if digest == image.record.get(PICTURE_HASH_KEY) else None)
        except DatasetError as error:
            return f"{name} {error.problem}"
        except OSError as error:
            return f"{name} cannot be read ({error.strerror})"
        return path, digest

    with ThreadPoolExecutor(DECODER_THREADS) as pool:
        found = list(pool.map(checked, images))
    wrong = [problem for problem in found if isinstance(problem, str)]
    refuse_listed_problems(wrong, "picture", folder, remedy="replace them or delete their records")
    return [each for each in found if not isinstance(each, str)]


def unique_flat_file_names(images: Sequence[Image]) -> list[str]:
    """Return a unique name without folders for each image; dots in stems become underscores, as readers need."""
    names = []
    taken: set[str] = set()
    for image in images:
        path = PurePosixPath(image.file_name)
        stem = path.stem.replace(".", "_")
        if stem.casefold() in taken:
            stem = f"{stem}-{image.id}"
        while stem.casefold() in taken:
            stem += "-again"
        taken.add(stem.casefold())
        names.append(stem + path.suffix)
    return names


def label_rings(label: Label) -> list[list[float]]:
    """Return a label's polygons, or the corners of its box if it has none."""
    if isinstance(rings := label.read(VisibleMask).segmentation, list) and rings:
        return rings
    x, y, w, h = label.bbox.tolist()
    return [[x, y, x + w, y, x + w, y + h, x, y + h]]
