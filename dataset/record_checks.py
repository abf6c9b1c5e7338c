"""Check COCO records, without their pictures."""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal, get_type_hints

import numpy as np
from msgspec import Struct, defstruct

from hulldown.annotate.coco_types import Coco, Record
from hulldown.annotate.label_list import invalid_label_field_sentences, label_problems
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import mask_area_and_box
from hulldown.annotate.record_fields import (
    PICTURE_HASH_KEY,
    TEXT_ROUNDING_PX,
    CategoryRecord,
    ImageRecord,
    LabelRecord,
    RenderedImageRecord,
    declared_fields,
    invalid_field_sentences,
)
from hulldown.annotate.records import Category, Image, Label, box_overhang_px
from hulldown.base.errors import DatasetError, shorten_text
from hulldown.base.files import is_safe_relative_path
from hulldown.base.outside import convert_parsed_value
from hulldown.camera.intrinsics import Intrinsics
from hulldown.dataset.images import LabeledImages
from hulldown.dataset.store.document import read_coco
from hulldown.dataset.store.entries import normal_file_name
from hulldown.dataset.store.journal import read_journal
from hulldown.dataset.store.placed_pictures import refuse_outside_links
from hulldown.dataset.store.reservations import coco_reservations
from hulldown.plan.row import PlannedVehicle, Row, row_fields
from hulldown.weather.extinction import MIN_LABEL_CONTRAST

# Pixels, and share of its side, by which a box with an antenna may exceed its mask: 0.2 of 713.
MIN_BOX_GAP_PX, MIN_BOX_GAP_SHARE = 2.0, 0.25
MAX_LISTED_FINDINGS = 20  # of each kind


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem found by a check."""

    severity: Literal["error", "warning"]  # ``"error"``: would break or mislead training. ``"warning"``: worth a look.
    where: str
    problem: str
    figure: float | None = None  # the measured value, if there is one

    def __post_init__(self) -> None:
        for field in ("where", "problem"):
            object.__setattr__(self, field, shorten_text(getattr(self, field)))

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.problem}"


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """Return findings as lines, at most `MAX_LISTED_FINDINGS` of each kind, and the number of further ones."""
    kinds: Counter[tuple[str, str]] = Counter()
    lines = []
    for finding in findings:
        kind = (finding.severity, re.sub(r"'[^']*'|[-+.\d]+", "", finding.problem))
        kinds[kind] += 1
        if kinds[kind] <= MAX_LISTED_FINDINGS:
            lines.append(str(finding))
    more = [(severity, kind, n - MAX_LISTED_FINDINGS) for (severity, kind), n in kinds.items() if n > MAX_LISTED_FINDINGS]
    return lines + [f"{severity}: and {n} more like: {' '.join(kind.split())}" for severity, kind, n in more]


def read_folder(folder: Path) -> Coco:
    """Read a dataset as `read_coco` does; its file in place of its folder is refused."""
    coco = read_coco(folder)
    if folder.is_file():
        raise DatasetError("is a file", path=folder, remedy=f"name its folder, {folder.parent}")
    return coco


def read_usable_dataset(folder: Path, allowed: Sequence[Path] = (), *, takes_file: bool = False) -> LabeledImages:
    """Read the dataset in `folder`, whose records must be complete, and links lead into it or the `allowed` folders."""
    coco = read_coco(folder) if takes_file else read_folder(folder)
    refuse_unusable_records(folder, coco["categories"], coco["images"], coco["annotations"])
    names = [image["file_name"] for image in coco["images"]]
    refuse_outside_links(folder if folder.is_dir() else folder.parent, names, allowed)
    return LabeledImages.from_coco_dict(coco)


def refuse_unusable_records(
    folder: Path, categories: Iterable[Record], images: Iterable[Record], annotations: Iterable[Record]
) -> None:
    """Refuse records that can't be drawn, exported, or appended to another dataset."""
    if found := next(find_record_problems(categories, images, annotations), None):
        raise DatasetError(f"{found.where}: {found.problem}", path=folder, remedy="check it with `hulldown verify`")


def find_record_problems(
    categories: Iterable[Record], images: Iterable[Record], annotations: Iterable[Record]
) -> Iterator[Finding]:
    """Find fields of a wrong type, repeated ids, and references to missing records."""
    known: set[object] = set()
    for category in categories:
        where = f"category {category['id']}"
        yield from (Finding("error", where, problem) for problem in invalid_field_sentences(category, CategoryRecord))
        if category["id"] in known:
            yield Finding("error", where, "its id is given twice")
        known.add(category["id"])
    first: dict[object, str] = {}
    for image in images:
        name = _image_name(image)
        if image["id"] in first:
            yield Finding("error", name, f"has the id {image['id']}, as has {first[image['id']]}")
        if not is_safe_relative_path(image.get("file_name")):
            problem = f"file_name {image.get('file_name')!r:.120} is no path inside the dataset"
            yield Finding("error", f"image {image['id']}", problem)
        yield from (Finding("error", name, problem) for problem in invalid_field_sentences(image, ImageRecord))
        first.setdefault(image["id"], name)
    labels: set[object] = set()
    for annotation in annotations:
        where = f"annotation {annotation['id']}"
        if annotation["id"] in labels:
            yield Finding("error", where, "its id is given twice")
        labels.add(annotation["id"])
        image_id, category_id = annotation.get("image_id"), annotation.get("category_id")
        if isinstance(image_id, int) and image_id in first:
            where = f"{first[image_id]}: {where}"
        else:
            yield Finding("error", where, f"image {image_id!r} does not exist")
        if not isinstance(category_id, int) or category_id not in known:
            yield Finding("error", where, f"category {category_id!r} does not exist")
        yield from (Finding("error", where, problem) for problem in invalid_label_field_sentences(annotation))


def find_name_problems(coco: Coco) -> Iterator[Finding]:
    """Find repeated names of classes and images, and names that differ only in case."""
    for kind, names in (
        ("category ", [str(category.get("name")) for category in coco["categories"]]),
        ("", [normal_file_name(str(image.get("file_name"))) for image in coco["images"]]),
    ):
        spelled: dict[str, str] = {}
        for name, times in Counter(names).items():
            if times > 1:
                yield Finding("error", f"{kind}{name}", f"belongs to {times} records")
            if (other := spelled.setdefault(name.casefold(), name)) != name:
                yield Finding("warning", f"{kind}{name}", f"differs from {other} in capitals only")


def _recorded_fields_type(kind: type[Struct], *declared: type[Struct]) -> type[Struct]:
    """Return a type with the fields of a plan's row or vehicle that records have, but for declared ones."""
    hints, known = get_type_hints(kind, include_extras=True), set().union(*map(get_type_hints, declared))
    keys = [key for key, field in row_fields(kind).items() if field.recorded and key not in known]
    return defstruct(kind.__name__, [(key, hints[key], None) for key in keys])


ROW_FIELDS = _recorded_fields_type(Row, RenderedImageRecord, ImageRecord)
VEHICLE_FIELDS = _recorded_fields_type(PlannedVehicle, LabelRecord)


def find_camera_problems(images: Iterable[Record]) -> Iterator[Finding]:
    """Find invalid fields of a render's view; in other datasets such fields may mean something else."""
    for image in images:
        row_fields = invalid_field_sentences(image, ROW_FIELDS) if PICTURE_HASH_KEY in image else ()
        problems = [*invalid_field_sentences(image, RenderedImageRecord), *row_fields]
        if (
            not (problems or any(invalid_field_sentences(image, ImageRecord)))
            and (view := declared_fields(image, RenderedImageRecord)).K is not None
        ):
            try:
                Intrinsics.from_record_fields(image["width"], image["height"], K=view.K, dist=view.dist)
            except ValueError as error:
                problems = [f"K and dist are no camera: {error}"]
        kind: Literal["error", "warning"] = "error" if PICTURE_HASH_KEY in image else "warning"
        yield from (Finding(kind, _image_name(image), problem) for problem in problems)


def sound_images_by_id(coco: Coco) -> dict[int, Image]:
    """Return images whose records are valid, by id, with those of their labels that are valid."""
    names = {category["id"]: str(category.get("name")) for category in coco["categories"]}
    of_image: dict[object, list[Label]] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        with contextlib.suppress(ValueError, TypeError, KeyError):
            of_image[annotation["image_id"]].append(Label.from_record(annotation, names))
    sound = (image for image in coco["images"] if not any(invalid_field_sentences(image, ImageRecord)))
    return {image["id"]: Image.from_record(image, of_image[image["id"]]) for image in sound}


def find_label_problems(categories: Iterable[Record], images: Iterable[Image]) -> Iterator[Finding]:
    """Find labels that contradict themselves, their image, or each other."""
    classes = {record["id"]: Category.from_record(record) for record in categories}
    for image in images:
        boxes: set[tuple[object, ...]] = set()
        for label in image.labels:
            where = f"{image.file_name}: annotation {label.id}"
            if label.id < 1:
                yield Finding("warning", where, "ids below 1 are taken for unmatched by pycocotools' evaluation")
            if image.record.get("background") is True and not label.crowd:
                yield Finding("error", where, "is a label on a background, an image without targets")
            if min(label.bbox[2:]) <= 0:
                yield Finding("error", where, f"bbox {label.record['bbox']} has no area")
                continue
            if (box := (label.category_id, *label.bbox.tolist())) in boxes:
                yield Finding("warning", where, "repeats class and box of another one in the same image")
            boxes.add(box)
            problems = [*label_problems(label, image, classes.get(label.category_id))]
            if PICTURE_HASH_KEY in image.record:
                problems += invalid_field_sentences(label.record, VEHICLE_FIELDS)
            yield from (Finding("error", where, problem) for problem in problems)
            yield from _label_warnings(where, label, image)


def _label_warnings(where: str, label: Label, image: Image) -> Iterator[Finding]:
    if (by := box_overhang_px(label.bbox, *image.size)) > TEXT_ROUNDING_PX:
        yield Finding("warning", where, f"its bbox leaves its image by {by:.4g} px, and is clipped when it's used", by)
    if (gap := _box_beyond_mask_px(label, image)) > 0.0:
        problem = f"its bbox is {gap:.4g} px larger than its mask, more than a quarter, though nothing hides it"
        yield Finding("warning", where, problem, gap)
    left = label.read(LabelRecord).air_contrast
    if left is not None and left < MIN_LABEL_CONTRAST and not label.crowd:
        problem = f"is a ghost: the air leaves {100.0 * left:.1f} % of its contrast"
        yield Finding("warning", where, problem, left)


def _box_beyond_mask_px(label: Label, image: Image) -> float:
    """Return the pixels by which a box exceeds the mask of a target in full view; 0 for gaps small as an antenna."""
    if label.visible_fraction != 1.0 or not (mask := label.read(VisibleMask).segmentation):
        return 0.0
    with contextlib.suppress(ValueError):  # another check finds it
        box = mask_area_and_box(mask, *image.size)[1]
        if box is not None:
            x, y, w, h = label.bbox
            gaps = np.array([box[0] - x, box[1] - y, x + w - box[0] - box[2], y + h - box[1] - box[3]])
            large = (gaps > MIN_BOX_GAP_PX) & (gaps > MIN_BOX_GAP_SHARE * np.array([w, h, w, h]))
            return float(gaps[large].max(initial=0.0))
    return 0.0


class _Line(Struct):
    """A line of a journal: an image, or another record."""

    image: dict[str, object] | None = None
    annotations: list[dict[str, object]] = []
    categories: list[dict[str, object]] = []


def find_records_unlike_journal(coco: Coco, journal: Path) -> Iterator[Finding]:
    """Find records that differ from their journal line; images without a line come from elsewhere."""
    lines: dict[str, _Line] = {}
    classes: dict[object, Record] = {}
    for number, each in enumerate(read_journal(journal), start=1):
        try:
            written = convert_parsed_value(each, _Line)
            classes |= {category.get("id"): category for category in written.categories}
            if written.image is not None:
                lines[normal_file_name(str(written.image.get("file_name")))] = written
        except ValueError as error:
            yield Finding("error", journal.name, f"line {number} does not fit ({error})")
    labels: dict[str, dict[str, Record]] = {}
    for label in coco["annotations"]:
        labels.setdefault(str(label.get("image_id")), {})[f"annotation {label['id']}"] = label
    for image in coco["images"]:
        if (line := lines.get(normal_file_name(_image_name(image)))) is None:
            continue
        found: dict[str, Record] = {"its record": image, **labels.get(str(image["id"]), {})}
        wanted = {"its record": line.image or {}} | {f"annotation {one.get('id')}": one for one in line.annotations}
        yield from _record_change_findings(_image_name(image), found, wanted, journal)
    kept = {f"category {each['id']}": each for each in coco["categories"] if each["id"] in classes}
    yield from _record_change_findings(
        "categories", kept, {f"category {number}": each for number, each in classes.items()}, journal
    )


def _record_change_findings(
    where: str, found: Mapping[str, Record], wanted: Mapping[str, Record], journal: Path
) -> Iterator[Finding]:
    for what in dict.fromkeys([*wanted, *found]):
        if found.get(what) != wanted.get(what):
            how = "added" if what not in wanted else "deleted" if what not in found else "changed"
            problem = f"{what} was {how} after it was recorded; if that's meant, delete {journal.name}"
            yield Finding("error", where, problem)


def find_reservation_problems(coco: Coco) -> Iterator[Finding]:
    """Find plans that reserve the same ids."""
    reservations = coco_reservations(coco)
    for kind in ("image", "annotation"):
        ranges = sorted((getattr(each, f"{kind}_offset"), getattr(each, f"{kind}s"), each.key) for each in reservations)
        for (start, length, first), (following, _, second) in pairwise(ranges):
            if following < start + length:
                problem = f"{kind} ids from {following + 1} on are reserved for two plans, {first:.12} and {second:.12}"
                yield Finding("error", "info: hulldown_runs", problem)


def _image_name(image: Record) -> str:
    name = image.get("file_name")
    return name if isinstance(name, str) and name else f"image {image['id']}"
