"""Is a dataset what it says it is: records, files, boxes, masks; and how far annotations are from rendered masks."""

from __future__ import annotations

import contextlib
import hashlib
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike
from PIL import Image
from pycocotools.coco import COCO

from annotate.masks import decode, iou, mask_box
from dataset.document import ANNOTATIONS_NAME, read_coco
from dataset.planned import check_planned
from dataset.records import Finding, check_annotations, check_categories, check_images
from geometry.arrays import checked
from geometry.files import stays_inside

DECODERS = 4


def verify(
    dataset: Path | str,
    *,
    plan: Path | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Finding]:
    """Everything that is wrong with a dataset, as it is found.

    Parameters
    ----------
    dataset
        Its folder.
    plan
        A plan it was rendered from: names, sizes, poses, classes and boxes are held against it, row by row.
    progress
        Told (done, all) after each image.

    Raises
    ------
    DatasetError
        If there is no dataset, or it cannot be read at all.
    ConfigError
        If the plan is none.
    """
    folder = Path(dataset)
    coco = read_coco(folder)
    yield from check_categories(coco["categories"])
    yield from check_images(coco["images"])
    yield from check_annotations(coco)
    if plan is not None:
        yield from check_planned(coco, Path(plan))
    yield from _check_loading(folder / ANNOTATIONS_NAME)
    yield from _check_files(folder, coco["images"], progress)


@dataclass(frozen=True, slots=True)
class MaskComparison:
    """How far an annotation is from what was rendered.

    Parameters
    ----------
    box_error
        Largest distance in pixels between a side of the annotated box and of the rendered mask's; inf where one of
        them is missing.
    mask_iou
        Overlap of annotated and rendered visible mask; nan where the annotation has no mask.
    """

    box_error: float
    mask_iou: float


def compare(
    bbox: ArrayLike | None,
    alone: Bool[np.ndarray, "h w"],
    *,
    segmentation: Any = None,
    visible: Bool[np.ndarray, "h w"] | None = None,
) -> MaskComparison:
    """Hold an annotation against rendered masks.

    Parameters
    ----------
    bbox
        xywh of the vehicle's surface in the image; None if it is said to have none.
    alone
        Where the render shows the vehicle with nothing in front of it: what the box must hold.
    segmentation
        The annotated visible mask, as COCO has it; None if there is none.
    visible
        Where the render shows the vehicle behind whatever hides it.

    Raises
    ------
    ValueError
        If there is a segmentation that is none.
    """
    rendered = mask_box(alone)
    if bbox is None or rendered is None:
        box_error = 0.0 if bbox is None and rendered is None else math.inf
    else:
        box = checked(bbox, "bbox", (4,))
        low, high = rendered[:2] - box[:2], rendered[:2] + rendered[2:] - box[:2] - box[2:]
        box_error = float(max(np.abs(low).max(), np.abs(high).max()))
    if not segmentation or visible is None:
        return MaskComparison(box_error, math.nan)
    height, width = visible.shape
    return MaskComparison(box_error, iou(decode(segmentation, width, height), visible))


def _check_loading(path: Path) -> Iterator[Finding]:
    if not path.exists():
        yield Finding("warning", path.name, "is not there yet: the run has not been closed; render again to finish it")
        return
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            loaded = COCO(str(path))
            loaded.loadAnns(loaded.getAnnIds())
    except Exception as error:
        # Whatever stops pycocotools stops those who train with it.
        yield Finding("error", path.name, f"pycocotools cannot load it: {type(error).__name__}: {error}")


def _check_files(
    folder: Path,
    images: Sequence[Mapping[str, Any]],
    progress: Callable[[int, int], None] | None,
) -> Iterator[Finding]:
    contents: dict[bytes, str] = {}
    with ThreadPoolExecutor(DECODERS) as pool:
        # Chunks, so that a million results are not queued up.
        for start in range(0, len(images), 1024):
            chunk = images[start : start + 1024]
            results = pool.map(lambda image: _check_file(folder, image), chunk)
            for done, (image, (findings, digest)) in enumerate(zip(chunk, results, strict=True), start=start + 1):
                yield from findings
                name = str(image.get("file_name"))
                if digest is not None and (other := contents.setdefault(digest, name)) != name:
                    yield Finding("warning", name, f"is the same picture as {other}")
                if progress is not None:
                    progress(done, len(images))
    known = {str(image.get("file_name")) for image in images}
    if (folder / "images").is_dir():
        present = {path.relative_to(folder).as_posix() for path in (folder / "images").rglob("*") if path.is_file()}
        if strays := sorted(present - known):
            more = f", like {len(strays) - 1} more" if len(strays) > 1 else ""
            yield Finding("warning", strays[0], f"belongs to no record{more}")


def _check_file(folder: Path, image: Mapping[str, Any]) -> tuple[list[Finding], bytes | None]:
    name = image.get("file_name")
    if not stays_inside(name):
        return [Finding("error", f"image {image['id']}", f"file_name {name!r} is no path inside the dataset")], None
    path = folder / name
    if not path.is_file():
        return [Finding("error", name, "is missing")], None
    try:
        with Image.open(path) as picture:
            size = picture.size
            picture.load()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        return [Finding("error", name, f"cannot be decoded: {error}")], None
    findings = []
    if size != (image.get("width"), image.get("height")):
        stated = f"{image.get('width')} x {image.get('height')}"
        findings.append(Finding("error", name, f"is {size[0]} x {size[1]}, its record says {stated}"))
    return findings, hashlib.sha256(path.read_bytes()).digest()
