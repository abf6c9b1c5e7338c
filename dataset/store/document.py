"""A dataset's records in memory: the merged ``annotations.json`` and the later journal lines.

Records are kept as JSON bytes: a million images take 1.5 GB this way, a fifth of what
dictionaries would.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import orjson

from hulldown.dataset.store.foreign import foreign_reader
from hulldown.dataset.store.journal import last_merged, read_journal, replaced
from hulldown.dataset.store.names import place_of
from hulldown.dataset.store.record_lines import OtherLayoutError, read_by_line, write_coco
from hulldown.dataset.store.runs import Run
from hulldown.geometry.errors import DatasetError
from hulldown.geometry.files import open_regular

ANNOTATIONS_NAME = "annotations.json"
JOURNAL_NAME = "journal.jsonl"
COCO_NAME = "_annotations.coco.json"  # of RF-DETR and Roboflow, in every split's folder
LINE_KEYS = {"categories", "run", "image", "annotations", "merged"}  # all keys of a journal's lines


class Document:
    """A COCO document that grows line by line.

    Parameters
    ----------
    head
        A COCO dictionary without images and annotations; its categories are removed.
    images, annotations
        Its records as iterables, read once, images first.
    path
        Its file, for errors.
    """

    def __init__(
        self,
        head: dict[str, Any],
        images: Iterable[dict[str, Any]],
        annotations: Iterable[dict[str, Any]],
        path: Path,
    ) -> None:
        self.categories: list[dict[str, Any]] = _objects(head, "categories", path)
        self.category_ids: dict[str, int] = {}
        for record in self.categories:
            # The first of two with the same name, so that reopening doesn't change the choice.
            self.category_ids.setdefault(str(record.get("name")), _id(record, "category", path))
        self.images: list[tuple[int, bytes]] = []
        self.annotations: list[tuple[int, bytes]] = []
        self.file_names: set[str] = set()
        self.runs: dict[str, Run] = {}
        self.pending = 0
        self._reserved = (0, 0)
        for record in images:
            self.images.append((_id(record, "image", path), _dumped(record, "an image", path)))
            self.file_names.add(place_of(str(record.get("file_name"))))
        for record in annotations:
            self.annotations.append((_id(record, "annotation", path), _dumped(record, "an annotation", path)))
        self.image_ids = {i for i, _ in self.images}
        self.annotation_ids = {i for i, _ in self.annotations}
        self.highest_image_id = max(self.image_ids, default=0)
        self.highest_annotation_id = max(self.annotation_ids, default=0)
        info = head.get("info")
        try:
            for run in info.get("hulldown_runs", []) if isinstance(info, dict) else []:
                self._add_run(run)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise _unusable(path, f"'info' has 'hulldown_runs' that are not as they were written ({error})") from None
        _dumped([head, self.categories], "what is beside images and annotations", path)
        self.head = head

    @property
    def next_image_id(self) -> int:
        """The lowest id above all used or reserved ones; at least 1."""
        return max(self.highest_image_id, self._reserved[0], 0) + 1

    @property
    def next_annotation_id(self) -> int:
        """The lowest id above all used or reserved ones; at least 1 (pycocotools takes 0 for unmatched)."""
        return max(self.highest_annotation_id, self._reserved[1], 0) + 1

    def apply(self, line: Mapping[str, Any]) -> None:
        """Apply a line of the journal.

        Raises
        ------
        KeyError, TypeError, ValueError
            If it isn't a line of this document's journal.
        """
        for category in line.get("categories", ()):
            self._add_category(category)
        if "run" in line:
            self._add_run(line["run"])
        image = line.get("image")
        if image is None or (place := place_of(image["file_name"])) in self.file_names:
            return
        if not all(isinstance(record["id"], int) for record in (image, *line["annotations"])):
            raise TypeError(f"ids of {image['file_name']!r}")
        self.pending += 1
        self.file_names.add(place)
        self.images.append((image["id"], _kept(image)))
        self.image_ids.add(image["id"])
        self.highest_image_id = max(self.highest_image_id, image["id"])
        for annotation in line["annotations"]:
            self.annotations.append((annotation["id"], _kept(annotation)))
            self.annotation_ids.add(annotation["id"])
            self.highest_annotation_id = max(self.highest_annotation_id, annotation["id"])

    def to_dict(self) -> dict[str, Any]:
        """The whole as one COCO dictionary, in the order it is written."""
        return {
            **self._head(),
            "categories": self.categories,
            "images": [orjson.loads(record) for record in self._ordered(self.images, "image_offset")],
            "annotations": [orjson.loads(record) for record in self._ordered(self.annotations, "annotation_offset")],
        }

    def write(self, path: Path) -> None:
        """Replace the file at `path` in one step, one record a line.

        Raises
        ------
        DatasetError
            If it cannot be written; the file is then as it was.
        """
        with replaced(path) as file:
            write_coco(
                file,
                {**self._head(), "categories": self.categories},
                self._ordered(self.images, "image_offset"),
                self._ordered(self.annotations, "annotation_offset"),
            )

    def _head(self) -> dict[str, Any]:
        info = self.head.get("info", {})
        if not self.runs or not isinstance(info, dict):
            return self.head
        runs = [asdict(run) for run in self.runs.values()]
        return {**self.head, "info": {**rendered_info(), **info, "hulldown_runs": runs}}

    def _ordered(self, records: list[tuple[int, bytes]], offset: str) -> Iterable[bytes]:
        """Records in order, those of runs by id, so the order in which images were finished doesn't matter."""
        if not self.runs:
            return (record for _, record in records)
        first = min(getattr(run, offset) for run in self.runs.values())
        return (record for _, record in sorted(records, key=lambda record: max(record[0], first)))

    def _add_category(self, category: dict[str, Any]) -> None:
        known = self.category_ids.setdefault(category["name"], category["id"])
        if (
            not isinstance(known, int)
            or known != category["id"]
            or any(c["id"] == category["id"] and c.get("name") != category["name"] for c in self.categories)
        ):
            raise ValueError(f"category {category['name']!r} with id {category['id']}")
        if all(c.get("name") != category["name"] for c in self.categories):
            self.categories.append(category)

    def _add_run(self, record: dict[str, Any]) -> None:
        new = Run(**record)
        if (run := self.runs.setdefault(new.key, new)) != new:
            raise ValueError(f"two records of what is set aside for {new.key!r}")
        images, annotations = self._reserved
        self._reserved = (
            max(images, run.image_offset + run.images),
            max(annotations, run.annotation_offset + run.annotations),
        )


def read_document(folder: Path) -> Document:
    """Read the dataset in `folder`: its ``annotations.json`` and the later journal lines.

    Raises
    ------
    DatasetError
        If one of the two is damaged.
    """
    path, journal = folder / ANNOTATIONS_NAME, folder / JOURNAL_NAME
    # First, since another process may merge meanwhile: its lines are then read from the journal.
    merged = last_merged(journal)
    exists = path.exists()
    document = _read_annotations(path) if exists else Document({}, (), (), path)
    since: dict[str | int, tuple[int, dict[str, Any]]] = {}
    for number, line in enumerate(read_journal(journal), start=1):
        try:
            if not line.keys() <= LINE_KEYS:
                raise KeyError(f"keys {sorted(line)}")
            if "run" in line:
                document.apply(line)
            elif "merged" not in line and (number > merged or not exists):
                # A later line of the same name replaces: the image was deleted by hand and made again.
                key = place_of(line["image"]["file_name"]) if "image" in line else number
                since.pop(key, None)
                since[key] = number, line
        except (KeyError, TypeError, ValueError) as error:
            raise _foreign_line(journal, number) from error
    if merged and not exists:
        warnings.warn(
            f"{path}: is missing; it is made anew from {journal.name}, without what was in it before", stacklevel=2
        )
    for number, line in since.values():
        try:
            document.apply(line)
        except (KeyError, TypeError, ValueError) as error:
            raise _foreign_line(journal, number) from error
    return document


@cache
def rendered_info() -> dict[str, str]:
    """COCO's `info` of rendered datasets, without a date, so that the same plan gives the same file."""
    try:
        by = f"hulldown {version('hulldown')}"
    except PackageNotFoundError:  # run from its folder
        by = "hulldown"
    return {"description": "Vehicles rendered by hulldown, with boxes and masks from planned poses", "version": by}


def check_is_dataset(folder: Path) -> None:
    """Refuse a folder without a dataset.

    Raises
    ------
    DatasetError
        If neither file is there.
    """
    if not (folder / ANNOTATIONS_NAME).exists() and not (folder / JOURNAL_NAME).exists():
        raise DatasetError(
            f"no {ANNOTATIONS_NAME} and no {JOURNAL_NAME} here", path=folder, remedy="name the folder of a dataset"
        )


def read_coco(folder: Path | str) -> dict[str, Any]:
    """Read the dataset in `folder` as a COCO dictionary, journal included, without lock or change.

    It may also be a split by `hulldown export` or Roboflow (``_annotations.coco.json`` with pictures), a COCO
    file, or a folder of YOLO or VOC.

    Raises
    ------
    DatasetError
        If there is none, or it is damaged.
    """
    folder = Path(folder)
    if folder.is_file():
        return _read_annotations(folder).to_dict()
    ours = (folder / ANNOTATIONS_NAME).exists() or (folder / JOURNAL_NAME).exists()
    if not ours and (folder / COCO_NAME).exists():
        return _read_annotations(folder / COCO_NAME).to_dict()
    if not ours and (read := foreign_reader(folder)) is not None:
        return read()
    check_is_dataset(folder)
    return read_document(folder).to_dict()


def _read_annotations(path: Path) -> Document:
    """Read by line if possible, which takes a fifth of the memory."""
    try:
        with open_regular(path) as file:
            return Document(*read_by_line(file), path)
    except (OtherLayoutError, DatasetError, OSError):
        pass
    # Laid out by another tool, or damaged: the parser of the whole decides, and says what is wrong.
    coco = _read_json(path)
    images, annotations = (_objects(coco, key, path) for key in ("images", "annotations"))
    return Document(coco, images, annotations, path)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        with open_regular(path) as file:
            coco = orjson.loads(file.read())
    except OSError as error:
        raise _unusable(path, f"cannot be read ({error.strerror})") from error
    except orjson.JSONDecodeError as error:
        raise _unusable(path, f"is not valid JSON ({error})") from error
    if not isinstance(coco, dict):
        raise _unusable(path, f"is a JSON {type(coco).__name__} where a COCO object was expected")
    return coco


def _objects(coco: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    """Remove and return a list of records from a dictionary; empty if there is none."""
    records = coco.pop(key, [])
    if not isinstance(records, list) or not all(isinstance(record, dict) for record in records):
        raise _unusable(path, f"{key!r} is not a list of objects")
    return records


def _dumped(value: Any, what: str, path: Path) -> bytes:
    try:
        return _kept(value)
    except TypeError as error:
        raise _unusable(path, f"{what} cannot be written again ({error})") from None


def _id(record: Mapping[str, Any], kind: str, path: Path) -> int:
    value = record.get("id")
    if not isinstance(value, int) or isinstance(value, bool):
        raise _unusable(path, f"{kind} id {value!r} is not a whole number")
    return value


def _kept(value: Any) -> bytes:
    # Copied, since orjson's result keeps its buffer of several kilobytes.
    return bytes(memoryview(orjson.dumps(value)))


def _unusable(path: Path, what: str) -> DatasetError:
    return DatasetError(what, path=path, remedy="repair it, or restore it from a backup, or choose an empty folder")


def _foreign_line(path: Path, number: int) -> DatasetError:
    return DatasetError(
        f"line {number} does not fit this journal and its {ANNOTATIONS_NAME}",
        path=path,
        remedy="restore both files from a backup, or delete that line to give its image up",
    )
