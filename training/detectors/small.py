"""A small detector that learns from random weights on a CPU in minutes: a center-point network of our own layers.

Tests, demos, and studies use it without pretrained weights and a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import pytorch_lightning as pl
import torch
from jaxtyping import UInt8
from msgspec import Meta
from pytorch_lightning.callbacks import WeightAveraging
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR
from torchvision.ops import box_convert

from hulldown.base.errors import HulldownError
from hulldown.base.outside import typed
from hulldown.training.data import Example, network_pictures
from hulldown.training.detectors.center_points import CenterNetwork, center_loss, peaks
from hulldown.training.detectors.detector import DAMAGED, Detections, first_line, read_weights, refuse_odd_numbers
from hulldown.training.fitting import Training, seed_weights
from hulldown.training.settings import Settings, rate_factor

ASPECT = 9 / 16
STEP = 16  # pixels: sides are multiples of it
MOST = 100  # objects found in a picture
MIN_SCORE = 0.01
AVERAGE_DECAY = 0.998
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


class SmallModule(pl.LightningModule):
    """The small network as a LightningModule, with the number of steps in the whole run."""

    def __init__(self, network: CenterNetwork, settings: Settings, steps: int) -> None:
        super().__init__()
        self.model = network.to(memory_format=torch.channels_last)
        self._settings, self._steps = settings, steps

    def training_step(self, batch: tuple[Tensor, list[Tensor], list[Tensor]], batch_idx: int) -> Tensor:
        """The loss of a batch."""
        pictures, xyxy, labels = batch
        return center_loss(self.model(pictures), xyxy, labels)

    def configure_optimizers(self) -> dict[str, object]:
        """AdamW with the run's schedule."""
        settings = self._settings
        optimizer = torch.optim.AdamW(self.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        rates = LambdaLR(optimizer, partial(rate_factor, settings=settings, steps=self._steps))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": rates, "interval": "step"}}


class AveragedWeights(WeightAveraging):
    """The exponential moving average of a module's weights; early steps are forgotten sooner."""

    def __init__(self) -> None:
        super().__init__(avg_fn=_averaged)

    def get_ema_model_state_dict(self) -> dict[str, torch.Tensor]:
        """Return the average of the module's `model`; RF-DETR's callback has the same method."""
        assert self._average_model is not None
        return cast("pl.LightningModule", self._average_model.module).model.state_dict()


def _averaged(average: torch.Tensor, weights: torch.Tensor, steps: int | torch.Tensor) -> torch.Tensor:
    """The average after another step; `steps` is the number before it."""
    decay = min(AVERAGE_DECAY, (2 + int(steps)) / (11 + int(steps)))
    return decay * average + (1.0 - decay) * weights


def collated(batch: Sequence[Example]) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """The pictures of a batch, and the corners and classes of each one's boxes."""
    pictures = torch.stack([example.picture for example in batch])
    return pictures, [example.xyxy for example in batch], [example.label for example in batch]


def fit_small(training: Training) -> dict[str, object]:
    """Train the small network; returns figures of run.json."""
    classes, size, device = training.classes, training.examples.size, training.device
    seed_weights(training.settings)
    module = SmallModule(starting_network(classes, training.weights), training.settings, training.batches.steps)
    cuda = device.type == "cuda"
    return training.fit(
        module, AveragedWeights(),
        partial(
            pl.Trainer, max_epochs=1, accelerator="gpu" if cuda else "cpu",
            precision="bf16-mixed" if cuda else "32-true", gradient_clip_val=10.0,
        ),
        collate=collated,
        detector=lambda network: SmallDetector(network, classes, size, device),
        saved=partial(save_small, classes=classes, size=size),
    )  # fmt: skip
