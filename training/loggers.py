"""Lightning's loggers, to watch a training elsewhere."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from pytorch_lightning import loggers

from hulldown.geometry.errors import HulldownError


def logger_of(kind: str, folder: Path) -> loggers.Logger:
    """Return a logger of a run, which continues its log after a stop.

    Parameters
    ----------
    kind
        ``"tensorboard"``, ``"csv"``: files in the run's folder; ``"wandb"``, ``"mlflow"``: by their own environment
        variables, with the folder's name.
    folder
        The run's.

    Raises
    ------
    HulldownError
        If the package isn't installed.
    """
    key = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
    made: dict[str, tuple[type[loggers.Logger], dict[str, Any]]] = {
        "tensorboard": (loggers.TensorBoardLogger, {"save_dir": folder, "name": "tensorboard", "version": ""}),
        "csv": (loggers.CSVLogger, {"save_dir": folder, "name": "csv"}),
        "wandb": (loggers.WandbLogger, {"save_dir": folder, "project": "hulldown", "name": folder.name, "id": key}),
        "mlflow": (loggers.MLFlowLogger, {"save_dir": str(folder / "mlflow"), "run_name": folder.name}),
    }
    make, options = made[kind]
    try:
        return make(**options)
    except ModuleNotFoundError as error:
        package = error.name or kind
        raise HulldownError(f"logger = {kind!r}: {package} isn't installed", remedy=f"pip install {kind}") from None
