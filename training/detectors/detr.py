"""RF-DETR through its own training stack, with draws as its data and schedules by budget.

Its LightningModule and `build_trainer` are used unchanged. Settings replace everything that conflicts with a fixed
budget of draws: learning rates follow the steps of the budget instead of epochs, the draws replace its data module and
augmentation, and the result is the averaged weights at the end.

Robinson et al., RF-DETR, 2026: the model of the paper, section 2.2. Its package, rfdetr, Apache-2.0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from pytorch_lightning import seed_everything
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR
from torchvision.ops import box_convert
from torchvision.transforms.functional import normalize

from hulldown.base.errors import HulldownError
from hulldown.training.detectors.detector import (
    DAMAGE_ERRORS,
    Detections,
    find_weights,
    first_error_line,
    read_detr_weights,
    refuse_nonfinite_weights,
)
from hulldown.training.inputs.data import pictures_at_network_size
from hulldown.training.inputs.extra import silence_libraries
from hulldown.training.inputs.settings import Settings, learning_rate_factor

with silence_libraries():  # its dependencies give deprecation warnings
    import rfdetr.config as rf_config
    from rfdetr import RFDETR
    from rfdetr.assets.coco_classes import COCO_CLASSES
    from rfdetr.assets.model_weights import get_model_cache_dir
    from rfdetr.training.callbacks.best_model import BestModelCallback
    from rfdetr.training.module_model import RFDETRModelModule

DETR_CONFIGS = {
    "nano": rf_config.RFDETRNanoConfig,
    "rf-small": rf_config.RFDETRSmallConfig,
    "medium": rf_config.RFDETRMediumConfig,
    "large": rf_config.RFDETRLargeConfig,
}
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of colors from 0 to 1
COCO_LOGITS = 91  # the pre-trained heads number classes as COCO does


def starting_module(settings: Settings, classes: Sequence[str], device: torch.device, folder: Path) -> RFDETRModelModule:
    """Return RF-DETR's module with the weights to start from; RF-DETR downloads its own."""
    named = None if settings.weights in (None, "none") else find_weights(Path(str(settings.weights)))
    own = pretrained_weights_path(settings.model)
    weights = None if settings.weights == "none" else named or own
    if named is not None:
        _require_detr_weights(named, read_detr_weights(named))
    configs = detr_configs(settings, classes, weights=weights, device=device, folder=folder)
    seed_everything(settings.seed % 2**32, verbose=False)
    try:
        if weights == own:
            own.parent.mkdir(parents=True, exist_ok=True)
        module = RFDETRModelModule(*configs)
    except DAMAGE_ERRORS as error:
        if weights is None:
            raise
        if not weights.is_file():  # no network, no room, a proxy's page
            for folder in (own.parent, own.parent.parent):
                with suppress(OSError):  # it isn't empty
                    folder.rmdir()
            raise HulldownError(
                f"the pre-trained weights of {settings.model} cannot be downloaded ({first_error_line(error)})",
                remedy=f"put {own.name} into {own.parent}, or give --weights FILE or --weights none",
            ) from None
        raise HulldownError(
            f"does not fit {settings.model} ({first_error_line(error)})", path=weights, remedy="name weights of that model"
        ) from None
    refuse_nonfinite_weights(module.model, weights or folder)
    return module


def pretrained_weights_path(model: str) -> Path:
    """Return the file of RF-DETR's COCO weights, which trainings download."""
    return Path(get_model_cache_dir()) / str(DETR_CONFIGS[model].model_fields["pretrain_weights"].default)


def _require_detr_weights(path: Path, found: Mapping[str, object]) -> None:
    state = found.get("model", found.get("state_dict"))
    if not isinstance(state, dict) or not any("class_embed" in str(key) for key in state):
        raise HulldownError("has no weights of RF-DETR", path=path, remedy="name a checkpoint of RF-DETR")


def detr_configs(
    settings: Settings, classes: Sequence[str], *, weights: Path | None, device: torch.device, folder: Path
) -> tuple[Any, Any]:
    """Return RF-DETR's own two configs for a run."""
    model = DETR_CONFIGS[settings.model](
        num_classes=len(classes),
        resolution=settings.resolution,
        pretrain_weights=None if weights is None else str(weights),
        device=device.type,
        **({"num_queries": settings.queries, "num_select": settings.queries} if settings.queries else {}),
        **({"group_detr": settings.groups} if settings.groups else {}),
    )
    train = rf_config.TrainConfig(
        lr=settings.learning_rate,
        lr_encoder=1.5 * settings.learning_rate,  # RF-DETR's own ratio
        weight_decay=settings.weight_decay,
        lr_scheduler=partial(LambdaLR, lr_lambda=partial(learning_rate_factor, settings=settings, steps=settings.steps)),
        lr_scheduler_interval="step",
        batch_size=settings.batch,
        grad_accum_steps=settings.accumulate,
        epochs=1,  # the whole budget
        warmup_epochs=0.0,
        multi_scale="per-batch" if settings.multi_scale else False,
        use_ema=True,
        class_names=list(classes),
        dataset_dir=str(folder),
        output_dir=str(folder),
        accelerator="gpu" if device.type == "cuda" else device.type,
        seed=settings.seed,
        tensorboard=False,
        progress_bar=None,
    )
    return model, train


def normalize_for_detr(pictures: Tensor) -> Tensor:
    """Normalize pictures (..., 3, h, w) of 0 to 255 for RF-DETR."""
    return normalize(pictures.float() / 255, IMAGENET_MEAN, IMAGENET_DEVIATION)


def detr_checkpoint_contents(module: RFDETRModelModule, classes: Sequence[str], network: Any) -> dict[str, object]:
    """Return the contents of a weights file, which `rfdetr.RFDETR.from_checkpoint` opens too."""
    state = {key: value.detach().cpu() for key, value in network.state_dict().items()}
    config = BestModelCallback._serialize_model_config(module, state)
    name = type(module.model_config).__name__.removesuffix("Config")
    args = {"class_names": list(classes), "num_classes": len(classes), "pretrain_weights": None}
    return {"model": state, "args": args, "model_name": name, "model_config": {**(config or {}), "pretrain_weights": None}}


class DetrDetector:
    """RF-DETR as a `Detector`; `resolution` is the side of its input in pixels."""

    def __init__(self, network: Any, postprocess: Any, names: dict[int, str], resolution: int, device: torch.device) -> None:
        self.classes = tuple(names.values())
        self._network, self._postprocess = network.to(device).eval(), postprocess
        self._size, self._device = (resolution, resolution), device
        self._index = {logit: i for i, logit in enumerate(names)}

    @torch.inference_mode()
    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures."""
        if not images:
            return []
        pictures = normalize_for_detr(pictures_at_network_size(images, self._size).to(self._device))
        sizes = torch.tensor([image.shape[:2] for image in images], device=self._device)
        known = torch.tensor(list(self._index), device=self._device)
        detections = []
        for found in self._postprocess(self._network(pictures), sizes):
            rows = found["scores"].argsort(descending=True, stable=True)
            rows = rows[torch.isin(found["labels"][rows], known)]
            xywh = box_convert(found["boxes"][rows].cpu().double(), "xyxy", "xywh").numpy()
            label = np.array([self._index[logit] for logit in found["labels"][rows].tolist()], dtype=np.int64)
            detections.append(Detections(xywh, found["scores"][rows].cpu().double().numpy(), label))
        return detections


def load_detr_detector(path: Path, *, device: torch.device) -> DetrDetector:
    """Load the detector of an RF-DETR checkpoint, from hulldown or elsewhere."""
    _require_detr_weights(path, read_detr_weights(path))
    try:
        with silence_libraries():
            model = RFDETR.from_checkpoint(str(path), device=device.type)
    except DAMAGE_ERRORS as error:  # an entry of the file may be missing or have another shape
        raise HulldownError(
            f"isn't a checkpoint of RF-DETR ({first_error_line(error)})", path=path, remedy="name another"
        ) from None
    context = model.model
    refuse_nonfinite_weights(context.model, path)
    logits = int(context.model.class_embed.weight.shape[0])
    names = context.class_names
    if not names and logits == COCO_LOGITS:
        named = dict(COCO_CLASSES)
    else:
        named = dict(enumerate(list(names or [str(i) for i in range(logits - 1)])[: logits - 1]))
    return DetrDetector(context.model, context.postprocess, named, int(model.model_config.resolution), device)
