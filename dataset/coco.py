"""A COCO dataset that several runs append to, safe against crashes at any moment.

``annotations.json`` holds the merged records, ``journal.jsonl`` a line for each image since the beginning, and for each class,
run, and merge. A line ``{"merged": true}`` means that everything above it is in ``annotations.json``, which then overrides the
journal: a record that a user deletes there stays deleted.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from hulldown.base.errors import DatasetError
from hulldown.base.outputs import OutputFolder
from hulldown.dataset.store.document import ANNOTATIONS_NAME, JOURNAL_NAME, Document, read_document
from hulldown.dataset.store.entries import (
    Record,
    finite_json,
    new_category,
    normal_file_name,
    requested_or_next_id,
    require_valid_annotation,
    require_valid_image_record,
)
from hulldown.dataset.store.journal import MERGED_LINE, Journal
from hulldown.dataset.store.reservations import Reservation

MERGE_EVERY_S = 30.0
MAX_MERGE_TIME_SHARE = 0.02  # of a run's time, for rewriting annotations.json
LOGS_NAME = "logs"


class CocoDataset:
    """A COCO dataset open for appending by this process alone; see `CocoDataset.open`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with CocoDataset.open(folder, categories=["truck"]) as dataset:
    ...         image_id = dataset.append(
    ...             {"file_name": "1.jpg", "width": 640, "height": 480},
    ...             [{"category": "truck", "bbox": [100.0, 120.5, 80.0, 40.0]}],
    ...         )
    ...     image_id, sorted(path.name for path in Path(folder).glob("*.json"))
    (1, ['annotations.json'])
    """

    def __init__(self, lock: OutputFolder, journal: Journal, document: Document, *, new: bool) -> None:
        self.folder = lock.folder
        self._lock = lock
        self._new = new
        self._images = len(document.images)
        self._length = journal.length
        self._journal = journal
        self._document = document
        self._merged_at = time.monotonic()
        self._merge_took = 0.0

    @classmethod
    def open(cls, folder: Path | str, *, categories: Iterable[str] = (), inputs: Iterable[Path] = ()) -> CocoDataset:
        """Open `folder` for appending; made if it does not exist, continued if it does.

        Parameters
        ----------
        folder
            The dataset. An ``annotations.json`` in it, made here or elsewhere, keeps all its records and fields.
        categories
            Names of classes that get ids now, in this order, unless a category of that name exists.
        inputs
            Folders that it may not be in.

        Raises
        ------
        HulldownError
            If another process has it open, it has other files and no dataset, or a file in it can't be read.
        """
        marks = (JOURNAL_NAME, ANNOTATIONS_NAME)
        lock = OutputFolder(Path(folder), "dataset", marks, inputs=inputs, remains=LOGS_NAME)
        try:
            journal = lock.folder / JOURNAL_NAME
            new, document = not journal.exists(), read_document(lock.folder)
            dataset = cls(lock, Journal(journal), document, new=new)
            dataset.add_categories(map(new_category, categories))
        except BaseException:
            lock.release()
            raise
        return dataset

    def __len__(self) -> int:
        """Return the number of images in the dataset, including those from other sources."""
        return len(self._document.images)

    def finished(self, file_name: str) -> bool:
        """Return whether the dataset has an image of that name."""
        return normal_file_name(file_name) in self._document.file_names

    def images(self) -> Iterator[tuple[int, str]]:
        """Return id and file name of each image."""
        return ((record["id"], str(record.get("file_name"))) for record in self._document.images)

    def refuse_taken_ids(self, file_name: str, image_id: int, annotation_ids: range) -> None:
        """Refuse ids reserved for an image to be appended if other records have them after a manual edit."""
        document = self._document
        if image_id in document.images.ids:
            what = f"image {image_id} ({next(name for i, name in self.images() if i == image_id)!r})"
            following = document.images.highest + 1
        elif (taken := next((i for i in annotation_ids if i in document.annotations.ids), None)) is not None:
            what, following = f"annotation {taken}", document.annotations.highest + 1
        else:
            return
        raise DatasetError(
            f"{what} has the id that is set aside for {file_name}",
            path=self.folder / ANNOTATIONS_NAME,
            remedy=f"give it another id there, from {following} on, or delete it",
        )

    def missing(self) -> int:
        """Return the number of images reserved for a plan and not in the dataset."""
        ids = self._document.images.ids
        reservations = self._document.reservations.values()
        return sum(each.images - sum(map(each.has_image_id, ids)) for each in reservations)

    def add_categories(self, records: Iterable[Record], *, keypoints: bool = False) -> None:
        """Give an id to each category with a new name, in order; existing ones must have the given `keypoints`."""
        known = {str(category.get("name")): category for category in reversed(self._document.categories)}
        records = list(records)
        for record in records if keypoints else ():
            there = known.get(record["name"], record).get("keypoints")
            if (wanted := record.get("keypoints")) and there != wanted:
                has = f"the keypoints {there}" if there else "no keypoints"
                raise DatasetError(
                    f"category {record['name']!r} has {has}, expected {wanted}",
                    path=self.folder / ANNOTATIONS_NAME,
                    remedy="add them there, or write to another folder",
                )
        if categories := self._document.numbered_new_categories(records):
            self._write_and_apply_line({"categories": categories})
            self._document.pending += 1

    def reserve_ids(self, key: str, *, images: int, annotations: int) -> Reservation:
        """Reserve ids and names for a plan, whatever the order of finished images, or return the reservation it has."""
        if not key or images < 0 or annotations < 0:
            raise ValueError(f"reserve: expected a key and counts of at least 0, got {key!r}, {images}, {annotations}")
        document = self._document
        if (known := document.reservations.get(key)) is not None:
            return known
        used = document.images.ids or document.reservations or any(self.folder.glob("images/*"))
        reservation = Reservation(
            key=key,
            image_offset=document.images.highest,
            annotation_offset=document.annotations.highest,
            prefix=f"{len(document.reservations) + 1}-{key[:8]}-" if used else "",
            images=images,
            annotations=annotations,
        )
        self._write_and_apply_line({"run": msgspec.structs.asdict(reservation)})
        return reservation

    def append(self, image: Record, annotations: Sequence[Record]) -> int:
        """Append a finished image and its annotations; they're on disk when this returns.

        Parameters
        ----------
        image
            ``file_name`` (relative to the folder, new in the dataset), ``width``, ``height``, and any other
            fields. An ``id`` is used as given, for ids reserved by `reserve_ids`; without one it gets the next. With
            ``picture_sha256``, the hash of its file, `render.verify` finds another picture.
        annotations
            Each with ``category`` (a name), ``bbox`` (xywh pixels), and any other fields. ``id`` as
            for images. ``area`` is the box's unless given, ``iscrowd`` 0, ``segmentation`` empty.

        Returns
        -------
        The id of the image.

        Raises
        ------
        ValueError
            Naming the missing, wrong, or duplicate field.
        DatasetError
            If it can't be written.
        """
        line = self._journal_line(image, annotations)
        self._write_and_apply_line(line)
        if time.monotonic() - self._merged_at > max(MERGE_EVERY_S, self._merge_took / MAX_MERGE_TIME_SHARE):
            self.merge()
        return int(line["image"]["id"])

    def require_appendable(self, image: Record, annotations: Sequence[Record]) -> None:
        """Raise as `append` would, without writing."""
        self._journal_line(image, annotations)

    def _journal_line(self, image: Record, annotations: Sequence[Record]) -> Record:
        document = self._document
        record = finite_json(image, "image")
        require_valid_image_record(record)
        if self.finished(record["file_name"]):
            raise ValueError(f"image: file_name: {record['file_name']!r} is in the dataset already")
        image_id = requested_or_next_id(record, "image", document.images.highest + 1, document.images.ids)
        labels: dict[int, dict[str, Any]] = {}
        next_id = document.annotations.highest + 1
        for i, annotation in enumerate(annotations):
            name = f"annotations[{i}]"
            label = finite_json(annotation, name)
            require_valid_annotation(label, name)
            label_id = requested_or_next_id(label, name, next_id, document.annotations.ids, labels)
            labels[label_id] = label
            next_id = max(next_id, label_id + 1)
        categories = document.numbered_new_categories(new_category(label["category"]) for label in labels.values())
        category_ids = document.category_ids_by_name | {category["name"]: category["id"] for category in categories}
        records = [{"id": image_id, **record} | {"id": image_id}]
        for label_id, label in labels.items():
            ids = {"id": label_id, "image_id": image_id, "category_id": category_ids[label.pop("category")]}
            defaults = {"area": label["bbox"][2] * label["bbox"][3], "iscrowd": 0, "segmentation": []}
            records.append({**ids, **defaults, **label, **ids})
        full, *of_image = records
        return {"image": full, "annotations": of_image} | ({"categories": categories} if categories else {})

    def merge(self) -> None:
        """Bring ``annotations.json`` up to date, replacing it in one step."""
        path = self.folder / ANNOTATIONS_NAME
        start = time.monotonic()
        if self._document.pending or not path.exists():
            self._document.write(path)
            self._journal.append_bytes(MERGED_LINE)
            self._document.pending = 0
        self._merged_at = time.monotonic()
        self._merge_took = self._merged_at - start

    def close(self) -> None:
        """Merge, and release the dataset for other processes. Closing twice is harmless."""
        if not self._lock.is_held:
            return
        try:
            self.merge()
        finally:
            self._journal.close()
            self._lock.release()

    def undo_open(self) -> None:
        """Close as if it had never been opened; for a run that cannot begin."""
        if len(self) > self._images:
            raise ValueError(f"abandon: expected no image since the dataset was opened, got some in {self.folder}")
        if not self._lock.is_held:
            return
        self._journal.truncate(self._length)
        self._journal.close()
        if self._new:
            self._journal.path.unlink(missing_ok=True)
        self._lock.release()  # last: afterwards the folder may be another process's

    def __enter__(self) -> CocoDataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_and_apply_line(self, line: Record) -> None:
        self._journal.append(line)
        self._document.apply_line(line)
