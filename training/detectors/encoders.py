"""Encoders of pictures into features, for comparing renders with photographs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8

from hulldown.dataset.reports.comparison import Encoder
from hulldown.training.detectors.detector import read_weights, weights_of
from hulldown.training.detectors.small import starting_network, starting_weights
from hulldown.training.inputs.data import network_pictures
from hulldown.training.inputs.settings import load_settings

SIZE = 320, 240  # of pictures in front of the small model's backbone
BATCH = 16
SMALL = {"hulldown", "conv1.0.weight"}  # keys of weights of the small model, and of its backbone


def load_encoder(model: str) -> Encoder:
    """Return a function from RGB images to features, (n, d): means of an encoder's last map over each image."""
    path = Path(model)
    if model == "small" and not path.exists():
        return _small_encoder(starting_weights(load_settings(None, {"model": model})))
    if path.exists() and SMALL & read_weights(weights_of(path)).keys():
        return _small_encoder(weights_of(path))
    from hulldown.training.detectors import detr

    return detr.load_encoder(model)


def _small_encoder(weights: Path | None) -> Encoder:
    network = starting_network(("object",), weights).eval()

    @torch.inference_mode()
    def features(images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> Float[np.ndarray, "n d"]:
        batches = (network_pictures(images[start : start + BATCH], SIZE) for start in range(0, len(images), BATCH))
        return np.concatenate([network.levels(batch)[-1].mean(dim=(2, 3)).double().numpy() for batch in batches])

    return features
