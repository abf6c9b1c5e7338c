"""Read a dataset for joining, and refuse it if records would be lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from hulldown.dataset.failures import read_failures
from hulldown.dataset.provenance import read_provenance
from hulldown.dataset.records import check_usable
from hulldown.dataset.store.document import Document, check_is_dataset, read_document
from hulldown.dataset.store.pictures import own_picture
from hulldown.dataset.store.seals import broken
from hulldown.geometry.errors import DatasetError


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A dataset to be joined.

    Parameters
    ----------
    folder
        Its folder.
    document
        Its records.
    boxes
        Image id -> indices of its annotations.
    provenance, failures
        Its plans by their keys, and its failed images.
    """

    folder: Path
    document: Document
    boxes: dict[int, list[int]]
    provenance: dict[str, dict[str, Any]]
    failures: list[dict[str, Any]]


def read_part(folder: Path, target: Path, allowed: Sequence[Path] = ()) -> Part:
    """Read a part for the dataset in `target`.

    Parameters
    ----------
    folder
        Its folder.
    target
        The dataset that it's appended to.
    allowed
        Folders that links in the part may lead to.

    Raises
    ------
    DatasetError
        If there is none, it's the target itself, a picture is missing, or a record can't be copied completely.
    """
    check_is_dataset(folder)
    if target.exists() and folder.samefile(target):
        raise DatasetError("is a part of itself", path=folder, remedy="name the other parts only")
    document = read_document(folder)
    for key, value in document.head.items():
        if key != "info" and value:
            raise DatasetError(
                f"has {key!r}, which joining would lose", path=folder, remedy="join the other parts into this one"
            )
    images, annotations = document.images.rows, document.annotations.rows
    for kind, records in (("image", images), ("annotation", annotations)):
        # Appending seals records anew, so a broken seal would become valid.
        if (spoilt := next((i for i, _ in filter(_is_broken, records)), None)) is not None:
            problem = f"{kind} {spoilt} is not as it was recorded"
            raise DatasetError(problem, path=folder, remedy="check it with `hulldown verify`")
    check_usable(folder, document.categories, map(loaded, images), map(loaded, annotations))
    for what, n, unique in (
        ("image ids", len(images), document.images.ids),
        ("file names", len(images), document.file_names),
        ("annotation ids", len(annotations), document.annotations.ids),
    ):
        if len(unique) < n:
            raise DatasetError(f"{what} aren't unique", path=folder, remedy="check it with `hulldown verify`")
    boxes: dict[int, list[int]] = {}
    for i, record in enumerate(map(loaded, annotations)):
        if record["image_id"] not in document.images.ids:
            problem = f"annotation {record['id']}: image {record['image_id']} does not exist"
            raise DatasetError(problem, path=folder, remedy="check it with `hulldown verify`")
        boxes.setdefault(record["image_id"], []).append(i)
    for name in sorted(document.file_names):
        try:
            own_picture(folder, name, allowed)
        except OSError as error:
            problem = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be used ({error.strerror})"
            raise DatasetError(problem, path=folder / name, remedy="render or copy this part again") from error
    return Part(folder, document, boxes, read_provenance(folder), read_failures(folder))


def _is_broken(record: tuple[int, bytes]) -> bool:
    return broken(loaded(record))


def loaded(record: tuple[int, bytes]) -> dict[str, Any]:
    """A record of a document as a dictionary."""
    return orjson.loads(record[1])
