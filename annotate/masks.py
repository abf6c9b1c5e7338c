"""Masks of vehicles by rays, and COCO's run lengths, area, box, and IoU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import ArrayLike
from pycocotools import mask as rle_codec

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR, Camera, directions
from hulldown.geometry.arrays import checked, numbered
from hulldown.geometry.transforms import rotate
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.visibility import TOUCHING

FIRST_LOOK = 256  # pixels that are tested first
MOST_RAYS = 1 << 18  # cast together
LONGEST_NUMBER = 7  # characters of a run length: 35 bits
MOST_PIXELS = 2**32 - 1  # of an image with polygons: pycocotools counts in 32 bits
FARTHEST = 1e6  # pixels to a polygon's corner: pycocotools counts in 32 bits


def vehicle_mask(
    vehicle: PosedVehicle, camera: Camera, *, xywh: ArrayLike | None = None, world: Scene | None = None
) -> Bool[np.ndarray, "h w"]:
    """Return the pixels whose center shows the vehicle; the second of `vehicle_masks`."""
    return vehicle_masks(vehicle, camera, xywh=xywh, world=world)[1]


def vehicle_masks(
    vehicle: PosedVehicle, camera: Camera, *, xywh: ArrayLike | None = None, world: Scene | None = None
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return the pixels whose center is on the vehicle, and those of them that nothing hides.

    Parameters
    ----------
    vehicle
        The vehicle, in one pose.
    camera
        What sees it; nothing nearer than `NEAR` is seen.
    xywh
        The vehicle's box in the image: only pixels with their center in it are tested. None: all pixels.
    world
        Occluders: ground, obstacles, and other vehicles. None: nothing hides it.

    Returns
    -------
    (height, width) each: the whole silhouette in the image, and what is visible of it.
    """
    size = np.array([camera.intrinsics.width, camera.intrinsics.height])
    whole, mask = np.zeros((2, *size[::-1]), dtype=bool)
    box = np.append([0.0, 0.0], size) if xywh is None else checked(xywh, "xywh", (4,))
    first, end = _pixels_in(box, size)
    rows, columns = np.mgrid[first[1] : end[1], first[0] : end[0]].reshape(2, -1)
    if not len(rows):
        return whole, mask
    along = directions(camera.intrinsics, np.stack([columns, rows], axis=1) + 0.5) @ camera.world_from_camera[:3, :3].T
    origins = camera.position + NEAR * along
    distance = vehicle.cast(origins, along).distance
    seen = np.flatnonzero(np.isfinite(distance))
    whole[rows[seen], columns[seen]] = True
    if world is not None:
        seen = seen[~world.occluded(origins[seen], along[seen], max_distance=distance[seen] - TOUCHING)]
    mask[rows[seen], columns[seen]] = True
    return whole, mask


def show_pixels(
    subjects: Sequence[PosedVehicle],
    world_from_camera: Float[np.ndarray, "n 4 4"],
    intrinsics: Intrinsics,
    *,
    xywh: Float[np.ndarray, "n 4"],
    world: Scene,
) -> Bool[np.ndarray, " n"]:
    """Return whether the `vehicle_mask` of each camera's subject has any pixel; a few pixels are tested first.

    Parameters
    ----------
    subjects
        Vehicles in rows: one for each camera.
    world_from_camera, intrinsics
        The cameras.
    xywh
        (n, 4) boxes of the subjects.
    world
        Their occluders.
    """
    shown = np.zeros(len(xywh), dtype=bool)
    first, end = _pixels_in(xywh, intrinsics.size)
    width, pixels = end[:, 0] - first[:, 0], (end - first).prod(axis=1)
    few = pixels // FIRST_LOOK + 1

    def look(cameras: Int[np.ndarray, " k"], step: Int[np.ndarray, " k"]) -> None:
        """Test every step-th pixel of these cameras' boxes."""
        count = -(-pixels[cameras] // step)
        row, number = numbered(count)
        pixel = number * step[row]
        camera = cameras[row]
        uv = np.stack([pixel % width[camera], pixel // width[camera]], axis=1) + first[camera] + 0.5
        poses = world_from_camera[camera]
        along = rotate(poses[:, :3, :3], directions(intrinsics.rows(camera), uv[:, None]))[:, 0]
        start, distance = poses[:, :3, 3] + NEAR * along, np.full(len(row), np.inf)
        for subject in subjects:
            met = subject.rows(cameras).cast(start, along, row=row)
            distance = np.minimum(distance, met.distance)
        seen = np.flatnonzero(np.isfinite(distance))
        reach = distance[seen] - TOUCHING
        hidden = world.rows(cameras).occluded(start[seen], along[seen], row=row[seen], max_distance=reach)
        shown[camera[seen[~hidden]]] = True

    for step in (few, np.ones_like(few)):
        cameras = np.flatnonzero(~shown & (pixels > 0) & ((step is few) | (few > 1)))
        # As many cameras together as have some hundred thousand rays between them.
        block = np.cumsum(-(-pixels[cameras] // step[cameras])) // MOST_RAYS
        for some in np.split(cameras, np.flatnonzero(np.diff(block)) + 1):
            if len(some):
                look(some, step[some])
    return shown


def _pixels_in(
    xywh: Float[np.ndarray, "... 4"], size: Shaped[np.ndarray, "... 2"]
) -> tuple[Int[np.ndarray, "... 2"], Int[np.ndarray, "... 2"]]:
    """First column and row, and those after the last, of the pixels whose centers are in boxes."""
    first = np.clip(np.ceil(xywh[..., :2] - 0.5), 0, size).astype(int)
    return first, np.clip(np.floor(xywh[..., :2] + xywh[..., 2:] - 0.5) + 1, first, size).astype(int)


def encode(mask: ArrayLike) -> dict[str, object]:
    """Return a mask (h, w) as COCO's compressed run lengths, ready for JSON."""
    pixels = checked(mask, "mask", ("h", "w"), dtype=np.bool_)
    record = rle_codec.encode(np.asfortranarray(pixels, dtype=np.uint8))
    return {"size": [int(n) for n in record["size"]], "counts": record["counts"].decode("ascii")}


def decode(segmentation: object, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Return a COCO segmentation as a mask: run lengths, compressed or not, or a list of polygons.

    Raises
    ------
    ValueError
        If it is neither, or its size is not that of the image.
    """
    counts = run_lengths(segmentation, width, height)
    return np.repeat(np.arange(len(counts)) % 2 == 1, counts).reshape(width, height).T


def run_lengths(segmentation: object, width: int, height: int) -> Int[np.ndarray, " n"]:
    """Return a COCO segmentation as run lengths, column by column, background first; errors of `decode`.

    They are few however large the image is.
    """
    if isinstance(segmentation, Mapping):
        size, given = segmentation.get("size"), segmentation.get("counts")
        if size != [height, width]:
            raise ValueError(f"segmentation: expected size [{height}, {width}], got {size!r:.60}")
        if isinstance(given, list) and all(isinstance(n, int) and 0 <= n <= width * height for n in given):
            counts = np.array(given, dtype=np.int64)
        elif isinstance(given, str):
            counts = _counts(given)
        else:
            raise ValueError(f"segmentation: expected run lengths under 'counts', got {given!r:.60}")
        if (counts < 0).any() or counts.sum() != width * height:
            raise ValueError(f"segmentation: expected run lengths of {width * height} pixels, got {counts.sum()}")
        return counts
    if not isinstance(segmentation, list) or not segmentation or not all(map(_is_ring, segmentation)):
        raise ValueError("segmentation: expected polygons of at least three points (x1, y1, x2, y2, ...)")
    if width * height > MOST_PIXELS:
        raise ValueError(f"segmentation: expected polygons in an image of {MOST_PIXELS} pixels at most")
    return _counts(rle_codec.merge(rle_codec.frPyObjects(segmentation, height, width))["counts"].decode("ascii"))


def runs(segmentation: object, width: int, height: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return where each run of a COCO segmentation's pixels begins and ends, column by column; errors of `decode`."""
    ends = np.cumsum(run_lengths(segmentation, width, height))
    first, end = ends[:-1:2], ends[1::2]
    first, end = first[end > first], end[end > first]
    return first, end


def covers(outer: object, inner: object, width: int, height: int) -> bool:
    """Return whether a COCO segmentation has all pixels of another, without decoding them; errors of `decode`."""
    (first, end), (start, stop) = runs(outer, width, height), runs(inner, width, height)
    ends, pixels = np.stack([first, end], axis=1).ravel(), np.cumsum(end - first)
    counted = np.stack([pixels - (end - first), pixels], axis=1).ravel()  # pixels of `outer` before each end
    if not len(ends):
        return not len(start)
    return bool((np.interp(stop, ends, counted) - np.interp(start, ends, counted) == stop - start).all())


def extent(segmentation: object, width: int, height: int) -> tuple[int, Float[np.ndarray, "4"] | None]:
    """Area and `mask_box` of a COCO segmentation, without decoding it; errors of `decode`."""
    first, end = runs(segmentation, width, height)
    if not len(first):
        return 0, None
    left, right = first // height, (end - 1) // height
    several = left < right  # columns: such a run goes through the last row of one and the first of the next
    top = 0 if several.any() else (first % height).min()
    bottom = height if several.any() else ((end - 1) % height).max() + 1
    box = np.array([left.min(), top, right.max() + 1 - left.min(), bottom - top], dtype=np.float64)
    return int((end - first).sum()), box


def _counts(text: str) -> Int[np.ndarray, " n"]:
    """Read run lengths from COCO's compressed text; pycocotools writes past its memory if they are damaged.

    A number has five bits a character, lowest first, plus 32 on all but its last. From the fourth number on, it's the
    difference from the run before the last.
    """
    codes = np.frombuffer(text.encode("ascii", "replace"), dtype=np.uint8).astype(np.int64) - 48
    last = np.flatnonzero(codes & 32 == 0)
    first = np.append(0, last[:-1] + 1)
    whole = text.isascii() and len(last) > 0 and last[-1] == len(codes) - 1
    length = last - first + 1 if whole else np.array([0])
    if not whole or codes.min() < 0 or codes.max() > 63 or length.max() > LONGEST_NUMBER:
        raise ValueError("segmentation: expected compressed run lengths under 'counts', got damaged ones")
    place = np.arange(len(codes)) - np.repeat(first, length)
    numbers = np.add.reduceat((codes & 31) << (5 * place), first)
    numbers -= (codes[last] >> 4 & 1) << (5 * length)  # the highest bit is the sign
    numbers[1::2], numbers[2::2] = np.cumsum(numbers[1::2]), np.cumsum(numbers[2::2])
    return numbers


def _is_ring(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) >= 6
        and len(value) % 2 == 0
        and all(isinstance(n, int | float) and abs(n) <= FARTHEST for n in value)
    )


def mask_box(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "4"] | None:
    """Xywh of the pixels of a mask, outer edge to outer edge; None if it has none."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return None
    x, y = float(columns[0]), float(rows[0])
    return np.array([x, y, columns[-1] + 1.0 - x, rows[-1] + 1.0 - y])


def iou(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    """Shared pixels over all pixels of two masks; 1 for two empty ones."""
    either = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / either) if either else 1.0
