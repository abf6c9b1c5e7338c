"""The table of boxes with classes, of any origin: records, photographs, other tools' files, and detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class BoxTable:
    """n boxes with classes in images; tables with more columns extend it."""

    class_names: tuple[str, ...]
    image: Int[np.ndarray, " n"]  # image, class_index: indices of each box's image, ascending, and of its class
    class_index: Int[np.ndarray, " n"]
    xywh: Float[np.ndarray, "n 4"]  # pixels

    def boxes_per_image(self, images: int) -> Int[np.ndarray, " m"]:
        """Return the number of boxes in each of this many images."""
        return np.bincount(self.image, minlength=images)
