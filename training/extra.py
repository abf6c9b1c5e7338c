"""The extra `training`: PyTorch, RF-DETR, Albumentations; who needs them asks here first."""

from __future__ import annotations

import importlib.util
import os

from geometry.errors import HulldownError

PACKAGES = ("torch", "torchvision", "pytorch_lightning", "rfdetr", "albumentations", "cv2")


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
