"""Train a detector of transformers with Lightning."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytorch_lightning as pl
import torch
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR
from torchvision.ops import box_convert

from hulldown.training.detectors.detector import WEIGHTS_FOLDER
from hulldown.training.detectors.transformers_detector import (
    TransformersDetector,
    normalize_for_transformers,
    save_transformers_weights,
    starting_network_and_processor,
)
from hulldown.training.fitting import RFDETREMACallback, Trainee
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.settings import Settings, learning_rate_factor

Batch = tuple[Tensor, list[dict[str, Tensor]]]
MAX_GRADIENT_NORM = 0.1  # as D-FINE was trained


class TransformersModule(pl.LightningModule):
    """A network of transformers as a LightningModule, with the schedule of a run."""

    def __init__(self, network: Any, settings: Settings) -> None:
        super().__init__()
        self.model, self._settings = network.train(), settings

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Return the loss of a batch."""
        try:
            loss: Tensor = self.model(pixel_values=batch[0], labels=batch[1]).loss
        except ValueError:  # transformers refuses boxes that aren't numbers, of a training that diverges
            with torch.no_grad():
                if bool(self.model(pixel_values=batch[0]).pred_boxes.isfinite().all()):
                    raise
            return torch.full((), torch.nan, requires_grad=True)
        return loss

    def configure_optimizers(self) -> dict[str, object]:
        """Return AdamW with the run's schedule."""
        settings = self._settings
        trained = [one for one in self.model.parameters() if one.requires_grad]
        optimizer = torch.optim.AdamW(trained, lr=settings.learning_rate, weight_decay=settings.weight_decay)
        rates = LambdaLR(optimizer, partial(learning_rate_factor, settings=settings, steps=settings.steps))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": rates, "interval": "step"}}


def collate_transformers_examples(processor: Any, batch: Sequence[Example]) -> Batch:
    """Return the pictures of a batch, and labels: boxes as center and size, in shares of the picture."""
    pictures = normalize_for_transformers(torch.stack([example.picture for example in batch]), processor)
    sides = torch.tensor(pictures.shape[:1:-1]).repeat(2)
    labels = [
        {"class_labels": example.class_index, "boxes": box_convert(example.xyxy, "xyxy", "cxcywh") / sides} for example in batch
    ]
    return pictures, labels


def transformers_trainee(settings: Settings, classes: Sequence[str], device: torch.device) -> Trainee:
    """Return a network to train, from the weights that the settings name."""
    pl.seed_everything(settings.seed % 2**32, verbose=False)
    network, processor = starting_network_and_processor(settings, classes)

    def save(trained: Any, folder: Path) -> None:
        save_transformers_weights(trained, processor, folder / WEIGHTS_FOLDER)

    return Trainee(
        TransformersModule(network, settings),
        RFDETREMACallback(),
        partial(pl.Trainer, accelerator="gpu" if device.type == "cuda" else "cpu", gradient_clip_val=MAX_GRADIENT_NORM),
        collate=partial(collate_transformers_examples, processor),
        detector=lambda trained: TransformersDetector(trained, processor, device),
        save=save,
    )
