"""A small detector that learns on a CPU in minutes: a center-point network on a pretrained ShuffleNet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from jaxtyping import UInt8
from msgspec import Meta
from torchvision.models import ShuffleNet_V2_X1_0_Weights
from torchvision.ops import box_convert

from hulldown.base.errors import HulldownError
from hulldown.base.outside import typed
from hulldown.training.detectors.center_points import CenterNetwork, peaks
from hulldown.training.detectors.detector import DAMAGED, Detections, first_line, read_weights, refuse_odd_numbers
from hulldown.training.inputs.data import network_pictures
from hulldown.training.inputs.settings import Settings

ASPECT = 3 / 4  # height over width of most photographs
STEP = 16  # pixels: sides are multiples of it
MOST_OBJECTS = 100  # objects found in a picture
MIN_SCORE = 0.01
_Side = Annotated[int, Meta(ge=STEP, le=8192)]
_Names = Annotated[list[str], Meta(min_length=1, max_length=10_000)]
WEIGHTS_KIND = "center points on ShuffleNet"  # kind of weights in a file


def small_size(resolution: int) -> tuple[int, int]:
    """Width and height of the network's input; `resolution` is the width in pixels.

    Examples
    --------
    >>> small_size(256)
    (256, 192)
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
        found = peaks(self.network(network_pictures(images, self.size).to(self._device)), MOST_OBJECTS)
        detections = []
        for image, *own in zip(images, *(part.cpu() for part in found), strict=True):
            xyxy, score, label = (part[own[1] >= MIN_SCORE] for part in own)
            sides = torch.tensor(image.shape[1::-1], dtype=torch.float64).repeat(2)  # of what the boxes are clipped to
            corners = (xyxy * (sides / torch.tensor(self.size).repeat(2))).clip(min=0.0).minimum(sides)
            xywh = box_convert(corners, "xyxy", "xywh")
            detections.append(Detections(xywh.numpy(), score.double().numpy(), label.numpy()))
        return detections


def starting_weights(settings: Settings) -> Path | None:
    """Return the file that training starts from; torchvision's own is downloaded if necessary."""
    if settings.weights == "none":
        return None
    if settings.weights is not None:
        path = Path(settings.weights)
        starting_network(("object",), path)
        return path
    url = ShuffleNet_V2_X1_0_Weights.IMAGENET1K_V1.url
    path = Path(torch.hub.get_dir()) / "checkpoints" / url.rpartition("/")[2]
    if not path.is_file():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            torch.hub.download_url_to_file(url, str(path), progress=False)
        except (OSError, ValueError, RuntimeError) as error:
            raise HulldownError(
                f"the pretrained weights of small cannot be downloaded ({first_line(error)[:100]})",
                remedy=f"put {path.name} into {path.parent}, or give --weights FILE or --weights none",
            ) from None
    return path


def starting_network(classes: Sequence[str], weights: Path | None, *, frozen: bool = False) -> CenterNetwork:
    """Return a network with random weights, those of a small model, or a backbone's; the rest stays random."""
    network = CenterNetwork(len(classes), frozen=frozen)
    if weights is None:
        return network
    found = read_weights(weights)
    if "hulldown" not in found:
        state = {key: value for key, value in found.items() if key.partition(".")[0] not in ("conv5", "fc")}
        try:
            network.backbone.load_state_dict(state)
        except DAMAGED as error:
            raise HulldownError(
                f"has no backbone of the small model ({first_line(error)})",
                path=weights,
                remedy="name a weights.pt of `hulldown train`, or a state dict of torchvision's shufflenet_v2_x1_0",
            ) from None
        refuse_odd_numbers(network.backbone, weights)
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
    """Return the contents of a weights file."""
    state = {key: value.detach().cpu() for key, value in network.state_dict().items()}
    return {"hulldown": WEIGHTS_KIND, "classes": list(classes), "size": list(size), "model": state}


def load_small(path: Path, *, device: torch.device) -> SmallDetector:
    """Load the detector of a weights file."""
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
