"""Fit any network with Lightning: draws in order, averaged weights, validation, and checkpoints."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytorch_lightning as pl
import torch
from lightning_fabric.plugins import TorchCheckpointIO
from msgspec.structs import replace
from pytorch_lightning import loggers as pl_loggers
from pytorch_lightning.callbacks import ModelCheckpoint
from torch.utils.data import DataLoader

from hulldown.base.errors import HulldownError
from hulldown.base.files import atomic_writer, open_regular_file
from hulldown.training.detectors.detector import DAMAGE_ERRORS, Detector, RunFigures, first_error_line, load_tensors
from hulldown.training.evaluation.average_precision import AP_NAMES
from hulldown.training.evaluation.labels import Labels
from hulldown.training.inputs.data import Batches, DrawnExamples, Example
from hulldown.training.inputs.extra import silence_libraries
from hulldown.training.inputs.settings import Settings
from hulldown.training.predict import validation_aps
from hulldown.training.run_folder import RunFolder

with silence_libraries():
    from rfdetr.training.callbacks.ema import RFDETREMACallback

CURVE_POINTS = 10  # the last one is the result


@dataclass(frozen=True, eq=False, slots=True)
class Trainee:
    """A network, and the objects that fit, use, and save it."""

    module: pl.LightningModule  # its `model` is the network
    average: RFDETREMACallback
    trainer: Callable[..., pl.Trainer]
    collate: Callable[[Sequence[Example]], Any]
    detector: Callable[[Any], Detector]  # function of the network
    save: Callable[[Any, Path], None]  # writes the network's weights into a run's folder


@dataclass(frozen=True, eq=False, slots=True)
class Training:
    """The inputs of a training besides the network."""

    settings: Settings
    examples: DrawnExamples
    folder: RunFolder
    device: torch.device
    workers: int  # processes that read and augment pictures
    checkpoint_every_s: float
    valid: Labels | None  # the labels of the validation set, if there is one
    progress: Callable[[str, int, int], None]  # called with (title, steps done, all)


def fit_network(trainee: Trainee, training: Training) -> RunFigures:
    """Train a network, or continue from the checkpoint, and write its weights."""
    started, settings, checkpoint = time.monotonic(), training.settings, training.folder.checkpoint
    done = _load_checkpoint_steps(checkpoint, trainee.module) if checkpoint.exists() else None
    batches = Batches(len(training.examples), batch=settings.batch, first=(done or 0) * settings.accumulate)
    loader = _ErrorRaisingLoader(
        training.examples, batch_sampler=batches, collate_fn=partial(_collate_or_error, trainee.collate),
        num_workers=training.workers, prefetch_factor=4 if training.workers else None,
    )  # fmt: skip
    recorder = Recorder(trainee, training)
    keeper = ModelCheckpoint(
        checkpoint.parent, checkpoint.stem, enable_version_counter=False,
        train_time_interval=timedelta(seconds=training.checkpoint_every_s),
    )  # fmt: skip
    trainer = trainee.trainer(
        max_epochs=1,
        devices=[training.device.index] if training.device.type == "cuda" and training.device.index else 1,
        accumulate_grad_batches=settings.accumulate,
        callbacks=[trainee.average, recorder, keeper],
        logger=_run_loggers(settings.logger, training.folder.path),
        plugins=[AtomicCheckpointIO()],
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        limit_val_batches=0,
    )
    try:
        trainer.fit(trainee.module, loader, ckpt_path=None if done is None else str(checkpoint), weights_only=True)
    except SystemExit:  # raised by Lightning on Ctrl-C
        raise KeyboardInterrupt from None
    except DAMAGE_ERRORS as error:
        if done is None or recorder.began:  # else it's the checkpoint, of which `_load_checkpoint_steps` read two values
            raise
        raise _damaged_checkpoint_error(checkpoint, error) from None
    network: Any = trainee.module.model
    network.load_state_dict(recorder.best_weights or trainee.average.get_ema_model_state_dict())
    trainee.save(network, training.folder.path)
    figures = RunFigures(seconds=time.monotonic() - started, valid=recorder.best)
    if not recorder.losses:  # a run that was stopped after its last step
        return figures
    return replace(
        figures,
        final_loss=float(np.mean(recorder.losses[-math.ceil(len(recorder.losses) / 20) :])),
        # The first step of a process includes the start of workers.
        seconds_per_step=float(np.median(recorder.seconds[1:] or recorder.seconds)),
    )


class Recorder(pl.Callback):
    """Logs each step, stops a training that diverges, and validates the averaged weights."""

    def __init__(self, trainee: Trainee, training: Training) -> None:
        self.losses: list[float] = []  # of this process's steps
        self.seconds: list[float] = []
        self.best: dict[str, float] | None = None  # the last validation, or with `keep = "best"` the best one
        self.best_weights: Mapping[str, torch.Tensor] = {}
        self.began = False
        self._trainee, self._training, self._steps = trainee, training, training.settings.steps
        self._due = {round(self._steps * k / CURVE_POINTS) for k in range(1, CURVE_POINTS + 1)}
        self._parts: list[torch.Tensor] = []

    def state_dict(self) -> dict[str, object]:
        """Return the best validation and its weights for a checkpoint."""
        return {"best": self.best, "weights": self.best_weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the best validation of a checkpoint."""
        self.best, self.best_weights = state_dict["best"], state_dict["weights"]

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Start the clock, and copy the network for validations."""
        self.began, self._step, self._last = True, trainer.global_step, time.monotonic()
        self._averaged: Any = deepcopy(self._trainee.module.model) if self._training.valid is not None else None

    def on_train_batch_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int) -> None:
        """Seed dropout and denoising by the batch, so that a continued training equals one that wasn't stopped."""
        settings = self._training.settings
        batches = trainer.global_step * settings.accumulate + len(self._parts)
        torch.manual_seed(settings.seed % 2**32 << 32 | batches)

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record a step after its last batch."""
        self._parts.append((outputs["loss"] if isinstance(outputs, dict) else outputs).detach())
        if trainer.global_step == self._step:
            return
        training, self._step = self._training, trainer.global_step
        loss, self._parts = float(torch.stack(self._parts).mean()), []
        if not math.isfinite(loss):
            remedy = f"lower learning_rate ({training.settings.learning_rate:g}), and name a new folder"
            problem = f"the training diverged in step {self._step}"
            raise HulldownError(problem, path=training.folder.path, remedy=remedy)
        rate = max(group["lr"] for group in trainer.optimizers[0].param_groups)
        found = {"train/loss": loss, "train/learning_rate": rate}
        if training.valid is not None and self._step in self._due:
            found |= {f"valid/{key}": value for key, value in self._validate_averaged_weights(training.valid).items()}
        for logger in trainer.loggers:
            logger.log_metrics(found, self._step)
        training.progress("training", self._step, self._steps)
        self.losses.append(loss)
        self.seconds.append(time.monotonic() - self._last)
        self._last = time.monotonic()

    def _validate_averaged_weights(self, valid: Labels) -> dict[str, float]:
        weights = self._trainee.average.get_ema_model_state_dict()
        assert weights is not None
        self._averaged.load_state_dict(weights)
        measured = validation_aps(self._trainee.detector(self._averaged), valid)
        found = {key: measured[key] for key in AP_NAMES}
        if self._training.settings.keep == "end":
            self.best = found
        elif self.best is None or found["ap50"] > self.best["ap50"]:
            self.best, self.best_weights = {"step": float(self._step), **found}, weights
        return found


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes checkpoints in one step on any disk; Lightning moves them from another folder."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint."""
        with atomic_writer(Path(path)) as file:
            torch.save(checkpoint, file)


class _ErrorRaisingLoader(DataLoader[Any]):
    def __iter__(self) -> Iterator[Any]:
        for batch in super().__iter__():
            if isinstance(batch, HulldownError):
                raise batch
            yield batch


def _collate_or_error(collate: Callable[[Sequence[Example]], Any], batch: Sequence[Example | HulldownError]) -> Any:
    examples = [one for one in batch if not isinstance(one, HulldownError)]
    errors = [one for one in batch if isinstance(one, HulldownError)]
    return errors[0] if errors else collate(examples)


def _run_loggers(kind: str | None, folder: Path) -> list[pl_loggers.Logger]:
    """Return a run's loggers: tables, of which a stop starts a new one, and a kind that continues."""
    key = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
    made: dict[str, Callable[[], pl_loggers.Logger]] = {
        "tensorboard": partial(pl_loggers.TensorBoardLogger, save_dir=folder, name="tensorboard", version=""),
        "wandb": partial(pl_loggers.WandbLogger, save_dir=folder, project="hulldown", name=folder.name, id=key),
        "mlflow": partial(pl_loggers.MLFlowLogger, save_dir=str(folder / "mlflow"), run_name=folder.name),
    }
    table = pl_loggers.CSVLogger(folder, name="metrics")
    try:
        return [table, made[kind]()] if kind else [table]
    except ModuleNotFoundError as error:
        package = error.name or kind
        raise HulldownError(f"logger = {kind!r}: {package} isn't installed", remedy=f"pip install {kind}") from None


def _load_checkpoint_steps(checkpoint: Path, module: pl.LightningModule) -> int:
    try:
        with open_regular_file(checkpoint) as file:
            found: Any = load_tensors(file)
        module.load_state_dict(found["state_dict"])
        if type(steps := found["global_step"]) is not int or steps < 0:
            raise ValueError(f"global_step is {steps!r:.40}")
        return steps
    except DAMAGE_ERRORS as error:
        raise _damaged_checkpoint_error(checkpoint, error) from None


def _damaged_checkpoint_error(checkpoint: Path, error: BaseException) -> HulldownError:
    problem, remedy = f"is damaged ({first_error_line(error)})", "delete it, and training begins anew"
    return HulldownError(problem, path=checkpoint, remedy=remedy)
