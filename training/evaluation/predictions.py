"""Detections: a file of COCO results as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
from jaxtyping import Float, Int
from msgspec import Struct

from hulldown.annotate.box_table import BoxTable
from hulldown.annotate.coco_types import Record
from hulldown.annotate.record_fields import Pixel, Share, Side, invalid_field_sentences
from hulldown.annotate.rectangles import rectangle_corners
from hulldown.base.errors import DatasetError
from hulldown.base.outside import MAX_DATA_BYTES, convert_parsed_value, describe_path, read_json
from hulldown.training.evaluation.labels import Labels

INFO_SUFFIX = ".info.json"  # a file next to the results, a `PredictionInfo`


class NewCategory(TypedDict):
    """A detector's class that the dataset lacks, or any of its classes without a dataset."""

    id: int
    name: str


class PredictionInfo(TypedDict):
    """What `predict` writes beside results: ids of all images, and without a dataset their records."""

    detector: str
    images: list[int]
    categories: list[NewCategory]
    pictures: NotRequired[Sequence[Record]]


class _Detection(Struct, kw_only=True):
    """A COCO result; `obb` is center x, center y, width, height, and angle."""

    image_id: int
    category_id: int
    bbox: tuple[Pixel, Pixel, Side, Side] | None = None
    obb: tuple[Pixel, Pixel, Side, Side, Pixel] | None = None
    score: Share


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Predictions(BoxTable):
    """d detections by image, class, falling score, and box; classes are the dataset's, then detections' other ones."""

    name: str  # their name, unique in a comparison
    score: Float[np.ndarray, " d"]
    corners: Float[np.ndarray, "d 4 2"] | None = None  # pixels, of oriented boxes; None if the boxes aren't oriented

    @property
    def rank_in_image_class(self) -> Int[np.ndarray, " d"]:
        """Place of each detection among those of its image and class, from 0."""
        group = self.image * len(self.class_names) + self.class_index  # ascends
        return np.arange(len(group)) - np.searchsorted(group, group)


def read_predictions(path: Path | str, labels: Labels, *, name: str | None = None) -> Predictions:
    """Read COCO results, a list or an object's ``annotations``; `name` None: the file's without extension."""
    path = Path(path)
    found, names = _read_results_file(path), {}
    if isinstance(found, dict):
        _require_same_images(path, found.get("images"), labels)
        names, found = _category_names_by_id(found), found.get("annotations")
    info = path.with_name(path.name + INFO_SUFFIX)
    if info.exists() and isinstance(listed := _read_results_file(info), dict):
        _require_same_images(info, listed.get("images"), labels)
        names |= _category_names_by_id(listed)
    if not isinstance(found, list):
        raise DatasetError("isn't COCO results: expected a list of detections", path=path, remedy="name a file of detections")
    return predictions_from_results(found, labels, path=path, name=name or path.stem, names=names)


def predictions_from_results(
    found: Sequence[object], labels: Labels, *, path: Path, name: str, names: Mapping[int, str] | None = None
) -> Predictions:
    """Return detections from a list; `names` are those of categories that the dataset lacks."""
    try:
        rows = convert_parsed_value(found, list[_Detection])
    except ValueError:
        number, problem = next((i, problem) for i, each in enumerate(found) for problem in _find_result_problems(each))
        raise _detection_error(f"{number}: {problem}", path, labels) from None
    index = {image.id: i for i, image in enumerate(labels.images)}
    oriented = any(row.obb is not None for row in rows)
    for i, row in enumerate(rows):
        if row.image_id not in index:
            raise _detection_error(f"{i}: image {row.image_id} is not in the dataset", path, labels)
        if (row.obb if oriented else row.bbox) is None:
            raise _detection_error(f"{i}: has no {'obb, which others have' if oriented else 'bbox'}", path, labels)
    known = labels.class_id.tolist()
    others = sorted({row.category_id for row in rows} - set(known))
    class_index = {category: i for i, category in enumerate([*known, *others])}
    image = np.array([index[row.image_id] for row in rows], dtype=np.int64)
    label = np.array([class_index[row.category_id] for row in rows], dtype=np.int64)
    corners = rectangle_corners([row.obb for row in rows if row.obb is not None]) if oriented else None
    if corners is None:
        xywh = np.array([row.bbox for row in rows], dtype=np.float64).reshape(-1, 4)
    else:
        xywh = np.concatenate([corners.min(axis=1), np.ptp(corners, axis=1)], axis=1)
    score = np.array([row.score for row in rows], dtype=np.float64)
    called = (*labels.class_names, *((names or {}).get(category, f"category {category}") for category in others))
    boxes = xywh if corners is None else np.concatenate([xywh, corners.reshape(-1, 8)], axis=1)
    order = np.lexsort((*boxes.T[::-1], -score, label, image))
    turned = None if corners is None else corners[order]
    return Predictions(
        name=name,
        class_names=called,
        image=image[order],
        class_index=label[order],
        xywh=xywh[order],
        score=score[order],
        corners=turned,
    )


def _find_result_problems(detection: object) -> Iterator[str]:
    if isinstance(detection, dict):
        yield from invalid_field_sentences(detection, _Detection)
    else:
        yield f"{detection!r:.60} isn't an object"


def _detection_error(problem: str, path: Path, labels: Labels) -> DatasetError:
    return DatasetError(f"detection {problem}", path=path, remedy=f"give results of {labels.path}")


def _category_names_by_id(info: Mapping[str, object]) -> dict[int, str]:
    listed = info.get("categories")
    records = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    return {one["id"]: one["name"] for one in records if type(one.get("id")) is int and isinstance(one.get("name"), str)}


def _require_same_images(path: Path, listed: object, labels: Labels) -> None:
    if listed is None:
        return
    found = [one.get("id") if isinstance(one, dict) else one for one in listed] if isinstance(listed, list) else [None]
    theirs = {one for one in found if isinstance(one, int)}
    if not all(isinstance(one, int) for one in found):
        raise DatasetError("'images' isn't a list of image ids", path=path, remedy="repair or remove it")
    known = {image.id for image in labels.images}
    if lost := sorted(known - theirs):
        raise DatasetError(
            f"image {lost[0]} of {labels.path} is not among its images ({len(lost)} are missing)",
            path=path,
            remedy="predict the whole dataset",
        )
    if strays := sorted(theirs - known):
        raise DatasetError(
            f"image {strays[0]} is not in {labels.path} ({len(strays)} are not)",
            path=path,
            remedy="evaluate against the dataset that was predicted",
        )


def _read_results_file(path: Path) -> object:
    refuse = partial(DatasetError, path=path, remedy="name a file of COCO results")
    if path.exists() and (kind := describe_path(path)) not in ("a JSON list", "a JSON file", "another file", "empty"):
        raise refuse(f"is {kind}, not a file of detections")
    return read_json(path, object, refuse, what="valid JSON", most=MAX_DATA_BYTES)
