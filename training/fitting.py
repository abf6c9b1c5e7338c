"""Fit any network: draws in order, averaged weights, figures, and checkpoints."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytorch_lightning as pl
import torch
from torch.utils.data import DataLoader

from hulldown.geometry.errors import HulldownError
from hulldown.geometry.files import replace_file
from hulldown.training.data import Batches, DrawnExamples, Example
from hulldown.training.detectors.callbacks import Recorder, log, logger_of
from hulldown.training.detectors.detector import DAMAGED, Detector, DetectorError, first_line
from hulldown.training.evaluation.average_precision import AVERAGES
from hulldown.training.evaluation.labels import Labels
from hulldown.training.predict import validation_figures
from hulldown.training.run_folder import RunFolder, content_of
from hulldown.training.settings import Settings

# Lightning's extras are off: this module does them, and only the budget ends a run.
_OURS: Mapping[str, Any] = {
    "enable_checkpointing": False,
    "enable_progress_bar": False,
    "enable_model_summary": False,
    "num_sanity_val_steps": 0,
    "limit_val_batches": 0,
    "deterministic": "warn",
}


@dataclass(frozen=True, eq=False)
class Training:
    """The parameters of a training.

    Parameters
    ----------
    settings
        Its settings.
    classes
        Names of the classes, in order.
    examples
        The draws.
    folder
        The run's folder.
    weights
        The file to start from; None: random weights.
    device
        The device.
    workers
        Processes that read and augment pictures.
    checkpoint_every
        Steps between checkpoints; None: one a minute.
    valid
        The labels of the validation set, if there is one.
    progress
        Called with (title, steps done, all).
    say
        Called with messages for the user.
    """

    settings: Settings
    classes: tuple[str, ...]
    examples: DrawnExamples
    folder: RunFolder
    weights: Path | None
    device: torch.device
    workers: int
    checkpoint_every: int | None
    valid: Labels | None
    progress: Callable[[str, int, int], None]
    say: Callable[[str], None]

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
        saved: Callable[[Any], dict[str, Any]],
    ) -> dict[str, Any]:
        """Train a module, or continue from the checkpoint; write weights and metrics.

        Parameters
        ----------
        module
            A module with the network as `model`.
        average
            The callback that averages its weights: RF-DETR's or `AveragedWeights`.
        trainer
            Makes the trainer from the common arguments.
        collate
            Makes the module's batch of some examples.
        detector
            Makes the detector of a network.
        saved
            Returns the contents of a network's weights file.

        Returns
        -------
        Figures of run.json.
        """
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
        loader = DataLoader(
            self.examples, batch_sampler=self.batches, collate_fn=collate, num_workers=self.workers,
            prefetch_factor=4 if self.workers else None,
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
            found = figures["valid"] = validation_figures(detector(module.model), valid, progress=progress)
            step = recorder.rows[-1][0]
            best = max(validated, key=lambda row: row[2], default=None)
            validated = [*validated, [step, *(found[key] for key in AVERAGES)]]
            if keep_best and best is not None and best[2] > found["ap50"]:
                content = self.folder.best.read_bytes()
                figures["valid"] = dict(zip(("step", *AVERAGES), best, strict=True))
            log([logger] if logger else [], {f"valid/{key}": found[key] for key in AVERAGES}, int(step))
        replace_file(self.folder.weights, content)
        self.folder.write_metrics(recorder.rows, validated)
        return figures

    def _run(self, trainer: pl.Trainer, module: pl.LightningModule, loader: DataLoader[Example]) -> None:
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
        except HulldownError as error:
            # A loader's process passes its error on as text, after its traceback.
            _, raised, text = str(error).rpartition(f"{type(error).__module__}.{type(error).__qualname__}: ")
            raise (HulldownError(text) if raised else error) from None
        finally:
            torch.use_deterministic_algorithms(before[0], warn_only=before[1])

    def _checkpoint(self) -> dict[str, Any]:
        """The contents of the checkpoint.

        Raises
        ------
        DetectorError
            If it's damaged, or another training's.
        """
        try:
            found = torch.load(self.folder.checkpoint, map_location="cpu", weights_only=True, mmap=True)
        except DAMAGED as error:
            raise self._foreign(f"is damaged ({first_line(error)})") from None
        parts = ("global_step", "state_dict", "callbacks", "loops", "optimizer_states", "lr_schedulers")
        if not isinstance(found, dict) or any(part not in found for part in parts):
            raise self._foreign("is no checkpoint of a training")
        callbacks = found["callbacks"]
        if not isinstance(callbacks, dict) or "validated" not in callbacks.get(Recorder.__qualname__, ()):
            raise self._foreign("is of another training")
        return found

    def _foreign(self, problem: str) -> DetectorError:
        return DetectorError(problem, path=self.folder.checkpoint, remedy="delete it, and training begins anew")


def seed_weights(settings: Settings) -> None:
    """Make the first weights of a network a function of the run's seed."""
    pl.seed_everything(settings.seed % 2**32, verbose=False)


def _shapes(state: Mapping[str, Any]) -> dict[str, Any]:
    return {key: getattr(value, "shape", None) for key, value in state.items()}


def _figures(rows: Sequence[Sequence[float]], settings: Settings, seconds: float) -> dict[str, Any]:
    """Figures over all steps; times of killed parts are included up to their checkpoints."""
    _, losses, _, took, waited = np.array(rows).T
    tail = losses[-max(1, math.ceil(len(losses) / 20)) :]
    # The first step of a process includes the start of workers.
    steady = slice(1, None) if len(took) > 1 else slice(None)
    return {
        "final_loss": float(tail.mean()),
        "seconds": seconds,
        "seconds_per_step": float(np.median(took[steady])),
        "images_per_second": settings.effective_batch / float(np.median(took[steady])),
        "waited_for_data_share": float(waited[steady].sum() / took[steady].sum()),
        "peak_memory_mb": _peak_memory_mb(),
    }


def _peak_memory_mb() -> float | None:
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
