"""A dataset's records in memory: the merged ``annotations.json`` and the later journal lines.

Records are kept as JSON bytes: a million images take 1.5 GB this way, a fifth of what
dictionaries would.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import BinaryIO, cast

import msgspec
import orjson

from hulldown.annotate.coco_types import Coco, Record
from hulldown.base.code import package_version
from hulldown.base.errors import DatasetError
from hulldown.base.files import is_safe_relative_path
from hulldown.base.outside import (
    MAX_DATA_BYTES,
    convert_value,
    describe_path,
    parse_json,
    parse_json_records,
    raw_json_values,
    read_file,
)
from hulldown.dataset.foreign_labels import foreign_reader, refuse_known_folder
from hulldown.dataset.store.entries import normal_file_name
from hulldown.dataset.store.journal import last_merged_line_number, open_replacement_file, read_journal
from hulldown.dataset.store.reservations import Reservation, coco_reservations

ANNOTATIONS_NAME = "annotations.json"
JOURNAL_NAME = "journal.jsonl"
COCO_NAME = "_annotations.coco.json"  # RF-DETR and Roboflow use this name in every split's folder
# FiftyOne, Label Studio, and CVAT use these, with names relative to a folder of pictures.
OTHER_COCO_NAMES = ("labels.json", "result.json", "annotations/instances_*.json")
NO_RECORDS = msgspec.Raw(b"[]")
RECORD_NOUNS = {"categories": "category", "images": "image", "annotations": "annotation"}
JOURNAL_KEYS = {"categories", "run", "image", "annotations", "merged", "line_sha256"}  # old journals have `line_sha256`


@dataclass(slots=True)
class Records:
    """JSON records of one kind, in the order of the file, with their ids."""

    rows: list[tuple[int, bytes]] = field(default_factory=list)
    ids: set[int] = field(default_factory=set)
    highest: int = 0  # the highest id that is used or reserved; at least 0, as pycocotools takes 0 for unmatched

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, i: int) -> Record:
        return orjson.loads(self.rows[i][1])

    def __iter__(self) -> Iterator[Record]:
        return (orjson.loads(record) for _, record in self.rows)

    def add(self, record: Record) -> None:
        """Add a record."""
        # Copied, since orjson's result keeps its buffer of several kilobytes.
        self.rows.append((record["id"], bytes(memoryview(orjson.dumps(record)))))
        self.ids.add(record["id"])
        self.highest = max(self.highest, record["id"])

    def ordered_record_bytes(self, offsets: Iterable[int]) -> Iterator[bytes]:
        """Return records; those above the lowest offset are sorted by id, since images may finish in any order."""
        lowest = min(offsets, default=math.inf)
        return (record for _, record in sorted(self.rows, key=lambda row: max(row[0], lowest)))


class Document:
    """A COCO document that grows line by line; it's empty at first."""

    def __init__(self) -> None:
        self.head: Record = {}
        self.categories: list[Record] = []
        self.images, self.annotations = Records(), Records()
        self.file_names: set[str] = set()
        self.reservations: dict[str, Reservation] = {}
        self.pending = 0

    @property
    def category_ids_by_name(self) -> dict[str, int]:
        """The id of each name; of two equal names the first, so that reopening doesn't change the choice."""
        return {str(record.get("name")): record["id"] for record in reversed(self.categories)}

    def numbered_new_categories(self, records: Iterable[Record]) -> list[Record]:
        """Return records with the next ids for new names, each once."""
        known = self.category_ids_by_name
        new: dict[str, Record] = {}
        for record in records:
            if record["name"] not in known:
                new.setdefault(record["name"], record)
        following = max((record["id"] for record in self.categories), default=0)
        return [{**record, "id": i} for i, record in enumerate(new.values(), start=max(following, 0) + 1)]

    def apply_line(self, line: Record) -> None:
        """Apply a line of the journal."""
        for category in line.get("categories", ()):
            name, number = category["name"], category["id"]
            if self.category_ids_by_name.get(name) == number:
                continue
            if name in self.category_ids_by_name or any(c["id"] == number for c in self.categories) or type(number) is not int:
                raise ValueError(f"category {name!r} with id {number}")
            self.categories.append(category)
        if "run" in line:
            self.add_reservation(convert_value(line["run"], Reservation))
        image = line.get("image")
        if image is None or normal_file_name(image["file_name"]) in self.file_names:
            return
        if not all(isinstance(record["id"], int) for record in (image, *line["annotations"])):
            raise TypeError(f"ids of {image['file_name']!r}")
        self.pending += 1
        self.add(image, line["annotations"])

    def add(self, image: Record, annotations: Iterable[Record]) -> None:
        """Add an image and its annotations."""
        self.file_names.add(normal_file_name(str(image.get("file_name"))))
        self.images.add(image)
        for annotation in annotations:
            self.annotations.add(annotation)

    def add_reservation(self, new: Reservation) -> None:
        """Add a reservation; ValueError if its plan has another one."""
        if self.reservations.setdefault(new.key, new) != new:
            raise ValueError(f"two records of what is set aside for {new.key!r}")
        self.images.highest = max(self.images.highest, new.image_offset + new.images)
        self.annotations.highest = max(self.annotations.highest, new.annotation_offset + new.annotations)

    def to_dict(self) -> Coco:
        """Return the document as a COCO dictionary, in the order of the file."""
        head, *records = self._head_and_record_bytes()
        images, annotations = ([orjson.loads(record) for record in of_kind] for of_kind in records)
        return cast(Coco, {**head, "images": images, "annotations": annotations})

    def write(self, path: Path) -> None:
        """Replace the file at `path` in one step, one record a line."""
        with open_replacement_file(path) as file:
            write_coco_document(file, *self._head_and_record_bytes())

    def _head_and_record_bytes(self) -> tuple[Record, Iterator[bytes], Iterator[bytes]]:
        head, reservations = self.head, self.reservations.values()
        if reservations and isinstance(info := head.get("info", {}), dict):
            reserved = msgspec.to_builtins(list(reservations))
            head = {**head, "info": {**rendered_dataset_info(), **info, "hulldown_runs": reserved}}
        return (
            {**head, "categories": self.categories},
            self.images.ordered_record_bytes(reservation.image_offset for reservation in reservations),
            self.annotations.ordered_record_bytes(reservation.annotation_offset for reservation in reservations),
        )


def write_coco_document(file: BinaryIO, head: Record, images: Iterable[bytes], annotations: Iterable[bytes]) -> None:
    """Write a COCO document, one record per line."""
    file.write(orjson.dumps(head)[:-1])
    for key, records in ((b"images", images), (b"annotations", annotations)):
        file.write(b',\n"%b":[' % key)
        start = b"\n"
        for record in records:
            file.write(start)
            file.write(record)
            start = b",\n"
        file.write(b"]")
    file.write(b"}\n")


def read_document(folder: Path) -> Document:
    """Read the dataset in `folder`: its ``annotations.json`` and the later journal lines."""
    path, journal = folder / ANNOTATIONS_NAME, folder / JOURNAL_NAME
    # First, since another process may merge meanwhile: its lines are then read from the journal.
    merged = last_merged_line_number(journal)
    exists = path.exists()
    document = _read_coco_document(path) if exists else Document()
    since: dict[str | int, tuple[int, Record]] = {}
    number = 0
    try:
        for number, line in enumerate(read_journal(journal), start=1):
            if not line.keys() <= JOURNAL_KEYS:
                raise KeyError(f"keys {sorted(line)}")
            if "run" in line:
                document.apply_line(line)
            elif "merged" not in line and (number > merged or not exists):
                # A later line of the same name replaces: the image was deleted by hand and made again.
                key = normal_file_name(line["image"]["file_name"]) if "image" in line else number
                since.pop(key, None)
                since[key] = number, line
        for number, later in since.values():  # noqa: B007  the error names it
            document.apply_line(later)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"line {number} does not fit this journal and its {ANNOTATIONS_NAME}",
            path=journal,
            remedy="restore both files from a backup, or delete that line to give its image up",
        ) from error
    if merged and not exists:
        warnings.warn(f"{path}: is missing; it is made anew from {journal.name}, without what was in it before", stacklevel=2)
    return document


@cache
def rendered_dataset_info() -> dict[str, str]:
    """Return COCO's `info` of rendered datasets; it has no date, so that the same plan gives the same file."""
    version = package_version("hulldown")
    by = f"hulldown {version}" if version else "hulldown"  # run from its folder
    return {"description": "Vehicles rendered by hulldown, with boxes and masks from planned poses", "version": by}


def is_hulldown_dataset(folder: Path) -> bool:
    """Return whether a folder has a dataset in hulldown's form, even an unfinished one."""
    return (folder / ANNOTATIONS_NAME).exists() or (folder / JOURNAL_NAME).exists()


def require_hulldown_dataset(folder: Path) -> None:
    """Refuse a folder without a dataset."""
    if not is_hulldown_dataset(folder):
        missing = f"no {ANNOTATIONS_NAME} and no {JOURNAL_NAME} here" if folder.exists() else "does not exist"
        problem = f"is {describe_path(folder)}, not a dataset" if folder.is_file() else missing
        raise DatasetError(problem, path=folder, remedy="name the folder of a dataset")


def read_coco(folder: Path | str) -> Coco:
    """Read a dataset as a COCO dictionary, journal included: ours, a split, a COCO file, or another tool's folder."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        if (kind := describe_path(folder)) not in ("a JSON file", "another file", "empty"):
            raise DatasetError(f"is {kind}, not a dataset", path=folder, remedy="name the folder of a dataset")
        return _read_coco_document(folder).to_dict()
    if not is_hulldown_dataset(folder):
        if (folder / COCO_NAME).exists():
            return _read_coco_document(folder / COCO_NAME).to_dict()
        if len(others := [path for name in OTHER_COCO_NAMES for path in folder.glob(name)]) == 1:
            return _with_pictures_found(_read_coco_document(others[0]).to_dict(), folder, others[0].stem)
        if (read := foreign_reader(folder)) is not None:
            return read()
        refuse_known_folder(folder)
        require_hulldown_dataset(folder)
    return read_document(folder).to_dict()


def _with_pictures_found(coco: Coco, folder: Path, stem: str) -> Coco:
    """Return a dictionary with the names of its pictures relative to the dataset, where they're found."""
    split = stem.removeprefix("instances_")
    images: list[Record] = []
    for image in coco["images"]:
        name = str(image.get("file_name"))
        name = name if is_safe_relative_path(name) else PurePosixPath(name).name  # Label Studio's are its server's paths
        names = [f"{home}{name}" for home in ("", "data/", "images/", f"images/{split}/", f"{split}/")]
        images.append({**image, "file_name": next((each for each in names if (folder / each).is_file()), name)})
    return {**coco, "images": images}


def _read_coco_document(path: Path) -> Document:
    """Read a COCO file record by record, which takes less than half the memory of parsing it as a whole."""
    document = Document()
    content = read_file(path, partial(_unusable_error, path), most=MAX_DATA_BYTES)
    try:
        parts = raw_json_values(content)
        categories, images, annotations = (
            _parse_records(parts.pop(key, NO_RECORDS), key, kind, path) for key, kind in RECORD_NOUNS.items()
        )
        document.head = {key: parse_json(memoryview(part), object) for key, part in parts.items()}
        document.categories += categories
        for image in images:
            document.add(_with_slashed_file_name(image), ())
        for annotation in annotations:
            document.annotations.add(annotation)
        orjson.dumps([document.head, document.categories])
    except TypeError as error:
        raise _unusable_error(path, f"a record cannot be written again ({error})") from None
    except ValueError as error:
        raise _unusable_error(path, f"isn't a COCO object ({error})") from error
    try:
        for reservation in coco_reservations(document.head):
            document.add_reservation(reservation)
    except ValueError as error:
        raise _unusable_error(path, f"'info' has 'hulldown_runs' that are not as they were written ({error})") from None
    return document


def _with_slashed_file_name(image: Record) -> Record:
    name = image.get("file_name")
    return {**image, "file_name": name.replace("\\", "/")} if isinstance(name, str) and "\\" in name else image


def _parse_records(content: msgspec.Raw, key: str, kind: str, path: Path) -> Iterator[Record]:
    for record in parse_json_records(content, key):
        if type(number := record.get("id")) is not int:
            raise _unusable_error(path, f"{kind} id {number!r} is not a whole number")
        yield record


def _unusable_error(path: Path, what: str) -> DatasetError:
    return DatasetError(what, path=path, remedy="repair it, or restore it from a backup, or choose an empty folder")
