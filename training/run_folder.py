"""The folder of a training run: config, draws, checkpoint, and results."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from filelock import FileLock, Timeout
from msgspec import Meta, Struct
from msgspec.structs import replace

from hulldown.base.errors import ConfigError, HulldownError
from hulldown.base.files import replace_file, replacing
from hulldown.base.outside import read_json, typed
from hulldown.training.detectors.detector import RUN_NAME, WEIGHTS_NAME, Run, read_run

CONFIG_NAME, DRAWS_NAME, METRICS_NAME, CURVE_NAME = "config.json", "draws.csv", "metrics.csv", "loss.png"
VALIDATION_NAME = "validation.csv"
CHECKPOINT_NAME, BEST_NAME = "checkpoint.ckpt", "best.pt"
LOCK_NAME = ".hulldown.lock"
METRICS = ("step", "loss", "learning_rate", "seconds", "waited_for_data_s")
VALIDATION = ("step", "ap", "ap50", "ap75")


_Draws = Annotated[int, Meta(ge=0, le=1_000_000_000)]


class RunData(Struct, frozen=True):
    """A dataset of a run: its number of images, and the hash of its pictures and labels."""

    images: int
    sha256: str


class RunConfig(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What determines a run's weights: the contents of config.json."""

    settings: dict[str, object]  # of `training.inputs.settings.Settings`
    classes: list[str]
    data: dict[str, RunData]
    valid: RunData | None
    weights_sha256: str | None
    after: _Draws = 0  # draws of the run that this one extends
    draws_sha256: str | None = None  # of the user's draws
    prepared: bool = False  # by `extension`, with other settings and weights to follow

    @property
    def budget(self) -> int:
        """The number of draws; ValueError if it isn't one."""
        return typed(self.settings.get("budget"), _Draws)


class RunFolder:
    """Paths of a run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / CONFIG_NAME  # settings, classes, and hashes of data
        self.draws = path / DRAWS_NAME
        self.checkpoint = path / CHECKPOINT_NAME
        self.weights = path / WEIGHTS_NAME
        self.best = path / BEST_NAME  # weights of the best validation so far, with `keep = "best"`

    def before(self, draws: int) -> Path:
        """Return the folder of the finished run of `draws`, before it was extended."""
        return self.path / f"before-{draws}"

    def finished(self) -> Run | None:
        """Return the contents of run.json, if the run is finished."""
        if not (self.path / RUN_NAME).exists() or not self.weights.exists():
            return None
        run = read_run(self.path)
        return run if run.status == "finished" else None

    def write(self, record: Run | RunConfig) -> None:
        """Replace run.json or config.json in one step."""
        path = self.path / RUN_NAME if isinstance(record, Run) else self.config
        text = json.dumps(msgspec.to_builtins(record), indent=2, ensure_ascii=False)
        replace_file(path, text.encode() + b"\n")

    def write_metrics(self, rows: Sequence[Sequence[float]], validated: Sequence[Sequence[float]]) -> None:
        """Replace metrics.csv, validation.csv if there is one, and their chart."""
        _write_table(self.path / METRICS_NAME, METRICS, rows)
        if validated:
            _write_table(self.path / VALIDATION_NAME, VALIDATION, validated)
        _draw_curves(rows, validated, self.path / CURVE_NAME)


def content_of(weights: Mapping[str, object]) -> memoryview:
    """Return the bytes of a weights file."""
    import torch

    content = io.BytesIO()  # PyTorch hides the reason of a full disk
    torch.save(dict(weights), content)
    return content.getbuffer()


def extension(path: Path, draws: int) -> int:
    """Prepare a finished run for more draws, and return its number of draws; its files move to `RunFolder.before`.

    A stopped extension is continued. `draws` is the number of further draws.
    """
    folder = RunFolder(path)
    refuse = partial(ConfigError, path=folder.config, remedy="name the folder of a finished run")
    config = read_json(folder.config, RunConfig, refuse, what="the config of a run")
    try:
        after, budget = config.after, config.budget
    except ValueError as error:
        raise refuse(f"isn't the config of a run ({error} - at `$.settings.budget`)") from None
    with alone_in(path, marker=CONFIG_NAME, what="run"):
        if not folder.finished() and not folder.before(after + budget).exists():
            if after and budget == draws:
                return after
            remedy = "finish it first, by the command that began it"
            raise ConfigError("the run isn't finished", path=path, remedy=remedy)
        kept = folder.before(after + budget)
        files = [file for file in path.iterdir() if file.is_file() and file.name != LOCK_NAME]
        if not kept.exists():
            moving = kept.with_name(f"{kept.name}.unfinished")
            shutil.rmtree(moving, ignore_errors=True)
            moving.mkdir()
            for file in files:
                shutil.copy2(file, moving / file.name)
            moving.rename(kept)
        for file in files:
            if file != folder.config:  # it marks the folder as a run until the extension replaces it
                file.unlink()
        folder.write(replace(config, after=after + budget, settings={"budget": draws}, prepared=True))
    return after + budget


@contextmanager
def alone_in(folder: Path, *, marker: str, what: str) -> Iterator[None]:
    """Lock a folder that is new, empty, or has the file `marker`."""
    if folder.exists() and not (folder / marker).exists():
        held = [one.name for one in folder.iterdir()] if folder.is_dir() else [folder.name]
        if strangers := [name for name in held if name != LOCK_NAME]:
            raise ConfigError(f"holds {strangers[0]} and no {what}", path=folder, remedy="name a new or empty folder")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / LOCK_NAME, timeout=0):
            yield
    except Timeout:
        remedy = "wait until it has ended, or name another folder"
        raise HulldownError(f"another process is at work on this {what}", path=folder, remedy=remedy) from None


@contextmanager
def opened(path: Path, config: RunConfig) -> Iterator[RunFolder]:
    """Open and lock a run's folder, made if missing."""
    folder = RunFolder(path)
    if folder.config.exists():
        _check_same(folder.config, config)
    with alone_in(path, marker=CONFIG_NAME, what="run"):
        folder.write(config)
        yield folder


def _check_same(path: Path, config: RunConfig) -> None:
    refuse = partial(ConfigError, path=path, remedy="name a new folder")
    before = read_json(path, RunConfig, refuse, what="the config of a run")
    if before.prepared:
        return
    was, now = (dict(_flat(msgspec.to_builtins(value))) for value in (before, config))
    for key in sorted({*was, *now}):
        if was.get(key) != now.get(key):
            raise ConfigError(
                f"the run in this folder has {key} = {was.get(key)!r:.60}, not {now.get(key)!r:.60}",
                path=path, remedy="name a new folder, or train with what that run has",
            )  # fmt: skip


def _flat(value: object, key: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else name)
    else:
        yield key, value


def _write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
    text, formats = io.BytesIO(), ["%d", *["%.6g"] * (len(columns) - 1)]
    table = np.reshape(rows, (-1, len(columns)))
    np.savetxt(text, table, formats, delimiter=",", header=",".join(columns), comments="")
    replace_file(path, text.getvalue())


def _draw_curves(rows: Sequence[Sequence[float]], validated: Sequence[Sequence[float]], path: Path) -> None:
    from matplotlib.figure import Figure

    steps, losses = (np.array([row[i] for row in rows]) for i in (0, 1))
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(steps, losses, lw=0.5, alpha=0.4, color="tab:blue", label="loss of each step")
    width = max(1, len(losses) // 50)
    if len(losses) >= 2 * width:
        smooth = np.convolve(losses, np.ones(width) / width, mode="valid")
        axes.plot(steps[width - 1 :], smooth, color="tab:blue", label=f"mean of {width}")
    axes.set(xlabel="step", ylabel="loss", ylim=(0.0, None))
    if validated:
        points = np.array(validated)
        right = axes.twinx()
        right.plot(points[:, 0], points[:, 2], ".-", color="tab:orange", label="AP50 in validation")
        right.plot(points[:, 0], points[:, 1], ".--", color="tab:orange", label="AP")
        right.set(ylabel="average precision", ylim=(0.0, 1.0))
        right.legend(loc="upper right")
    axes.legend(loc="lower left")
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=120)
