"""The folder of a training run: config, checkpoint, and results."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import msgspec
from msgspec import Struct

from hulldown.base.errors import ConfigError
from hulldown.base.files import replace_file
from hulldown.base.outside import read_json
from hulldown.training.detectors.detector import RUN_NAME, Run, find_weights, read_run

CONFIG_NAME, CHECKPOINT_NAME = "config.json", "checkpoint.ckpt"


class RunData(Struct, frozen=True):
    """A dataset of a run: its number of images, and the hash of its pictures and labels."""

    images: int
    sha256: str


class RunConfig(Struct, frozen=True, kw_only=True):
    """The contents of config.json, which determine a run's weights."""

    settings: dict[str, object]  # fields of `training.inputs.settings.Settings`
    classes: list[str]
    data: dict[str, RunData]
    valid: RunData | None
    weights_sha256: str | None  # of a file or folder that the settings name


class RunFolder:
    """The paths in a run's folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / CONFIG_NAME  # settings, classes, and hashes of data
        self.checkpoint = path / CHECKPOINT_NAME

    def finished(self) -> Run | None:
        """Return the contents of run.json, if the run is finished."""
        if not (self.path / RUN_NAME).exists():
            return None
        run = read_run(self.path)
        return run if run.status == "finished" and find_weights(self.path).exists() else None

    def write(self, record: Run | RunConfig) -> None:
        """Replace run.json or config.json in one step."""
        path = self.path / RUN_NAME if isinstance(record, Run) else self.config
        text = json.dumps(msgspec.to_builtins(record), indent=2, ensure_ascii=False)
        replace_file(path, text.encode() + b"\n")


def finished_run_with_config(path: Path, config: RunConfig) -> Run | None:
    """Return the contents of run.json of a finished run; a run with another config is refused."""
    folder = RunFolder(path)
    if not folder.config.exists():
        return None
    refuse = partial(ConfigError, path=folder.config, remedy="name a new folder")
    before = read_json(folder.config, RunConfig, refuse, what="the config of a run")
    was, now = (dict(_flat_key_values(msgspec.to_builtins(value))) for value in (before, config))
    for key in sorted({*was, *now}):
        if was.get(key) != now.get(key):
            raise ConfigError(
                f"the run in this folder has {key} = {was.get(key)!r:.60}, not {now.get(key)!r:.60}",
                path=folder.config, remedy="name a new folder, or train with what that run has",
            )  # fmt: skip
    return folder.finished()


def starting_weights(run: Path) -> Path:
    """Return where a run's training started: a path, or a name at the Hugging Face hub."""
    from hulldown.training.detectors.detr import pretrained_weights_path
    from hulldown.training.detectors.transformers_detector import D_FINE_NANO

    refuse = partial(ConfigError, path=run / CONFIG_NAME, remedy="name a run, or weights pretrained on COCO")
    settings = read_json(run / CONFIG_NAME, RunConfig, refuse, what="the config of a run").settings
    if (named := settings.get("weights")) is not None:
        return Path(str(named))
    model = str(settings.get("model"))
    return Path(D_FINE_NANO) if model == "small" else pretrained_weights_path(model)


def _flat_key_values(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat_key_values(inner, f"{key}.{name}" if key else name)
    else:
        yield key, value
