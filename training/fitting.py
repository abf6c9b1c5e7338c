"""Fit any network: draws in order, averaged weights, figures, and checkpoints."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytorch_lightning as pl
import torch
from msgspec.structs import replace
from pytorch_lightning import loggers as pl_loggers
from torch.utils.data import DataLoader, Dataset

from hulldown.base.errors import HulldownError
from hulldown.base.files import open_regular, replace_file, replacing
from hulldown.base.outside import DATA, read_file
from hulldown.base.terminal import duration
from hulldown.training.detectors.detector import DAMAGED, Detector, RunFigures, first_line, load_tensors
from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.labels import Labels
from hulldown.training.inputs.data import Batches, DrawnExamples, Example
from hulldown.training.inputs.settings import Settings
from hulldown.training.predict import validation_figures
from hulldown.training.run_folder import RunFolder, content_of

ESTIMATE_AFTER = 10  # steps
CHECKPOINT_S = 60.0
VALIDATIONS = 10  # points of a run's curve; the last one is the result
# Lightning's extras are off: this module does them, and only the budget ends a run.
_OURS: Mapping[str, bool | int | str] = {
    "enable_checkpointing": False,
    "enable_progress_bar": False,
    "enable_model_summary": False,
    "num_sanity_val_steps": 0,
    "limit_val_batches": 0,
    "deterministic": "warn",
}


@dataclass(frozen=True, eq=False)
class Training:
    """The parameters of a training."""

    settings: Settings
    classes: tuple[str, ...]  # names of the classes, in order
    examples: DrawnExamples
    folder: RunFolder
    weights: Path | None  # the file to start from; None: random weights
    device: torch.device
    workers: int  # processes that read and augment pictures
    checkpoint_every: int | None  # steps between checkpoints; None: one a minute
    valid: Labels | None  # the labels of the validation set, if there is one
    progress: Callable[[str, int, int], None]  # called with (title, steps done, all)
    say: Callable[[str], None]  # called with messages for the user

    @cached_property
    def batches(self) -> Batches:
        """The batches of the steps after the checkpoint."""
        settings = self.settings
        done = int(self._checkpoint()["global_step"]) if self.folder.checkpoint.exists() else 0
        return Batches(len(self.examples), batch=settings.batch, parts=settings.accumulate, first=done)

    def fit(
        self,
        module: pl.LightningModule,
        average: Any,
        trainer: Callable[..., pl.Trainer],
        *,
        collate: Callable[[list[Example]], Any],
        detector: Callable[[Any], Detector],
        saved: Callable[[Any], Mapping[str, object]],
    ) -> RunFigures:
        """Train a module, or continue from the checkpoint; write weights and metrics."""
        started, valid, keep_best = time.monotonic(), self.valid, self.settings.keep == "best"

        def judged() -> Mapping[str, float]:
            network = deepcopy(module.model)
            network.load_state_dict(average.get_ema_model_state_dict())
            assert valid is not None
            found = validation_figures(detector(network), valid)
            if keep_best and found["ap50"] > max((row[2] for row in recorder.validated), default=-1.0):
                replace_file(self.folder.best, content_of(saved(network)))
            return found

        recorder = Recorder(self, judged if valid else None)
        logger = logger_of(self.settings.logger, self.folder.path) if self.settings.logger else False
        loader = _Loader(
            _Fetched(self.examples, collate), batch_sampler=self.batches, collate_fn=itemgetter(0),
            num_workers=self.workers, prefetch_factor=4 if self.workers else None,
        )  # fmt: skip
        self._run(
            trainer(
                devices=[self.device.index] if self.device.type == "cuda" and self.device.index else 1,
                accumulate_grad_batches=self.settings.accumulate,
                callbacks=[average, recorder], logger=logger, **_OURS,
            ),
            module, loader,
        )  # fmt: skip
        figures = _figures(recorder.rows, self.settings, time.monotonic() - started)
        content: Any = content_of(saved(module.model))
        validated = recorder.validated
        if valid:
            progress = partial(self.progress, "validating")
            found = kept = validation_figures(detector(module.model), valid, progress=progress)
            step = recorder.rows[-1][0]
            best = max(validated, key=lambda row: row[2], default=None)
            validated = [*validated, [step, *(found[key] for key in AVERAGES)]]
            if keep_best and best is not None and best[2] > found["ap50"]:
                content = read_file(self.folder.best, partial(HulldownError, path=self.folder.best), most=DATA)
                kept = dict(zip(("step", *AVERAGES), best, strict=True))
            figures = replace(figures, valid=kept)
            log([logger] if logger else [], {f"valid/{key}": found[key] for key in AVERAGES}, int(step))
        replace_file(self.folder.weights, content)
        self.folder.write_metrics(recorder.rows, validated)
        return figures

    def _run(self, trainer: pl.Trainer, module: pl.LightningModule, loader: DataLoader[Any]) -> None:
        before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
        checkpoint = str(self.folder.checkpoint) if self.folder.checkpoint.exists() else None
        if checkpoint:
            held, wanted = (_shapes(state) for state in (self._checkpoint()["state_dict"], module.state_dict()))
            if held != wanted:
                raise self._foreign("holds other weights")
        try:
            trainer.fit(module, loader, ckpt_path=checkpoint, weights_only=True if checkpoint else None)
        except SystemExit:  # raised by Lightning on Ctrl-C
            raise KeyboardInterrupt from None
        finally:
            torch.use_deterministic_algorithms(before[0], warn_only=before[1])

    def _checkpoint(self) -> dict[str, Any]:
        """Return the contents of the checkpoint."""
        try:
            with open_regular(self.folder.checkpoint) as file:
                found = load_tensors(file)
        except DAMAGED as error:
            raise self._foreign(f"is damaged ({first_line(error)})") from None
        parts = ("global_step", "state_dict", "callbacks", "loops", "optimizer_states", "lr_schedulers")
        if not isinstance(found, dict) or any(part not in found for part in parts):
            raise self._foreign("is no checkpoint of a training")
        callbacks = found["callbacks"]
        if not isinstance(callbacks, dict) or "validated" not in callbacks.get(Recorder.__qualname__, ()):
            raise self._foreign("is of another training, or of an earlier version of hulldown")
        return found

    def _foreign(self, problem: str) -> HulldownError:
        return HulldownError(problem, path=self.folder.checkpoint, remedy="delete it, and training begins anew")


class _Fetched(Dataset[Any]):
    """Batches of examples; an error takes its batch's place, since PyTorch would pass on its text alone."""

    def __init__(self, examples: DrawnExamples, collate: Callable[[list[Example]], Any]) -> None:
        self._examples, self._collate = examples, collate

    def __getitems__(self, draws: list[int]) -> list[Any]:
        try:
            return [self._collate([self._examples[k] for k in draws])]
        except HulldownError as error:
            return [error]


class _Loader(DataLoader[Any]):
    """A loader that raises the errors among its batches."""

    def __iter__(self) -> Iterator[Any]:
        for batch in super().__iter__():
            if isinstance(batch, HulldownError):
                raise batch
            yield batch


class Recorder(pl.Callback):
    """Seeds each step, records its figures, validates the averaged weights several times, and writes checkpoints.

    PyTorch is seeded in each step by the run's seed and the step. So a killed run continues identically, without a
    generator's state in its checkpoints.

    `measure`: returns AP, AP50, and AP75 of the averaged weights, without effect on the training; None: there is no
    validation set.
    """

    def __init__(self, training: Training, measure: Callable[[], Mapping[str, float]] | None) -> None:
        self.rows: list[list[float]] = []
        self.validated: list[list[float]] = []
        self._training, self._measure, self._steps = training, measure, training.batches.steps
        self._due = {round(self._steps * k / VALIDATIONS) for k in range(1, VALIDATIONS)} - {0, self._steps}
        self._losses: list[torch.Tensor] = []
        self._done = 0  # steps in this process
        self._waited = 0.0

    def state_dict(self) -> dict[str, object]:
        """Return the rows for a checkpoint."""
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
        loss = float(torch.stack(self._losses).mean())
        if not math.isfinite(loss):
            training.folder.write_metrics(self.rows, self.validated)
            remedy = f"lower learning_rate ({training.settings.learning_rate:g}), and name a new folder"
            raise HulldownError(f"the training diverged in step {step}", path=training.folder.path, remedy=remedy)
        if self._measure is not None and step in self._due:
            found = self._measure()
            self.validated.append([float(step), *(found[key] for key in AVERAGES)])
            log(trainer.loggers, {f"valid/{key}": found[key] for key in AVERAGES}, step)
        now = time.monotonic()
        rate = max(group["lr"] for group in trainer.optimizers[0].param_groups)
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


def logger_of(kind: str, folder: Path) -> pl_loggers.Logger:
    """Return a logger of a run, which continues its log after a stop."""
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


def seed_weights(settings: Settings) -> None:
    """Make the first weights of a network a function of the run's seed."""
    pl.seed_everything(settings.seed % 2**32, verbose=False)


def _shapes(state: Mapping[str, object]) -> dict[str, object]:
    return {key: getattr(value, "shape", None) for key, value in state.items()}


def _figures(rows: Sequence[Sequence[float]], settings: Settings, seconds: float) -> RunFigures:
    """Figures over all steps; times of killed parts are included up to their checkpoints."""
    _, losses, _, took, waited = np.array(rows).T
    tail = losses[-max(1, math.ceil(len(losses) / 20)) :]
    # The first step of a process includes the start of workers.
    steady = slice(1, None) if len(took) > 1 else slice(None)
    return RunFigures(
        final_loss=float(tail.mean()),
        seconds=seconds,
        seconds_per_step=float(np.median(took[steady])),
        images_per_second=settings.effective_batch / float(np.median(took[steady])),
        waited_for_data_share=float(waited[steady].sum() / took[steady].sum()),
        peak_memory_mb=_peak_memory_mb(),
    )


def _peak_memory_mb() -> float | None:
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
