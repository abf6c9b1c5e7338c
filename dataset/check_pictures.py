"""Whether the pictures of a dataset are there, whole, and those that its records are about."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from dataset.names import place_of
from dataset.picture_files import UnreadableError, read_picture
from dataset.records import Finding
from dataset.seals import PICTURE_KEY, digest
from geometry.files import stays_inside

DECODERS = 4


def check_pictures(
    folder: Path,
    coco: Mapping[str, Any],
    *,
    fast: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Finding]:
    """What is wrong with the files of a dataset's pictures.

    Parameters
    ----------
    folder
        The dataset's.
    coco
        The dataset.
    fast
        Whether to look only at which files are there.
    progress
        Told (done, all) after each image.
    """
    images = coco["images"]
    contents: dict[str, str] = {}
    with ThreadPoolExecutor(DECODERS) as pool:
        # Chunks, so that a million results are not queued up.
        for start in range(0, len(images), 1024):
            chunk = images[start : start + 1024]
            results = pool.map(lambda image: _check(folder, image, fast=fast), chunk)
            for done, (image, (findings, found)) in enumerate(zip(chunk, results, strict=True), start=start + 1):
                yield from findings
                name = str(image.get("file_name"))
                if found is not None and (other := contents.setdefault(found, name)) != name:
                    yield Finding("warning", name, f"is the same picture as {other}")
                if progress is not None:
                    progress(done, len(images))
    known = {place_of(str(image.get("file_name"))) for image in images}
    if (folder / "images").is_dir():
        present = {path.relative_to(folder).as_posix() for path in (folder / "images").rglob("*") if path.is_file()}
        if strays := sorted(present - known):
            more = f", like {len(strays) - 1} more" if len(strays) > 1 else ""
            yield Finding("warning", strays[0], f"belongs to no record{more}")


def _check(folder: Path, image: Mapping[str, Any], *, fast: bool) -> tuple[list[Finding], str | None]:
    """What is wrong with a picture, and the hash of its content."""
    name = image.get("file_name")
    if not stays_inside(name):
        problem = f"file_name {name!r:.120} is no path inside the dataset"
        return [Finding("error", f"image {image['id']}", problem)], None
    path = folder / name
    if fast:
        return [] if path.is_file() else [Finding("error", name, "is missing")], None
    try:
        picture = read_picture(path)
    except UnreadableError as error:
        return [Finding("error", name, str(error))], None
    findings = []
    if picture.size != (image.get("width"), image.get("height")):
        width, height = picture.size
        stated = f"{image.get('width')} x {image.get('height')}"
        findings.append(Finding("error", name, f"is {width} x {height}, its record says {stated}"))
    found = digest(picture.content)
    recorded = image.get(PICTURE_KEY)
    if recorded is not None and recorded != found:
        problem = (
            f"is not the picture that was recorded: its SHA-256 is {found[:12]}..., recorded is {recorded!s:.12}..."
        )
        findings.append(Finding("error", name, problem))
    return findings, found
