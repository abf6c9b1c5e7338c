"""Check that a dataset's pictures exist, are undamaged, and belong to their records."""

from __future__ import annotations

import contextlib
import hashlib
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from hulldown.assets.coco_types import Coco, Record
from hulldown.assets.picture_files import UPRIGHT, read_picture, size_problem
from hulldown.base.errors import DatasetError
from hulldown.base.files import stays_inside
from hulldown.dataset.images import Image
from hulldown.dataset.records import Finding, sound_images
from hulldown.dataset.store.declared import PICTURE_KEY
from hulldown.dataset.store.entries import place_of
from hulldown.dataset.store.placed_pictures import own_picture
from hulldown.dataset.verification.near_duplicates import near_duplicates, picture_hash
from hulldown.dataset.verification.target_appearance import check_appearances, is_rendered

CHECKERS = 2  # threads; four take half as much CPU time again, since they contend for memory and the interpreter
LARGEST = 1 << 27  # pixels: each thread decodes one picture at a time, 0.4 GB


def check_pictures(folder: Path, coco: Coco, *, fast: bool, progress: Callable[[int, int], None]) -> Iterator[Finding]:
    """Find problems with a dataset's picture files."""
    images = coco["images"]
    sound = sound_images(coco)
    contents: dict[str, str] = {}
    digests: list[str | None] = []
    hashes: list[Bool[np.ndarray, "256"] | None] = []
    with ThreadPoolExecutor(CHECKERS) as pool:
        # Chunks, so that a million results are not queued up.
        for start in range(0, len(images), 1024):
            chunk = images[start : start + 1024]
            results = pool.map(lambda image: _check(folder, image, sound.get(image["id"]), fast=fast), chunk)
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
    yield from _linked_elsewhere(folder, images)
    known = {place_of(str(image.get("file_name"))) for image in images}
    if (folder / "images").is_dir():
        present = {path.relative_to(folder).as_posix() for path in (folder / "images").rglob("*") if path.is_file()}
        if strays := sorted(present - known):
            more = f", like {len(strays) - 1} more" if len(strays) > 1 else ""
            yield Finding("warning", strays[0], f"belongs to no record{more}")


def _linked_elsewhere(folder: Path, images: Sequence[Record]) -> Iterator[Finding]:
    """Find pictures without a hash that are hard links to files outside of the dataset."""
    links: dict[tuple[int, int], list[str]] = {}
    counts: dict[tuple[int, int], int] = {}
    for image in images:
        name = image.get("file_name")
        if not stays_inside(name):
            continue
        with contextlib.suppress(OSError):  # found elsewhere
            status = (folder / name).stat()
            file = (status.st_dev, status.st_ino)
            counts[file] = status.st_nlink if stat.S_ISREG(status.st_mode) else 0
            links.setdefault(file, []).append(name if image.get(PICTURE_KEY) is None else "")
    outside = [name for file, names in links.items() for name in names if name and counts[file] > len(set(names))]
    if outside:
        more = f", like {len(outside) - 1} more" if len(outside) > 1 else ""
        problem = f"is a hard link to a file outside of the dataset{more}: make sure that join or export made it"
        yield Finding("warning", outside[0], problem)


def _check(
    folder: Path, record: Record, image: Image | None, *, fast: bool
) -> tuple[list[Finding], str | None, Bool[np.ndarray, "256"] | None]:
    """Return a picture's problems, the hash of its bytes, and a photograph's perceptual hash.

    `image` is the image of its record, if that fits.
    """
    name = record.get("file_name")
    if not stays_inside(name):
        problem = f"file_name {name!r:.120} is no path inside the dataset"
        return [Finding("error", f"image {record['id']}", problem)], None, None
    try:
        path = own_picture(folder, name)
        if fast:
            return [], None, None
        picture = read_picture(path, largest=LARGEST if record.get(PICTURE_KEY) else None)
    except DatasetError as error:
        return [Finding("error", name, error.problem)], None, None
    findings = []
    if picture.orientation != UPRIGHT:
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
