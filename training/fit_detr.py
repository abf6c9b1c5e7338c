"""Train RF-DETR with its own Lightning module."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchvision.ops import box_convert

from hulldown.base.files import replace_file
from hulldown.training.detectors.detector import WEIGHTS_NAME
from hulldown.training.detectors.detr import DetrDetector, detr_checkpoint_contents, normalize_for_detr, starting_module
from hulldown.training.fitting import Trainee
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.extra import silence_libraries
from hulldown.training.inputs.settings import Settings

with silence_libraries():
    from rfdetr.training.callbacks.ema import RFDETREMACallback
    from rfdetr.training.trainer import build_trainer
    from rfdetr.utilities.tensors import collate_fn


def collate_detr_examples(batch: Sequence[Example]) -> tuple[Any, list[dict[str, Tensor]]]:
    """Return the pictures of a batch, and their targets, as RF-DETR's own collation makes them."""
    pictures, targets = collate_fn([_detr_picture_and_target(k, example) for k, example in enumerate(batch)])
    return pictures, list(targets)


def _detr_picture_and_target(k: int, example: Example) -> tuple[Tensor, dict[str, Tensor]]:
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
    return normalize_for_detr(example.picture), target


def detr_trainee(settings: Settings, classes: Sequence[str], device: torch.device, folder: Path) -> Trainee:
    """Return RF-DETR to train, from the weights that the settings name."""
    module = starting_module(settings, classes, device, folder)
    model_config, train_config = module.model_config, module.train_config
    names, resolution = dict(enumerate(classes)), int(model_config.resolution)

    def save(network: Any, run: Path) -> None:
        content = io.BytesIO()  # PyTorch hides the reason of a full disk
        torch.save(detr_checkpoint_contents(module, classes, network), content)
        replace_file(run / WEIGHTS_NAME, content.getbuffer())

    return Trainee(
        module,
        RFDETREMACallback(decay=train_config.ema_decay, tau=train_config.ema_tau),
        partial(build_trainer, train_config, model_config),
        collate=collate_detr_examples,
        detector=lambda network: DetrDetector(network, module.postprocess, names, resolution, device),
        save=save,
    )
