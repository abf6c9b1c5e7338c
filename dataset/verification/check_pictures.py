"""Check that a dataset's pictures exist, are undamaged, and belong to their records."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from hulldown.annotate.coco_types import Coco, Record
from hulldown.annotate.record_fields import PICTURE_KEY
from hulldown.annotate.records import Image
from hulldown.assets.picture_files import UPRIGHT_ORIENTATION, read_picture, size_problem
from hulldown.base.errors import DatasetError
from hulldown.base.files import stays_inside
from hulldown.dataset.records import Finding
from hulldown.dataset.store.entries import normal_name
from hulldown.dataset.store.placed_pictures import resolve_own_picture
from hulldown.dataset.verification.near_duplicates import near_duplicates, picture_hash
from hulldown.dataset.verification.target_appearance import check_appearances, is_rendered

CHECKER_THREADS = 2  # threads; four take half as much CPU time again, since they contend for memory and the interpreter
MAX_PICTURE_PIXELS = 1 << 27  # pixels: each thread decodes one picture at a time, 0.4 GB


def check_pictures(
    folder: Path, coco: Coco, sound: Mapping[int, Image], *, fast: bool, progress: Callable[[int, int], None]
) -> Iterator[Finding]:
    """Find problems with a dataset's picture files; `sound` are its images whose records fit, by id."""
    images = coco["images"]
    contents: dict[str, str] = {}
    digests: list[str | None] = []
    hashes: list[Bool[np.ndarray, "256"] | None] = []
    with ThreadPoolExecutor(CHECKER_THREADS) as pool:
        # Chunks, so that a million results are not queued up.
        for start in range(0, len(images), 1024):
            chunk = images[start : start + 1024]
            results = pool.map(lambda image: _check_picture(folder, image, sound.get(image["id"]), fast=fast), chunk)
            for done, (image, (findings, found, hashed)) in enumerate(
                zip(chunk, results, strict=True), start=start + 1
            ):
                yield from findings
                hashes.append(hashed)
                digests.append(found)
                name = str(image.get("file_name"))
                if found is not None and (second := contents.setdefault(found, name)) != name:
                    yield Finding("warning", name, f"is the same picture as {second}")
                progress(done, len(images))
    for i, j in near_duplicates(hashes, hashes).tolist():
        first, second = str(images[i].get("file_name")), str(images[j].get("file_name"))
        if i > j and digests[i] != digests[j]:
            yield Finding("warning", first, f"shows the same as {second}: keep both in one split, or delete one")
    known = {normal_name(str(image.get("file_name"))) for image in images}
    if (folder / "images").is_dir():
        present = {path.relative_to(folder).as_posix() for path in (folder / "images").rglob("*") if path.is_file()}
        if strays := sorted(present - known):
            more = f", like {len(strays) - 1} more" if len(strays) > 1 else ""
            yield Finding("warning", strays[0], f"belongs to no record{more}")


def _check_picture(
    folder: Path, record: Record, image: Image | None, *, fast: bool
) -> tuple[list[Finding], str | None, Bool[np.ndarray, "256"] | None]:
    """Return a picture's problems, its hash, and a photograph's perceptual hash; `image` if its record fits."""
    name = record.get("file_name")
    if not stays_inside(name):  # found among records
        return [], None, None
    try:
        path = resolve_own_picture(folder, name)
        if fast:
            return [], None, None
        picture = read_picture(path, largest=MAX_PICTURE_PIXELS if record.get(PICTURE_KEY) else None)
    except DatasetError as error:
        return [Finding("error", name, error.problem)], None, None
    findings = []
    if picture.orientation != UPRIGHT_ORIENTATION:
        problem = f"has EXIF orientation {picture.orientation}, which some tools ignore: store it as displayed"
        findings.append(Finding("warning", name, problem))
    stated = (record.get("width"), record.get("height"))
    if picture.size != stated:
        findings.append(Finding("error", name, size_problem(picture, stated)))
    elif picture.pixels is not None and is_rendered(record) and image is not None:
        findings += check_appearances(image, picture.pixels)
    actual = hashlib.sha256(picture.content).hexdigest()
    recorded = record.get(PICTURE_KEY)
    if recorded is not None and recorded != actual:
        problem = (
            f"is not the picture that was recorded: its SHA-256 is {actual[:12]}..., recorded is {recorded!s:.12}..."
        )
        findings.append(Finding("error", name, problem))
    looked_at = picture.pixels if not is_rendered(record) else None
    return findings, actual, None if looked_at is None else picture_hash(looked_at)
