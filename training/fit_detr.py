"""Train RF-DETR with its own Lightning module."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torchvision.ops import box_convert

from hulldown.training.detectors.detector import RunFigures
from hulldown.training.detectors.detr import DetrDetector, detr_configs, normalized, save_detr
from hulldown.training.fitting import Training, seed_weights
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.extra import quiet

with quiet():
    from rfdetr.training.callbacks.ema import RFDETREMACallback
    from rfdetr.training.module_model import RFDETRModelModule
    from rfdetr.training.trainer import build_trainer
    from rfdetr.utilities.tensors import collate_fn


def collated(batch: Sequence[Example]) -> tuple[Any, list[dict[str, Tensor]]]:
    """Return the pictures of a batch, and their targets, as RF-DETR's own collation makes them."""
    pictures, targets = collate_fn([_target(k, example) for k, example in enumerate(batch)])
    return pictures, list(targets)


def _target(k: int, example: Example) -> tuple[Tensor, dict[str, Tensor]]:
    """Return an example in RF-DETR's form: boxes as center and size, in shares of the picture."""
    height, width = example.picture.shape[1:]
    boxes = box_convert(example.xyxy, "xyxy", "cxcywh")
    target = {
        "boxes": boxes / torch.tensor([width, height] * 2),
        "labels": example.class_index,
        "image_id": torch.tensor([k]),
        "area": boxes[:, 2:].prod(dim=1),
        "iscrowd": torch.zeros_like(example.class_index),
        "orig_size": torch.tensor([height, width]),
        "size": torch.tensor([height, width]),
    }
    return normalized(example.picture), target


def fit_detr(training: Training) -> RunFigures:
    """Train RF-DETR; returns figures of run.json."""
    model_config, train_config = detr_configs(
        training.settings, training.classes, training.batches.steps, weights=training.weights, device=training.device,
        folder=training.folder.path,
    )  # fmt: skip
    seed_weights(training.settings)
    module = RFDETRModelModule(model_config, train_config)
    names, resolution = dict(enumerate(training.classes)), int(model_config.resolution)
    return training.fit(
        module, RFDETREMACallback(decay=train_config.ema_decay, tau=train_config.ema_tau),
        partial(build_trainer, train_config, model_config),
        collate=collated,
        detector=lambda network: DetrDetector(network, module.postprocess, names, resolution, training.device),
        saved=partial(save_detr, module, training.classes),
    )  # fmt: skip
