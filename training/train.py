"""Training a detector on draws from datasets under a fixed budget; a run that is killed goes on where it was."""

from __future__ import annotations

import hashlib
import importlib.metadata
import io
import math
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytorch_lightning as pl
import torch

from hulldown.geometry.errors import ConfigError, HulldownError
from hulldown.geometry.files import replace_file
from hulldown.training.augment import changed_table
from hulldown.training.data import Batches, DrawnExamples, loader
from hulldown.training.detectors.callbacks import AveragedWeights, Recorder, StepSeeds, Validator
from hulldown.training.detectors.centre_points import CentreNetwork
from hulldown.training.detectors.detector import DAMAGED, RUN_NAME, Detector, DetectorError, chosen_device, first_line
from hulldown.training.detectors.small import SmallDetector, SmallModule, save_small, small_size
from hulldown.training.draws import Draws, draws_text, make_draws, read_draws, source_shares
from hulldown.training.extra import quiet
from hulldown.training.run_folder import RunFolder, opened
from hulldown.training.settings import Settings
from hulldown.training.sources import Source, check_pictures, follow_masks, read_sources, shared_pictures
from hulldown.training.validate import validation_figures

Judge: TypeAlias = Callable[[Detector], Mapping[str, float]]  # AP, AP50 and AP75 of a detector
# The detector, what its weights file holds, the rows of metrics.csv and those of validation.csv but the last.
Fitted: TypeAlias = tuple[Detector, dict[str, Any], list[list[float]], list[list[float]]]
VERSIONS = ("torch", "torchvision", "pytorch-lightning", "rfdetr", "albumentations", "opencv-python-headless", "numpy")


def train(
    data: Mapping[str, Path | str],
    out: Path | str,
    *,
    settings: Settings,
    valid: Path | str | None = None,
    draws_file: Path | None = None,
    workers: int | None = None,
    device: str = "auto",
    checkpoint_every: int | None = None,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Train a detector, or go on with the training that was killed in the same folder.

    Parameters
    ----------
    data
        Name -> folder of each dataset that is drawn from.
    out
        The run's folder.
    settings
        Completed, see `training.settings.load_settings`.
    valid
        A dataset that the result is measured on. It decides nothing.
    draws_file
        A file of draws, as `training.draws.draws_text` has it, as many as the budget; None: they are made.
    workers
        Processes that read and augment pictures; None: as many as suit the machine. They change no pixel.
    device
        ``"auto"``, ``"cpu"`` or ``"gpu"``.
    checkpoint_every
        Steps between checkpoints; None: as many as pass in a minute.
    progress
        Told what is done, how much of it, and all.
    say
        Told a line now and then.

    Returns
    -------
    What run.json holds.

    Raises
    ------
    HulldownError
        If a dataset, a setting, the weights to start from, the device or the run's folder cannot be used. Nothing has
        been written then.
    """
    out = Path(out)
    table = changed_table(settings.augmentation)
    chosen = chosen_device({"gpu": "cuda"}.get(device, device))
    small = settings.model == "small"
    weights = usable_weights(settings)
    classes, sources = read_sources(data)
    shares = source_shares([source.name for source in sources], settings.shares)
    held_back = read_sources({"valid": valid}, classes=classes)[1] if valid is not None else ()
    settings = settings.model_copy(update={"masks": follow_masks(settings.masks, sources)})
    if weights is not None and settings.weights is not None:
        from hulldown.training.detectors.detr import check_weights

        check_weights(weights, settings, classes)
    checked = check_pictures([*sources, *held_back], progress=partial(progress, "checking pictures"))
    for shared in [pair for one in held_back for source in sources for pair in shared_pictures(source, one, checked)]:
        say(f"warning: {shared}: the result on it flatters")
    resolution = settings.resolution or 0
    size = small_size(resolution) if small else (resolution, resolution)
    config = {
        "settings": settings.model_dump(mode="json"),
        "classes": list(classes),
        "data": {source.name: {"images": len(source), "sha256": checked[source.name].sha256} for source in sources},
        "valid": {"images": len(held_back[0]), "sha256": checked["valid"].sha256} if held_back else None,
        "weights_sha256": None if weights is None else hashlib.sha256(weights.read_bytes()).hexdigest(),
        **({"draws_sha256": hashlib.sha256(draws_file.read_bytes()).hexdigest()} if draws_file is not None else {}),
    }
    with opened(out, config) as folder:
        if (run := folder.finished()) is not None:
            say(f"{out}: is finished already")
            return run
        names, files = [source.name for source in sources], [source.file_names for source in sources]
        if draws_file is not None and not folder.draws.exists():
            replace_file(folder.draws, draws_file.read_bytes())
        if not folder.draws.exists():
            draws = make_draws(list(map(len, sources)), settings.budget, seed=settings.seed, shares=shares)
            replace_file(folder.draws, draws_text(draws, names, files))
        draws = read_draws(folder.draws, names, files)
        if len(draws) != settings.budget:
            raise ValueError(f"draws_file: expected {settings.budget} draws, got {len(draws)}")
        run = _description(settings, size, classes, data, sources, draws, chosen)
        folder.write_json(RUN_NAME, run)
        examples = DrawnExamples(sources, draws, size, table, masks=bool(settings.masks))
        started = time.monotonic()
        with quiet():
            fitted = (_fit_small if small else _fit_detr)(
                settings, classes, examples, folder, weights=weights, device=chosen, checkpoint_every=checkpoint_every,
                judge=partial(validation_figures, source=held_back[0]) if held_back else None,
                workers=_workers() if workers is None else workers, progress=partial(progress, "training"), say=say,
            )  # fmt: skip
        detector, saved, rows, validated = fitted
        content = io.BytesIO()  # PyTorch hides the reason where a disk is full
        torch.save(saved, content)
        replace_file(folder.weights, content.getbuffer())
        run["figures"] = _figures(rows, settings, time.monotonic() - started)
        if held_back:
            found = validation_figures(detector, held_back[0], progress=partial(progress, "validating"))
            run["figures"]["valid"] = found
            validated = [*validated, [rows[-1][0], found["ap"], found["ap50"], found["ap75"]]]
        folder.write_metrics(rows, validated)
        run["status"] = "finished"
        folder.write_json(RUN_NAME, run)
        folder.checkpoint.unlink(missing_ok=True)
        return run


def usable_weights(settings: Settings) -> Path | None:
    """The file that training starts from, None for random weights.

    Raises
    ------
    HulldownError
        If there is none, it cannot be fetched, or the network cannot be built as the settings say.
    """
    if settings.model != "small":
        from hulldown.training.detectors.detr import check_resolution, starting_weights

        check_resolution(settings)
        return starting_weights(settings)
    if settings.weights not in (None, "none"):
        raise ConfigError("weights: small starts from random ones", remedy="leave --weights out, or name a model")
    return None


def _fit_small(
    settings: Settings, classes: Sequence[str], examples: DrawnExamples, folder: RunFolder, *,
    weights: Path | None, device: torch.device, checkpoint_every: int | None, judge: Judge | None, workers: int,
    progress: Callable[[int, int], None], say: Callable[[str], None],
) -> Fitted:  # fmt: skip
    parts, ranks = _parts(settings, device)
    batches = Batches(len(examples), batch=settings.batch or 1, parts=parts, first=_steps_done(folder), ranks=ranks)
    pl.seed_everything(settings.seed % 2**32, verbose=False)
    module = SmallModule(CentreNetwork(len(classes)), settings, batches.steps)
    average = AveragedWeights()

    def averaged() -> Detector:
        network = deepcopy(module.network)
        network.load_state_dict(average.averaged("network."))
        return SmallDetector(network, tuple(classes), examples.size, device)

    validator = Validator(batches.steps, judge and (lambda: judge(averaged())))
    recorder = _recorder(folder, validator, batches.steps, checkpoint_every, progress, say)
    trainer = pl.Trainer(
        max_epochs=1, accelerator="gpu" if device.type == "cuda" else "cpu", devices=ranks,
        accumulate_grad_batches=parts // ranks, precision="bf16-mixed" if device.type == "cuda" else "32-true",
        gradient_clip_val=10.0, callbacks=[StepSeeds(settings.seed), average, validator, recorder], **_OURS,
    )  # fmt: skip
    data = loader(list, examples=examples, batches=batches, workers=workers)
    _run(trainer, folder, module, train_dataloaders=data)
    detector = SmallDetector(module.network, tuple(classes), examples.size, device)
    return detector, save_small(module.network, classes, examples.size), recorder.rows, validator.rows


def _fit_detr(
    settings: Settings, classes: Sequence[str], examples: DrawnExamples, folder: RunFolder, *,
    weights: Path | None, device: torch.device, checkpoint_every: int | None, judge: Judge | None, workers: int,
    progress: Callable[[int, int], None], say: Callable[[str], None],
) -> Fitted:  # fmt: skip
    from rfdetr.training.trainer import build_trainer

    from hulldown.training.detectors.detr import (
        DrawnData,
        averaged_detector,
        averaging,
        detector_of,
        detr_configs,
        detr_module,
        save_detr,
    )

    parts, ranks = _parts(settings, device)
    batches = Batches(len(examples), batch=settings.batch or 1, parts=parts, first=_steps_done(folder), ranks=ranks)
    model_config, train_config = detr_configs(
        settings, classes, batches.steps, weights=weights, device=device, folder=folder.path
    )
    pl.seed_everything(settings.seed % 2**32, verbose=False)
    module = detr_module(model_config, train_config)
    average = averaging(train_config)
    validator = Validator(batches.steps, judge and (lambda: judge(averaged_detector(module, average, classes, device))))
    recorder = _recorder(folder, validator, batches.steps, checkpoint_every, progress, say)
    trainer = build_trainer(
        train_config, model_config, devices=ranks, accumulate_grad_batches=parts // ranks,
        callbacks=[StepSeeds(settings.seed), average, validator, recorder], **_OURS,
    )  # fmt: skip
    data = DrawnData(model_config, train_config, partial(loader, examples=examples, batches=batches, workers=workers))
    _run(trainer, folder, module, datamodule=data)
    return detector_of(module, classes, device), save_detr(module, classes), recorder.rows, validator.rows


# What Lightning would do beside the steps is done here, or must not be: nothing but the budget ends a run.
_OURS: Mapping[str, Any] = {
    "logger": False,
    "enable_checkpointing": False,
    "enable_progress_bar": False,
    "enable_model_summary": False,
    "num_sanity_val_steps": 0,
    "limit_val_batches": 0,
    "use_distributed_sampler": False,
    "deterministic": "warn",
}


def _run(trainer: pl.Trainer, folder: RunFolder, module: pl.LightningModule, **data: Any) -> None:
    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    checkpoint = str(folder.checkpoint) if folder.checkpoint.exists() else None
    if checkpoint:
        held, wanted = (_shapes(state) for state in (_read_checkpoint(folder)["state_dict"], module.state_dict()))
        if held != wanted:
            raise _foreign(folder, "holds other weights")
    try:
        trainer.fit(module, ckpt_path=checkpoint, weights_only=True if checkpoint else None, **data)
    except SystemExit:  # what Lightning makes of Ctrl-C
        raise KeyboardInterrupt from None
    except HulldownError as error:
        # A loader's process hands its error over as text, behind its traceback.
        _, raised, text = str(error).rpartition(f"{type(error).__module__}.{type(error).__qualname__}: ")
        raise (HulldownError(text) if raised else error) from None
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])


def _shapes(state: Mapping[str, Any]) -> dict[str, Any]:
    return {key: getattr(value, "shape", None) for key, value in state.items()}


def _parts(settings: Settings, device: torch.device) -> tuple[int, int]:
    """Batches in a step, and the processes that share them."""
    accumulate = settings.accumulate or 1
    ranks = torch.cuda.device_count() if device.type == "cuda" and device.index is None else 1
    if accumulate % ranks:
        raise DetectorError(
            f"accumulate = {accumulate} cannot be shared by {ranks} GPUs",
            remedy=f"take a multiple of {ranks} with a smaller batch, or fewer GPUs by CUDA_VISIBLE_DEVICES",
        )
    return accumulate, ranks


def _steps_done(folder: RunFolder) -> int:
    """Steps that the checkpoint holds, 0 without one."""
    return int(_read_checkpoint(folder)["global_step"]) if folder.checkpoint.exists() else 0


def _read_checkpoint(folder: RunFolder) -> dict[str, Any]:
    """What the checkpoint holds.

    Raises
    ------
    DetectorError
        If it's damaged, or not of this training.
    """
    try:
        found = torch.load(folder.checkpoint, map_location="cpu", weights_only=True, mmap=True)
    except DAMAGED as error:
        raise _foreign(folder, f"is damaged ({first_line(error)})") from None
    parts = ("global_step", "state_dict", "callbacks", "loops", "optimizer_states", "lr_schedulers")
    if not isinstance(found, dict) or any(part not in found for part in parts):
        raise _foreign(folder, "is no checkpoint of a training")
    if not isinstance(found["callbacks"], dict) or Recorder.__qualname__ not in found["callbacks"]:
        raise _foreign(folder, "is of another training")
    return found


def _foreign(folder: RunFolder, problem: str) -> DetectorError:
    return DetectorError(problem, path=folder.checkpoint, remedy="delete it, and training begins anew")


def _recorder(
    folder: RunFolder, validator: Validator, steps: int, every: int | None,
    progress: Callable[[int, int], None], say: Callable[[str], None],
) -> Recorder:  # fmt: skip
    def estimate(seconds: float) -> None:
        say(f"about {_duration(seconds)} of training left")

    return Recorder(
        folder.checkpoint, steps=steps, every=every, progress=progress, estimate=estimate,
        on_checkpoint=lambda rows: folder.write_metrics(rows, validator.rows),
    )  # fmt: skip


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} seconds"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.1f} hours"


def _workers() -> int:
    """One for each core but the one that trains, at most 8."""
    return max(1, min(8, len(os.sched_getaffinity(0)) - 1 if hasattr(os, "sched_getaffinity") else 1))


def _description(
    settings: Settings, size: tuple[int, int], classes: Sequence[str], data: Mapping[str, Path | str],
    sources: Sequence[Source], draws: Draws, device: torch.device,
) -> dict[str, Any]:  # fmt: skip
    """run.json of a run that begins."""
    counts = draws.counts(list(map(len, sources)))
    return {
        "status": "running",
        "model": settings.model,
        "resolution": list(size),
        "classes": list(classes),
        "budget": settings.budget,
        "seed": settings.seed,
        "effective_batch": settings.effective_batch,
        "batch": settings.batch,
        "accumulate": settings.accumulate,
        "steps": Batches(settings.budget, batch=settings.batch or 1, parts=settings.accumulate or 1).steps,
        "masks": settings.masks,
        "augmented": any(line.probability for line in changed_table(settings.augmentation).values()),
        "sources": {
            source.name: {
                "folder": str(Path(data[source.name]).resolve()),
                "images": len(source),
                "drawn": int(found.sum()),
                "draws_per_image": {"mean": float(found.mean()), "least": int(found.min()), "most": int(found.max())},
            }
            for source, found in zip(sources, counts, strict=True)
        },
        "device": str(device),
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in VERSIONS},
        "figures": {},
    }


def _figures(rows: Sequence[Sequence[float]], settings: Settings, seconds: float) -> dict[str, Any]:
    """What the steps say together; times of killed parts are in them as far as checkpoints reach."""
    _, losses, _, took, waited = np.array(rows).T
    tail = losses[-max(1, math.ceil(len(losses) / 20)) :]
    # The first step of a process starts workers and warms up.
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
