"""Train a detector on draws from datasets with a fixed budget; a killed run can be continued."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from cyclopts import Parameter
from msgspec.structs import replace

from hulldown.base.arguments import AnyPath, make_option_check
from hulldown.base.errors import ConfigError
from hulldown.base.files import replace_file
from hulldown.base.outputs import OutputFolder
from hulldown.base.terminal import is_interactive, one_bar_per_title
from hulldown.base.terminal import print_message as show_line
from hulldown.training.detectors.detector import Run, RunFigures, RunSource, usable_torch_device, weights_digest
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.inputs.extra import require_training_extra, silence_libraries
from hulldown.training.inputs.settings import SettingOptions, Settings, load_settings
from hulldown.training.inputs.sources import (
    LabeledPictures,
    describe_shared_pictures,
    hash_source_pictures,
    read_classes_and_sources,
    should_follow_masks,
)
from hulldown.training.run_folder import CONFIG_NAME, RunConfig, RunData, RunFolder, finished_run_with_config

if TYPE_CHECKING:
    import torch

    from hulldown.training.fitting import Trainee
    from hulldown.training.inputs.data import Draws

AUGMENTATION_NAME = "augmentation.json"
VERSIONED_PACKAGES = ("torch", "torchvision", "pytorch-lightning", "rfdetr", "transformers", "albumentations",
            "opencv-python-headless", "numpy")  # fmt: skip


def _parse_named_folder(text: str) -> tuple[str, str]:
    name, _, folder = text.partition("=")
    return name, folder


NamedFolder: TypeAlias = Annotated[
    str, make_option_check("NAME=DIR, such as real=photographs", lambda text: all(_parse_named_folder(text)))
]
if TYPE_CHECKING:
    SettingsLike: TypeAlias = Settings | Mapping[str, object] | None
else:
    SettingsLike = SettingOptions | None  # for the command line


def train_detector(
    data: Sequence[NamedFolder] | Mapping[str, AnyPath],
    output: AnyPath,
    *,
    valid: AnyPath | None = None,
    config: AnyPath | None = None,
    settings: SettingsLike = None,
    workers: int | None = None,
    device: str = "auto",
    checkpoint_every_s: Annotated[float, Parameter(parse=False)] = 60.0,
    progress: Callable[[str, int, int], None] | None = None,
    say: Callable[[str], None] = show_line,
) -> Run:
    """Train a detector under a fixed budget.

    Reads datasets; writes a run with weights, metrics, and config. The same call continues a training that was
    stopped.

    Parameters
    ----------
    data
        NAME=DIR of a dataset to train on, such as real=photographs; may be repeated. In Python also name -> folder.
    output
        The run's folder.
    valid
        A dataset on which results are measured, without effect on the training.
    config
        TOML file of settings; docs/training.md has its keys. Others are the model's defaults.
    settings
        Changes to these, by the same keys; or all `Settings`.
    workers
        Processes that read and augment pictures; by default one per core but one. Pixels don't depend on it.
    device
        auto, cpu, gpu, or PyTorch's name of a device, such as cuda:1; auto is a GPU if there is one.
    checkpoint_every_s
        Seconds between checkpoints.
    progress
        Called with (title, steps done, all); None: bars in a terminal or notebook.
    say
        Called with messages for the user.

    Returns
    -------
    The contents of run.json.

    Raises
    ------
    HulldownError
        If a dataset, a setting, the starting weights, the device, or the run's folder is unusable. Nothing has
        been written then.

    Examples
    --------
    >>> run = train({"synthetic": "dataset"}, "run", settings={"model": "small", "budget": 600})  # doctest: +SKIP
    >>> run.status  # doctest: +SKIP
    'finished'
    """
    if not isinstance(settings, Settings):
        changes = vars(settings) if isinstance(settings, SettingOptions) else settings or {}
        settings = load_settings(None if config is None else Path(config), changes)
    require_training_extra()
    # Not at the top: this module can be imported without the extra.
    from hulldown.training.inputs.augment import Augmenter
    from hulldown.training.inputs.data import DrawnExamples, fill_source_shares, make_draws

    if progress is None and is_interactive():
        with one_bar_per_title() as bars:
            return train_detector(
                data, output, settings=settings, valid=valid, workers=workers, device=device,
                checkpoint_every_s=checkpoint_every_s, progress=bars, say=say,
            )  # fmt: skip
    progress = progress or (lambda what, done, total: None)
    out = Path(output)
    named = data.items() if isinstance(data, Mapping) else [_parse_named_folder(text) for text in data]
    if len(data) > len(data := dict(named)):
        raise ConfigError("two datasets have the same name", remedy="write --data NAME=DIR with other names")
    if settings.keep == "best" and valid is None:
        raise ConfigError('keep = "best" needs a dataset to validate on', remedy="add --valid DIR")
    Augmenter(settings.augmentation)  # refuses a wrong file before anything is written
    chosen = usable_torch_device(device)
    classes, sources = read_classes_and_sources(data)
    shares = fill_source_shares({source.name: len(source) for source in sources}, settings.shares)
    held_back = read_classes_and_sources({"valid": valid}, classes=classes)[1] if valid is not None else ()
    labels = read_labels(Path(valid)) if valid is not None else None
    settings = settings.model_copy(update={"masks": should_follow_masks(settings.masks, sources)})
    checked = hash_source_pictures([*sources, *held_back], progress=partial(progress, "checking pictures"))
    for shared in [pair for one in held_back for source in sources for pair in describe_shared_pictures(source, one, checked)]:
        say(f"warning: {shared}: the result on it flatters")
    start = Path(settings.weights or "none")
    run_config = RunConfig(
        settings=settings.model_dump(mode="json", exclude={"logger"}),
        classes=list(classes),
        data={source.name: RunData(len(source), checked[source.name].sha256) for source in sources},
        valid=RunData(len(held_back[0]), checked["valid"].sha256) if held_back else None,
        weights_sha256=weights_digest(start) if start.exists() else None,
    )
    if (run := finished_run_with_config(out, run_config)) is not None:
        say(f"{out}: is finished already")
        return run
    from hulldown.training.fitting import Training, fit_network

    draws = make_draws(list(map(len, sources)), settings.budget, seed=settings.seed, shares=shares)
    with silence_libraries(), OutputFolder(out, "run", [CONFIG_NAME], inputs=map(Path, data.values())):
        trainee = prepare_trainee(settings, classes, chosen, out)
        folder = RunFolder(out)
        folder.write(run_config)
        run = _new_run_record(settings, classes, data, sources, draws, chosen)
        folder.write(run)
        text = json.dumps(settings.augmentation, indent=2)  # as Albumentations' `save` writes it
        replace_file(out / AUGMENTATION_NAME, f"{text}\n".encode())
        size = (settings.resolution, settings.resolution)
        examples = DrawnExamples(sources, draws, size, settings.augmentation, masks=bool(settings.masks))
        training = Training(
            settings, examples, folder, device=chosen, workers=_default_worker_count() if workers is None else workers,
            checkpoint_every_s=checkpoint_every_s, valid=labels, progress=progress,
        )  # fmt: skip
        run = replace(run, status="finished", figures=fit_network(trainee, training))
        folder.write(run)
        folder.checkpoint.unlink(missing_ok=True)
    return run


def prepare_trainee(settings: Settings, classes: Sequence[str], device: torch.device, folder: Path) -> Trainee:
    """Return the network to train, with its starting weights, which are downloaded if necessary."""
    if settings.model == "small":
        from hulldown.training.fit_transformers import transformers_trainee

        return transformers_trainee(settings, classes, device)
    from hulldown.training.fit_detr import detr_trainee

    return detr_trainee(settings, classes, device, folder)


def _default_worker_count() -> int:
    return max(1, min(8, len(os.sched_getaffinity(0)) - 1 if hasattr(os, "sched_getaffinity") else 1))


def _new_run_record(
    settings: Settings, classes: tuple[str, ...], data: Mapping[str, str | os.PathLike[str]],
    sources: Sequence[LabeledPictures], draws: Draws, device: torch.device,
) -> Run:  # fmt: skip
    drawn = np.bincount(draws.source, minlength=len(sources)).tolist()
    return Run(
        status="running",
        model=settings.model,
        resolution=(settings.resolution, settings.resolution),
        classes=classes,
        budget=settings.budget,
        seed=settings.seed,
        effective_batch=settings.effective_batch,
        batch=settings.batch,
        accumulate=settings.accumulate,
        steps=settings.steps,
        masks=settings.masks,
        sources={
            source.name: RunSource(str(Path(data[source.name]).resolve()), len(source), count)
            for source, count in zip(sources, drawn, strict=True)
        },
        device=str(device),
        python=platform.python_version(),
        versions={name: importlib.metadata.version(name) for name in VERSIONED_PACKAGES},
        figures=RunFigures(),
    )  # fmt: skip
