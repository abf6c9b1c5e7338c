"""A picture with its labels, as training draws it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8


@dataclass(frozen=True, eq=False, slots=True)
class Sample:
    """A picture with its labels."""

    picture: UInt8[np.ndarray, "h w 3"]
    xywh: Float[np.ndarray, "n 4"]  # boxes, pixels
    class_index: Int[np.ndarray, " n"]
    masks: tuple[Bool[np.ndarray, "h w"], ...] = ()  # mask of each box; empty if they are unknown or don't count

    def resized(self, width: int, height: int) -> Sample:
        """Resize, each side by its own factor."""
        import cv2  # not at the top: pictures are checked without the extra

        was_height, was_width = self.picture.shape[:2]
        if (was_width, was_height) == (width, height):
            return self
        shrinks = width * height < was_width * was_height
        return Sample(
            cv2.resize(self.picture, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR),
            self.xywh * ([width / was_width, height / was_height] * 2),
            self.class_index,
            tuple(
                cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5
                for mask in self.masks
            ),
        )  # fmt: skip
