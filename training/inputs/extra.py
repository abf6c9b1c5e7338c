"""The extra `training`: PyTorch, RF-DETR, Albumentations. Call `require_training_extra` before importing them."""

from __future__ import annotations

import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from hulldown.base.errors import HulldownError

TRAINING_PACKAGES = ("torch", "torchvision", "pytorch_lightning", "rfdetr", "transformers", "albumentations", "cv2", "onnx")


def require_training_extra() -> None:
    """Raise if the extra isn't installed; call it before importing anything of it."""
    os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # else it asks the network for its latest version
    missing = [name for name in TRAINING_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise HulldownError(f"{', '.join(missing)}: not installed", remedy="pip install 'hulldown[training]'")


@contextmanager
def silence_libraries() -> Iterator[None]:
    """Silence routine messages of Lightning, RF-DETR, and transformers; errors are shown."""
    names = ("pytorch_lightning", "lightning_fabric", "rf-detr", "transformers", "huggingface_hub")
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
