"""Masks of vehicles in images by rays, and as COCO stores them: run lengths, area, box, overlap."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from pycocotools import mask as rle_codec

from camera.projection import NEAR, Camera, directions
from camera.target import Standing
from camera.visibility import TOUCHING, Occluder
from geometry.arrays import checked
from geometry.transforms import invert_rigid


def vehicle_mask(
    vehicle: Standing,
    camera: Camera,
    *,
    xywh: ArrayLike | None = None,
    occluders: Sequence[Occluder] = (),
    others: Sequence[Standing] = (),
) -> Bool[np.ndarray, "h w"]:
    """The pixels whose centre shows the vehicle.

    Parameters
    ----------
    vehicle
        The vehicle, in one pose.
    camera
        What sees it; nothing nearer than `NEAR` is seen.
    xywh
        The vehicle's box in the image: only pixels with their centre in it are looked at. None: all pixels.
    occluders
        What may hide the vehicle: a `RayCaster`, an `InstancedScene`, a `Plane`, in world coordinates. With no
        occluders and no others the mask is the whole silhouette in the image.
    others
        Other vehicles that may hide it, each in one pose.

    Returns
    -------
    (height, width), true where the vehicle is seen.
    """
    width, height = camera.intrinsics.width, camera.intrinsics.height
    box = np.array([0.0, 0.0, width, height]) if xywh is None else checked(xywh, "xywh", (4,))
    first = np.clip(np.ceil(box[:2] - 0.5), 0, [width, height]).astype(int)
    end = np.clip(np.floor(box[:2] + box[2:] - 0.5) + 1, first, [width, height]).astype(int)
    rows, columns = np.mgrid[first[1] : end[1], first[0] : end[0]].reshape(2, -1)
    mask = np.zeros((height, width), dtype=bool)
    if not len(rows):
        return mask
    along = directions(camera.intrinsics, np.stack([columns, rows], axis=1) + 0.5)
    pose = camera.world_from_camera[None]
    distance = np.full(len(along), np.inf)
    for part, camera_from_part in vehicle.seen_from(pose):
        met = part.caster.cast(*_rays(invert_rigid(camera_from_part)[0], along))
        distance = np.minimum(distance, met.distance)
    left = np.flatnonzero(np.isfinite(distance))
    for occluder in occluders:
        rays = _rays(camera.world_from_camera, along[left])
        left = left[~occluder.occluded(*rays, max_distance=distance[left] - TOUCHING)]
    for other in others:
        for part, camera_from_part in other.seen_from(pose):
            rays = _rays(invert_rigid(camera_from_part)[0], along[left])
            left = left[~part.caster.occluded(*rays, max_distance=distance[left] - TOUCHING)]
    mask[rows[left], columns[left]] = True
    return mask


def _rays(
    frame_from_camera: Float[np.ndarray, "4 4"], along: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Origins on the near plane, and directions, in another frame."""
    turned = along @ frame_from_camera[:3, :3].T
    return frame_from_camera[:3, 3] + NEAR * turned, turned


def encode(mask: ArrayLike) -> dict[str, Any]:
    """A mask (h, w) as COCO's compressed run lengths, ready for JSON."""
    pixels = checked(mask, "mask", ("h", "w"), dtype=np.bool_)
    record = rle_codec.encode(np.asfortranarray(pixels, dtype=np.uint8))
    return {"size": [int(n) for n in record["size"]], "counts": record["counts"].decode("ascii")}


def decode(segmentation: Any, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """A COCO segmentation as a mask: run lengths, compressed or not, or a list of polygons.

    Raises
    ------
    ValueError
        If it is neither, or its size is not that of the image.
    """
    if isinstance(segmentation, Mapping):
        size, counts = segmentation.get("size"), segmentation.get("counts")
        if size != [height, width]:
            raise ValueError(f"segmentation: expected size [{height}, {width}], got {size!r}")
        if isinstance(counts, list) and all(isinstance(n, int) and n >= 0 for n in counts):
            record = rle_codec.frPyObjects({"size": size, "counts": counts}, height, width)
        elif isinstance(counts, str):
            record = {"size": size, "counts": counts}
        else:
            raise ValueError(f"segmentation: expected run lengths under 'counts', got {counts!r:.60}")
    elif not isinstance(segmentation, list) or not segmentation or not all(map(_is_ring, segmentation)):
        raise ValueError("segmentation: expected polygons of at least three points (x1, y1, x2, y2, ...)")
    else:
        record = rle_codec.merge(rle_codec.frPyObjects(segmentation, height, width))
    try:
        return rle_codec.decode(record).astype(bool)
    except ValueError as error:
        raise ValueError(f"segmentation: expected run lengths of {width * height} pixels ({error})") from error


def _is_ring(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) >= 6
        and len(value) % 2 == 0
        and all(isinstance(n, int | float) and math.isfinite(n) for n in value)
    )


def area(mask: Bool[np.ndarray, "h w"]) -> int:
    """Pixels of a mask, COCO's ``area``."""
    return int(np.count_nonzero(mask))


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
