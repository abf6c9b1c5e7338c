"""Check that a dataset's pictures exist, are undamaged, belong to their records, and show their targets.

Thresholds of targets were measured on 240 renders of the demo, 320 x 180 pixels at 5 samples, eight skies, fog in a
seventh of them; docs/dataset.md has the figures.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import imagehash
import numpy as np
import PIL.Image
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.coco_types import Coco, Record
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import decode_mask
from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.annotate.records import Image
from hulldown.assets.picture_files import UPRIGHT_ORIENTATION, describe_size_difference, read_picture
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.errors import DatasetError
from hulldown.base.files import is_safe_relative_path
from hulldown.dataset.record_checks import Finding
from hulldown.dataset.store.entries import normal_file_name
from hulldown.dataset.store.placed_pictures import resolve_own_picture

CHECKER_THREADS = 2  # four take half as much CPU time again, since they contend for memory and the interpreter
MAX_PICTURE_PIXELS = 1 << 27  # each thread decodes one picture at a time, which takes 0.4 GB
HASH_SIDE_BITS = 16  # a hash has 256 bits
MAX_TWIN_HASH_BITS = 26  # of 256 that may differ; docs/dataset.md has the measurements
MIN_TEXTURE_DEVIATION_LEVELS = 2.0  # of 255: a picture with less has nothing to compare
MIN_CONTRAST_LEVELS = 1.0  # of 255: a target with less, outside and within itself, isn't in the picture
CLEAR_CONTRAST_LEVELS = 8.0  # of 255: a target with less is hard to make out; sound renders had 20.9 and more
MIN_BRIGHTEST, MAX_DARKEST = 16.0, 250.0  # of 255: the brightest twentieth of a sound target had 34 and more
# Of the pixels: Blender's color of missing pictures as AgX shows it, white or warm light up to twice white.
MAX_MAGENTA_SHARE, MAX_MAGENTA_GREEN, MIN_MAGENTA_BALANCE, MIN_MAGENTA_LEVEL = 0.03, 0.75, 0.8, 40
SURROUNDINGS_WIDTH_SHARE = 0.25  # of the mask's longer side


def find_picture_problems(
    folder: Path, coco: Coco, sound: Mapping[int, Image], *, fast: bool, progress: Callable[[int, int], None]
) -> Iterator[Finding]:
    """Find problems with a dataset's picture files; `sound` has its valid images by id."""
    images = coco["images"]
    contents: dict[str, str] = {}
    digests: list[str | None] = []
    hashes: list[Bool[np.ndarray, "256"] | None] = []
    with ThreadPoolExecutor(CHECKER_THREADS) as pool:
        # Chunks, so that a million results are not queued up.
        for start in range(0, len(images), 1024):
            chunk = images[start : start + 1024]
            results = pool.map(
                lambda image: _picture_findings_and_hashes(folder, image, sound.get(image["id"]), fast=fast), chunk
            )
            for done, (image, (findings, found, hashed)) in enumerate(zip(chunk, results, strict=True), start=start + 1):
                yield from findings
                hashes.append(hashed)
                digests.append(found)
                name = str(image.get("file_name"))
                if found is not None and (second := contents.setdefault(found, name)) != name:
                    yield Finding("warning", name, f"is the same picture as {second}")
                progress(done, len(images))
    for i, j in near_duplicate_pairs(hashes, hashes).tolist():
        first, second = str(images[i].get("file_name")), str(images[j].get("file_name"))
        if i > j and digests[i] != digests[j]:
            yield Finding("warning", first, f"shows the same as {second}: keep both in one split, or delete one")
    known = {normal_file_name(str(image.get("file_name"))) for image in images}
    if (folder / "images").is_dir():
        present = {path.relative_to(folder).as_posix() for path in (folder / "images").rglob("*") if path.is_file()}
        if strays := sorted(present - known):
            more = f", like {len(strays) - 1} more" if len(strays) > 1 else ""
            yield Finding("warning", strays[0], f"belongs to no record{more}")


def _picture_findings_and_hashes(
    folder: Path, record: Record, image: Image | None, *, fast: bool
) -> tuple[list[Finding], str | None, Bool[np.ndarray, "256"] | None]:
    name = record.get("file_name")
    if not is_safe_relative_path(name):  # the check of records finds it
        return [], None, None
    try:
        path = resolve_own_picture(folder, name)
        if fast:
            return [], None, None
        picture = read_picture(path, largest=MAX_PICTURE_PIXELS if record.get(PICTURE_HASH_KEY) else None)
    except DatasetError as error:
        return [Finding("error", name, error.problem)], None, None
    findings = []
    if picture.orientation != UPRIGHT_ORIENTATION:
        problem = f"has EXIF orientation {picture.orientation}, which some tools ignore: store it as displayed"
        findings.append(Finding("warning", name, problem))
    stated = (record.get("width"), record.get("height"))
    if picture.size != stated:
        findings.append(Finding("error", name, describe_size_difference(picture, stated)))
    elif picture.pixels is not None and is_rendered_image(record) and image is not None:
        findings += find_appearance_problems(image, picture.pixels)
        if (share := magenta_share(picture.pixels)) > MAX_MAGENTA_SHARE:
            problem = f"{100 * share:.0f} % of it is magenta, Blender's color of missing pictures: look for them, and "
            findings.append(Finding("error", name, f"{problem}render again", share))
    actual = hashlib.sha256(picture.content).hexdigest()
    recorded = record.get(PICTURE_HASH_KEY)
    if recorded is not None and recorded != actual:
        problem = f"is not the picture that was recorded: its SHA-256 is {actual[:12]}..., recorded is {recorded!s:.12}..."
        findings.append(Finding("error", name, problem))
    looked_at = picture.pixels if not is_rendered_image(record) else None
    return findings, actual, None if looked_at is None else perceptual_hash(looked_at)


def perceptual_hash(pixels: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "256"] | None:
    """Return a picture's perceptual DCT hash (Zauner, 2010, section 3.2.1); None without contrast."""
    gray = PIL.Image.fromarray(pixels).convert("L")
    if np.std(np.asarray(gray.reduce(max(1, min(gray.size) // 64)))) < MIN_TEXTURE_DEVIATION_LEVELS:
        return None
    return imagehash.phash(gray, hash_size=HASH_SIDE_BITS).hash.ravel()


def near_duplicate_pairs(
    first: Sequence[Bool[np.ndarray, "256"] | None], second: Sequence[Bool[np.ndarray, "256"] | None]
) -> Int[np.ndarray, "n 2"]:
    """Return index pairs of near duplicates, (n, 2)."""
    (rows, ones), (columns, others) = _hashed_rows_and_signs(first), _hashed_rows_and_signs(second)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for start in range(0, len(ones), 1024):  # blocks, so that a large dataset doesn't need a large matrix
        differing = (HASH_SIDE_BITS * HASH_SIDE_BITS - ones[start : start + 1024] @ others.T) / 2.0
        found.append(np.argwhere(differing <= MAX_TWIN_HASH_BITS) + np.array([start, 0]))
    pairs = np.concatenate(found)
    return np.stack([rows[pairs[:, 0]], columns[pairs[:, 1]]], axis=1)


def _hashed_rows_and_signs(
    hashes: Sequence[Bool[np.ndarray, "256"] | None],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 256"]]:
    """Return which pictures have a hash, and its bits as 1 and -1: their products count equal and differing bits."""
    there = {i: hashed for i, hashed in enumerate(hashes) if hashed is not None}
    bits = np.array(list(there.values()), dtype=np.float32).reshape(-1, HASH_SIDE_BITS * HASH_SIDE_BITS)
    return np.array(list(there), dtype=np.int64), 2.0 * bits - 1.0


@dataclass(frozen=True, slots=True)
class TargetAppearance:
    """A target's look in a picture; levels from 0 to 255."""

    # the difference of its mean color from its surroundings', in the channel where it's largest, or the range of its
    # own luminance, 10th to 90th percentile, if that is larger
    contrast: float
    darkest: float  # darkest, brightest: its luminance, 5th and 95th percentile
    brightest: float


def is_rendered_image(image: Record) -> bool:
    """Return whether an image record is of a render; photographs' records lack two keys."""
    return any(image.get(key) is not None for key in (PICTURE_HASH_KEY, "world_from_camera"))


def find_appearance_problems(image: Image, pixels: UInt8[np.ndarray, "h w 3"]) -> Iterator[Finding]:
    """Find targets of a rendered picture that are black, white, or without contrast."""
    height, width = pixels.shape[:2]
    masked = []
    for label in image.labels:
        with contextlib.suppress(ValueError):  # another check finds it
            masked.append((label, decode_mask(label.read(VisibleMask).segmentation, width, height)))
    covering = sum((mask for _, mask in masked), np.zeros((height, width), dtype=np.uint16))  # labels of each pixel
    for label, mask in masked:
        if not label.crowd and (seen := target_appearance(pixels, mask, covering > mask)) is not None:
            yield from _target_appearance_problems(f"{image.file_name}: annotation {label.id}", seen)


def _target_appearance_problems(where: str, seen: TargetAppearance) -> Iterator[Finding]:
    if seen.brightest < MIN_BRIGHTEST:
        yield Finding("error", where, f"its pixels are black: {seen.brightest:.1f} of 255", seen.brightest)
    elif seen.darkest > MAX_DARKEST:
        yield Finding("error", where, f"its pixels are white: {seen.darkest:.1f} of 255", seen.darkest)
    elif seen.contrast < MIN_CONTRAST_LEVELS:
        problem = f"cannot be seen in its picture: its contrast is {seen.contrast:.1f} of 255"
        yield Finding("error", where, problem, seen.contrast)
    elif seen.contrast < CLEAR_CONTRAST_LEVELS:
        problem = f"is hard to make out: its contrast is {seen.contrast:.1f} of 255"
        yield Finding("warning", where, problem, seen.contrast)


def magenta_share(picture: UInt8[np.ndarray, "h w 3"]) -> float:
    """Return the share of a picture's pixels that have Blender's color of missing pictures, on a vehicle or ground."""
    red, green, blue = np.moveaxis(picture[::2, ::2].astype(np.float32), -1, 0)
    low, high = np.minimum(red, blue), np.maximum(red, blue)
    found = (green < MAX_MAGENTA_GREEN * low) & (low > MIN_MAGENTA_BALANCE * high) & (low > MIN_MAGENTA_LEVEL)
    return float(found.mean())


def target_appearance(
    picture: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], others: Bool[np.ndarray, "h w"]
) -> TargetAppearance | None:
    """Measure the look of a target's pixels, None without any; pixels of `others` don't count as surroundings."""
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = max(3, int(SURROUNDINGS_WIDTH_SHARE * max(np.ptp(columns), np.ptp(rows))))
    near = tuple(slice(max(along[0] - margin, 0), along[-1] + margin + 1) for along in (rows, columns))
    colors, around = picture[near].astype(np.float32), ~(mask | others)[near]
    inside = colors[mask[near]]
    low, darkest, brightest, high = np.percentile(inside @ LUMINANCE_WEIGHTS, [10, 5, 95, 90]).tolist()
    apart = np.abs(inside.mean(axis=0) - colors[around].mean(axis=0)).max() if around.any() else 0.0
    return TargetAppearance(max(float(apart), high - low), darkest, brightest)
