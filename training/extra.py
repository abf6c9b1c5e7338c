"""The extra `training`: PyTorch, RF-DETR, Albumentations; who needs them asks here first."""

from __future__ import annotations

import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from hulldown.geometry.errors import HulldownError

PACKAGES = ("torch", "torchvision", "pytorch_lightning", "rfdetr", "albumentations", "cv2", "onnx")


def require_extra() -> None:
    """Refuse to go on where the extra is not installed; to be called before anything of it is imported.

    Raises
    ------
    HulldownError
        Naming what is missing and how to install it.
    """
    os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # else it asks the network for its latest version
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise HulldownError(f"{', '.join(missing)}: not installed", remedy="pip install 'hulldown[training]'")


@contextmanager
def quiet() -> Iterator[None]:
    """Silence: Lightning and RF-DETR tell of their habits, which are no news to whoever trains; errors come through."""
    loggers = [logging.getLogger(name) for name in ("pytorch_lightning", "lightning_fabric", "rf-detr")]
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
