"""Fit any network: draws in order, averaged weights, figures, and checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import pytorch_lightning as pl
import torch
from pytorch_lightning.loggers import Logger
from torch.utils.data import DataLoader

from hulldown.geometry.errors import HulldownError
from hulldown.geometry.files import replace_file
from hulldown.training.data import Batches, DrawnExamples, Example
from hulldown.training.detectors.callbacks import Recorder, StepSeeds, Validator
from hulldown.training.detectors.detector import DAMAGED, Detector, DetectorError, first_line
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


@dataclass(frozen=True, eq=False, slots=True)
class Fitted:
    """A trained detector, and the contents of its files.

    Parameters
    ----------
    detector, weights
        The detector, and the contents of its weights file.
    rows, validated
        Rows of metrics.csv, and of validation.csv without the last.
    """

    detector: Detector
    weights: dict[str, Any]
    rows: list[list[float]]
    validated: list[list[float]]


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
    judge
        Measures AP, AP50, and AP75 of a detector; None: there is no validation set.
    progress
        Called with (steps done, all).
    say
        Called with messages for the user.
    logger
        A logger of Lightning's; False: none.
    """

    settings: Settings
    classes: tuple[str, ...]
    examples: DrawnExamples
    folder: RunFolder
    weights: Path | None
    device: torch.device
    workers: int
    checkpoint_every: int | None
    judge: Callable[[Detector], Mapping[str, float]] | None
    progress: Callable[[int, int], None]
    say: Callable[[str], None]
    logger: Logger | Literal[False] = False

    @cached_property
    def batches(self) -> Batches:
        """The batches of the steps after the checkpoint."""
        settings = self.settings
        done = int(self._checkpoint()["global_step"]) if self.folder.checkpoint.exists() else 0
        return Batches(len(self.examples), batch=settings.batch, parts=settings.accumulate, first=done)

    def loader(self, collate: Callable[[list[Example]], Any]) -> DataLoader[Example]:
        """Return a loader of collated batches, in order."""
        return DataLoader(
            self.examples, batch_sampler=self.batches, collate_fn=collate, num_workers=self.workers,
            prefetch_factor=4 if self.workers else None,
        )  # fmt: skip

    def fit(
        self,
        module: pl.LightningModule,
        average: Any,
        trainer: Callable[..., pl.Trainer],
        *,
        detector: Callable[[Any], Detector],
        saved: Callable[[Any], dict[str, Any]],
        **data: Any,
    ) -> Fitted:
        """Train a module, or continue from the checkpoint.

        Parameters
        ----------
        module
            A module with the network as `model`.
        average
            The callback that averages its weights: RF-DETR's or `AveragedWeights`.
        trainer
            Makes the trainer from the common arguments.
        detector
            Makes the detector of a network.
        saved
            Returns the contents of a network's weights file.
        data
            The data, as arguments of `pl.Trainer.fit`.
        """

        def judged() -> Mapping[str, float]:
            network = deepcopy(module.model)
            network.load_state_dict(average.get_ema_model_state_dict())
            assert self.judge is not None
            figures = self.judge(detector(network))
            if self.settings.keep == "best" and figures["ap50"] > max((row[2] for row in validator.rows), default=-1.0):
                replace_file(self.folder.best, content_of(saved(network)))
            return figures

        validator = Validator(self.batches.steps, judged if self.judge else None)
        recorder = Recorder(self, validator)
        self._run(
            trainer(
                devices=[self.device.index] if self.device.type == "cuda" and self.device.index else 1,
                accumulate_grad_batches=self.settings.accumulate,
                callbacks=[StepSeeds(self.settings.seed), average, validator, recorder], logger=self.logger, **_OURS,
            ),
            module, **data,
        )  # fmt: skip
        return Fitted(detector(module.model), saved(module.model), recorder.rows, validator.rows)

    def _run(self, trainer: pl.Trainer, module: pl.LightningModule, **data: Any) -> None:
        before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
        checkpoint = str(self.folder.checkpoint) if self.folder.checkpoint.exists() else None
        if checkpoint:
            held, wanted = (_shapes(state) for state in (self._checkpoint()["state_dict"], module.state_dict()))
            if held != wanted:
                raise self._foreign("holds other weights")
        try:
            trainer.fit(module, ckpt_path=checkpoint, weights_only=True if checkpoint else None, **data)
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
        if not isinstance(found["callbacks"], dict) or Recorder.__qualname__ not in found["callbacks"]:
            raise self._foreign("is of another training")
        return found

    def _foreign(self, problem: str) -> DetectorError:
        return DetectorError(problem, path=self.folder.checkpoint, remedy="delete it, and training begins anew")


def seed_weights(settings: Settings) -> None:
    """Make the first weights of a network a function of the run's seed."""
    pl.seed_everything(settings.seed % 2**32, verbose=False)


def _shapes(state: Mapping[str, Any]) -> dict[str, Any]:
    return {key: getattr(value, "shape", None) for key, value in state.items()}
