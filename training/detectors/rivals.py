"""Lower a detector's scores where a detector pretrained on COCO finds another vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import UInt8
from torchvision.ops import box_convert, box_iou

from hulldown.base.errors import HulldownError
from hulldown.training.detectors.detector import Detections, Detector

# COCO's vehicles of the road, but not its truck: that's what a detector that doesn't know tanks takes them for.
RIVAL_CLASSES = ("car", "bus", "motorcycle", "motorbike")
MIN_RIVAL_IOU = 0.5


class ContestedDetector:
    """A detector with a pretrained detector's rival classes; its own classes aren't rivals."""

    def __init__(self, detector: Detector, pretrained: Detector) -> None:
        self.classes = detector.classes
        self._detector, self._pretrained = detector, pretrained
        rivals = set(RIVAL_CLASSES) - set(detector.classes)
        self._rivals = [i for i, name in enumerate(pretrained.classes) if name in rivals]
        if not self._rivals:
            raise HulldownError(
                f"rivals: that detector finds {', '.join(pretrained.classes)}, none of {', '.join(sorted(rivals))}",
                remedy="name one that was pretrained on COCO",
            )

    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures of any sizes, as one batch."""
        found, others = self._detector.detect(images), self._pretrained.detect(images)
        return [
            lower_contested_scores(one, other.take(np.isin(other.class_index, self._rivals)))
            for one, other in zip(found, others, strict=True)
        ]


def lower_contested_scores(found: Detections, rivals: Detections) -> Detections:
    """Return detections with scores times one minus the highest score of an overlapping rival."""
    corners = [box_convert(torch.from_numpy(one.xywh), "xywh", "xyxy") for one in (found, rivals)]
    contested = (box_iou(*corners) >= MIN_RIVAL_IOU).numpy() * rivals.score
    score = found.score * (1.0 - contested.max(axis=1, initial=0.0))
    order = np.argsort(-score, kind="stable")
    return Detections(found.xywh, score, found.class_index).take(order)
