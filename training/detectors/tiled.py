"""Detect in overlapping tiles of large pictures, whose objects would be too small at a network's input size."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import supervision as sv
from jaxtyping import UInt8

from hulldown.training.detectors.detector import Detections, Detector

TILE_OVERLAP_SHARE = 0.25  # of a tile's sides
MIN_SAME_OBJECT_SHARE = 0.6  # of the smaller of two boxes of one object, which a tile's edge may cut


class TiledDetector:
    """A `Detector` that sees pictures as tiles with this width and height in pixels, as in its training."""

    def __init__(self, detector: Detector, size: tuple[int, int], *, batch: int) -> None:
        self.classes = detector.classes
        self._slicer = sv.InferenceSlicer(
            partial(_detect_in_tiles, detector),
            slice_wh=size,
            overlap_wh=(int(TILE_OVERLAP_SHARE * size[0]), int(TILE_OVERLAP_SHARE * size[1])),
            iou_threshold=MIN_SAME_OBJECT_SHARE,
            overlap_metric=sv.OverlapMetric.IOS,
            batch_size=max(2, batch),  # from 2 on, the slicer passes lists
        )

    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures of any sizes."""
        found = []
        for image in images:
            merged = self._slicer(np.ascontiguousarray(image))
            if merged.confidence is None or merged.class_id is None:  # nothing in any tile
                found.append(Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, dtype=np.int64)))
                continue
            order = np.argsort(-merged.confidence, kind="stable")
            low, high = merged.xyxy[order, :2].astype(np.float64), merged.xyxy[order, 2:].astype(np.float64)
            xywh = np.concatenate((low, high - low), axis=1)
            found.append(Detections(xywh, merged.confidence[order], merged.class_id[order]))
        return found


def _detect_in_tiles(detector: Detector, tiles: list[UInt8[np.ndarray, "_ _ 3"]]) -> list[sv.Detections]:
    """Return the detections in some tiles, in the tiles' pixels."""
    return [
        sv.Detections(
            np.concatenate((one.xywh[:, :2], one.xywh[:, :2] + one.xywh[:, 2:]), axis=1),
            confidence=one.score,
            class_id=one.class_index,
        )
        for one in detector.detect(tiles)
    ]
