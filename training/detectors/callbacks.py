"""Lightning callbacks of a run: averaged weights, figures, validations, checkpoints; and its loggers."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytorch_lightning as pl
import torch
from pytorch_lightning import loggers as pl_loggers
from pytorch_lightning.callbacks import WeightAveraging

from hulldown.geometry.errors import HulldownError
from hulldown.geometry.files import replacing
from hulldown.geometry.terminal import duration
from hulldown.training.evaluation.average_precision import AVERAGES

if TYPE_CHECKING:
    from hulldown.training.fitting import Training

AVERAGE_DECAY = 0.998
ESTIMATE_AFTER = 10  # steps
CHECKPOINT_S = 60.0
VALIDATIONS = 10  # points of a run's curve; the last one is the result


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


def logger_of(kind: str, folder: Path) -> pl_loggers.Logger:
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
    made: dict[str, Callable[[], pl_loggers.Logger]] = {
        "tensorboard": partial(pl_loggers.TensorBoardLogger, save_dir=folder, name="tensorboard", version=""),
        "csv": partial(pl_loggers.CSVLogger, save_dir=folder, name="csv"),
        "wandb": partial(pl_loggers.WandbLogger, save_dir=folder, project="hulldown", name=folder.name, id=key),
        "mlflow": partial(pl_loggers.MLFlowLogger, save_dir=str(folder / "mlflow"), run_name=folder.name),
    }
    try:
        return made[kind]()
    except ModuleNotFoundError as error:
        package = error.name or kind
        raise HulldownError(f"logger = {kind!r}: {package} isn't installed", remedy=f"pip install {kind}") from None


def log(loggers: Sequence[pl_loggers.Logger], figures: Mapping[str, float], step: int) -> None:
    """Pass the figures of a step to Lightning's loggers."""
    for logger in loggers:
        logger.log_metrics(dict(figures), step)


class Recorder(pl.Callback):
    """Seeds each step, records its figures, validates the averaged weights several times, and writes checkpoints.

    PyTorch is seeded in each step by the run's seed and the step. So a killed run continues identically, without a
    generator's state in its checkpoints.

    Parameters
    ----------
    training
        The training.
    measure
        Returns AP, AP50, and AP75 of the averaged weights, without effect on the training; None: there is no
        validation set.

    Attributes
    ----------
    rows
        Step, loss, learning rate, seconds, and seconds waited for data of each step, also of those before a stop.
    validated
        Step, AP, AP50, and AP75 of each validation.
    """

    def __init__(self, training: Training, measure: Callable[[], Mapping[str, float]] | None) -> None:
        self.rows: list[list[float]] = []
        self.validated: list[list[float]] = []
        self._training, self._measure, self._steps = training, measure, training.batches.steps
        self._due = {round(self._steps * k / VALIDATIONS) for k in range(1, VALIDATIONS)} - {0, self._steps}
        self._losses: list[torch.Tensor] = []
        self._done = 0  # steps in this process
        self._waited = 0.0

    def state_dict(self) -> dict[str, Any]:
        """The rows for a checkpoint."""
        return {"rows": self.rows, "validated": self.validated}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the rows of a checkpoint."""
        self.rows, self.validated = ([list(row) for row in state_dict[key]] for key in ("rows", "validated"))

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Start the clocks."""
        self._first = self._last = self._saved = self._fetching = time.monotonic()

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """Record the wait for the batch, and seed PyTorch."""
        self._waited += time.monotonic() - self._fetching
        entropy = np.random.SeedSequence([self._training.settings.seed, batch_idx])
        torch.manual_seed(int(entropy.generate_state(1)[0]))

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record a step's figures after its last batch."""
        loss = outputs["loss"] if isinstance(outputs, dict) else outputs
        self._losses.append(loss.detach())
        if trainer.global_step > len(self.rows):
            self._end_step(trainer)
        self._fetching = time.monotonic()

    def _end_step(self, trainer: pl.Trainer) -> None:
        step, training = trainer.global_step, self._training
        if self._measure is not None and step in self._due:
            found = self._measure()
            self.validated.append([float(step), *(found[key] for key in AVERAGES)])
            log(trainer.loggers, {f"valid/{key}": found[key] for key in AVERAGES}, step)
        now = time.monotonic()
        rate = max(group["lr"] for group in trainer.optimizers[0].param_groups)
        loss = float(torch.stack(self._losses).mean())
        self.rows.append([float(step), loss, rate, now - self._last, self._waited])
        log(trainer.loggers, {"train/loss": loss, "train/learning_rate": rate}, step)
        self._losses, self._waited, self._last, self._done = [], 0.0, now, self._done + 1
        training.progress("training", step, self._steps)
        if self._done == ESTIMATE_AFTER:
            left = (now - self._first) / self._done * (self._steps - step)
            training.say(f"about {duration(left)} of training left")
        every = training.checkpoint_every
        due = now - self._saved >= CHECKPOINT_S if every is None else step % every == 0
        if due and step < self._steps:
            with replacing(training.folder.checkpoint) as file:
                trainer.save_checkpoint(file.name)
            training.folder.write_metrics(self.rows, self.validated)
            self._saved = time.monotonic()
