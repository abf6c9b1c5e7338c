"""A small detector that learns from random weights on a CPU in minutes: a center-point network of our own layers.

Tests, demos, and studies use it without pretrained weights and a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from jaxtyping import UInt8
from msgspec import Meta
from torchvision.ops import box_convert

from hulldown.base.errors import HulldownError
from hulldown.base.outside import typed
from hulldown.training.detectors.center_points import CenterNetwork, peaks
from hulldown.training.detectors.detector import DAMAGED, Detections, first_line, read_weights, refuse_odd_numbers
from hulldown.training.inputs.data import network_pictures

ASPECT = 9 / 16
STEP = 16  # pixels: sides are multiples of it
MOST = 100  # objects found in a picture
MIN_SCORE = 0.01
_Side = Annotated[int, Meta(ge=STEP, le=8192)]
_Names = Annotated[list[str], Meta(min_length=1, max_length=10_000)]
WEIGHTS_KIND = "center points"  # kind of weights in a file


def small_size(resolution: int) -> tuple[int, int]:
    """Width and height of the network's input; `resolution` is the width in pixels.

    Examples
    --------
    >>> small_size(256)
    (256, 144)
    """
    return resolution, max(STEP, round(resolution * ASPECT / STEP) * STEP)


class SmallDetector:
    """The small network as a detector; see `training.detectors.detector.Detector`."""

    def __init__(
        self, network: CenterNetwork, classes: tuple[str, ...], size: tuple[int, int], device: torch.device
    ) -> None:
        self.classes, self.size = classes, size
        self.network = network.to(device, memory_format=torch.channels_last).eval()
        self._device = device

    @torch.inference_mode()
    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures."""
        if not images:
            return []
        found = peaks(self.network(network_pictures(images, self.size).to(self._device)), MOST)
        detections = []
        for image, *own in zip(images, *(part.cpu() for part in found), strict=True):
            xyxy, score, label = (part[own[1] >= MIN_SCORE] for part in own)
            sides = torch.tensor(image.shape[1::-1], dtype=torch.float64).repeat(2)  # of what the boxes are clipped to
            corners = (xyxy * (sides / torch.tensor(self.size).repeat(2))).clip(min=0.0).minimum(sides)
            xywh = box_convert(corners, "xyxy", "xywh")
            detections.append(Detections(xywh.numpy(), score.double().numpy(), label.numpy()))
        return detections


def starting_network(classes: Sequence[str], weights: Path | None) -> CenterNetwork:
    """A network with random weights, or with a file's; outputs of classes that the file lacks stay random.

    Raises
    ------
    HulldownError
        If the file has no small model.
    """
    network = CenterNetwork(len(classes))
    if weights is None:
        return network
    given = load_small(weights, device=torch.device("cpu"))
    old, new = given.network.state_dict(), network.state_dict()
    rows = [(given.classes.index(name), k) for k, name in enumerate(classes) if name in given.classes]
    for key, value in old.items():
        if not key.startswith("heat."):
            new[key] = value
        for source, target in rows if key.startswith("heat.") else ():
            new[key][target] = value[source]
    network.load_state_dict(new)
    return network


def save_small(network: CenterNetwork, classes: Sequence[str], size: tuple[int, int]) -> dict[str, object]:
    """The contents of a weights file."""
    state = {key: value.detach().cpu() for key, value in network.state_dict().items()}
    return {"hulldown": WEIGHTS_KIND, "classes": list(classes), "size": list(size), "model": state}


def load_small(path: Path, *, device: torch.device) -> SmallDetector:
    """Load the detector of a weights file.

    Raises
    ------
    HulldownError
        If it has none.
    """
    found = read_weights(path)
    if found.get("hulldown") != WEIGHTS_KIND:
        raise HulldownError(
            "has no small model of this version of hulldown", path=path, remedy="train again in another folder"
        )
    try:
        (width, height), classes = typed(found.get("size"), tuple[_Side, _Side]), tuple(typed(found["classes"], _Names))
        network = CenterNetwork(len(classes))
        network.load_state_dict(found["model"])
    except DAMAGED as error:
        raise HulldownError(
            f"does not fit the small model ({first_line(error)})", path=path, remedy="train again in another folder"
        ) from None
    refuse_odd_numbers(network, path)
    return SmallDetector(network, classes, (width, height), device)
