"""Train the small network with Lightning."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import cast

import pytorch_lightning as pl
import torch
from pytorch_lightning.callbacks import WeightAveraging
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR

from hulldown.training.detectors.center_points import CenterNetwork, center_loss
from hulldown.training.detectors.detector import RunFigures
from hulldown.training.detectors.small import SmallDetector, save_small, starting_network
from hulldown.training.fitting import Training, seed_weights
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.settings import Settings, rate_factor

AVERAGE_DECAY = 0.998
BACKBONE_RATE = 0.1  # learning rate of a pretrained backbone as a share of the rest's


class SmallModule(pl.LightningModule):
    """The small network as a LightningModule, with the number of steps in the whole run."""

    def __init__(self, network: CenterNetwork, settings: Settings, steps: int, *, pretrained: bool) -> None:
        super().__init__()
        self.model = network.to(memory_format=torch.channels_last)
        self._settings, self._steps = settings, steps
        self._backbone_rate = settings.learning_rate * (BACKBONE_RATE if pretrained else 1.0)

    def training_step(self, batch: tuple[Tensor, list[Tensor], list[Tensor]], batch_idx: int) -> Tensor:
        """Return the loss of a batch."""
        pictures, xyxy, labels = batch
        return center_loss(self.model(pictures), xyxy, labels)

    def configure_optimizers(self) -> dict[str, object]:
        """AdamW with the run's schedule."""
        settings = self._settings
        body = list(self.model.backbone.parameters())
        of_body = set(map(id, body))
        groups = [
            {"params": [one for one in self.model.parameters() if id(one) not in of_body]},
            {"params": body, "lr": self._backbone_rate},
        ]
        optimizer = torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)
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
    """Return the average after another step; `steps` is the number before it."""
    decay = min(AVERAGE_DECAY, (2 + int(steps)) / (11 + int(steps)))
    return average + (1.0 - decay) * (weights - average)  # exactly the same where weights don't change


def collated(batch: Sequence[Example]) -> tuple[Tensor, list[Tensor], list[Tensor]]:
    """Return the pictures of a batch, and the corners and classes of each one's boxes."""
    pictures = torch.stack([example.picture for example in batch])
    return pictures, [example.xyxy for example in batch], [example.class_index for example in batch]


def fit_small(training: Training) -> RunFigures:
    """Train the small network; returns figures of run.json.

    On a CPU one thread computes: several cost up to four times as much where others work too, and weights depend on
    their number.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _fitted(training)
    finally:
        torch.set_num_threads(threads)


def _fitted(training: Training) -> RunFigures:
    classes, size, device = training.classes, training.examples.size, training.device
    seed_weights(training.settings)
    frozen, pretrained = training.settings.freeze == "encoder", training.weights is not None
    network = starting_network(classes, training.weights, frozen=frozen)
    module = SmallModule(network, training.settings, training.batches.steps, pretrained=pretrained)
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
