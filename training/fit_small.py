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
from hulldown.training.detectors.small import SmallDetector, save_small, starting_network
from hulldown.training.fitting import Training, seed_weights
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.settings import Settings, rate_factor

AVERAGE_DECAY = 0.998


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
