"""Features of whole images from RF-DETR's DINOv2 encoder, for comparing renders with photographs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from hulldown.dataset.reports.comparison import Encoder
from hulldown.training.detectors.detector import DetectorError
from hulldown.training.extra import require_extra
from hulldown.training.predict import load_detector
from hulldown.training.settings import load_settings

BATCH = 8  # images that go through the encoder at once


def load_encoder(weights: str) -> Encoder:
    """Return a function from RGB images to features: the mean of the encoder's last feature map over the image.

    Parameters
    ----------
    weights
        A model of RF-DETR ("nano" to "large"), whose weights RF-DETR downloads; or a run folder or checkpoint of one.

    Raises
    ------
    DetectorError
        If the weights can't be downloaded or read, or they belong to another network.
    """
    require_extra()
    from hulldown.training.detectors.detr import CONFIGS, DetrDetector, starting_weights

    path: Path | None = Path(weights)
    if weights in CONFIGS and not Path(weights).exists():
        path = starting_weights(load_settings(None, {"model": weights}))
    assert path is not None
    detector = load_detector(path)
    if not isinstance(detector, DetrDetector):
        raise DetectorError("has no DINOv2 encoder", path=path, remedy="name nano to large, or a checkpoint of RF-DETR")

    def encode(images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> Float[np.ndarray, "n d"]:
        batches = [detector.features(images[i : i + BATCH]) for i in range(0, len(images), BATCH)]
        return np.concatenate(batches)

    return encode
