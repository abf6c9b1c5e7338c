"""Run a study's trainings, each in its own process, so that a failure doesn't affect the others.

On a cluster, each run is a task of a worker, which sees the study's folder and datasets under the same paths. After a
lost worker, another one continues from the last checkpoint.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import orjson
from cyclopts import Parameter
from filelock import FileLock, Timeout
from msgspec import Struct

from hulldown.base.child import Child
from hulldown.base.errors import ConfigError
from hulldown.base.files import replace_file
from hulldown.base.outside import json_of, read_json, sha256_of
from hulldown.training.run_folder import LOCK_NAME, RunFolder, alone_in
from hulldown.training.study.manifest import (
    LOGS_NAME,
    MANIFEST_NAME,
    RUNS_NAME,
    Manifest,
    PlannedRun,
    predictions_paths,
    read_manifest,
    write_manifest,
)

FAILURES_NAME = "failures.json"
POLL_S = 0.2
RESOURCE = "train"  # what `dask worker --resources "train=1"` declares
LOST = "its workers were lost"
LEFT_S = 60.0  # what a run gets to end whose worker is gone, until another continues it
# Dask's nanny sets these to 1 for tasks that share a process. A run has its own, and its weights depend on them.
NANNYS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "rfdetr", "pytorch-lightning")  # of which all machines must have the same
Progress = Callable[[str, int, int], None]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of running, which don't change results on one machine.

    Parameters
    ----------
    device
        What trains; auto is all GPUs if there are any.
    workers
        Processes of each run that read and augment pictures; by default one per core but one.
    environment
        Additional environment variables of the run's process.
    """

    device: Annotated[str, Parameter(choices=("auto", "cpu", "gpu"))] = "auto"
    workers: int | None = None
    environment: Annotated[Mapping[str, str], Parameter(parse=False)] = field(default_factory=dict)


class RunMessage(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """What the process of a run prints: its progress, or why it failed."""

    what: str = ""
    done: int = 0
    total: int = 0
    failed: str | None = None


# Runs runs of a study by their names; yields each when it ends, with the reason of a failure or None.
Launch = Callable[[Path, Sequence[str], RunOptions, Progress], Generator[tuple[str, str | None]]]


@dataclass(frozen=True, slots=True)
class Done:
    """The outcomes of a study's runs."""

    finished: tuple[str, ...]  # names of runs finished now
    already: tuple[str, ...]  # names of runs finished before
    failed: Mapping[str, str]  # name -> reason of failed runs, which the next call retries


def is_finished(study: Path, manifest: Manifest, run: PlannedRun) -> bool:
    """Return whether a run has everything for the report."""
    found = predictions_paths(study, manifest, run).values()
    return RunFolder(study / RUNS_NAME / run.folder).finished() is not None and all(path.exists() for path in found)


def run_study(
    manifest: Manifest,
    out: Path | str,
    *,
    options: RunOptions,
    launch: Launch | None = None,
    progress: Progress = lambda what, done, total: None,
    say: Callable[[str], None] = lambda line: None,
) -> Done:
    """Run the unfinished runs of a study.

    `launch`: function that runs them; None: `in_processes`, at the places of `gpu_places`.
    """
    out = Path(out)
    finished: list[str] = []
    failed: dict[str, str] = {}
    with alone_in(out, marker=MANIFEST_NAME, what="study"):
        write_manifest(manifest, out)
        _write_failures(out, failed)
        already = [run.name for run in manifest.runs if is_finished(out, manifest, run)]
        if already:
            say(f"{len(already)} of {len(manifest.runs)} runs are finished already")
        left = [run.name for run in manifest.runs if run.name not in already]
        started = (
            launch(out, left, options, progress) if launch else in_processes(out, left, gpu_places(options), progress)
        )
        with closing(started) as ended:
            for name, reason in ended:
                if reason is None:
                    finished.append(name)
                    say(f"{name}: finished ({len(already) + len(finished)} of {len(manifest.runs)} are)")
                else:
                    failed[name] = reason
                    say(f"{name}: set aside: {reason}")
                _write_failures(out, failed)
    return Done(tuple(finished), tuple(already), failed)


def in_processes(
    study: Path, names: Sequence[str], places: Sequence[RunOptions], progress: Progress
) -> Generator[tuple[str, str | None]]:
    """Run runs in processes on this machine, one per place at a time; yields names and reasons as a `Launch` does."""
    stop = threading.Event()
    slots: queue.SimpleQueue[RunOptions] = queue.SimpleQueue()
    for place in places:
        slots.put(place)

    def run(number: int, name: str) -> str | None:
        def show(what: str, done: int, total: int) -> None:
            if len(places) == 1:  # bars of several simultaneous runs would alternate
                progress(f"{name} ({number} of {len(names)}): {what}", done, total)

        place = slots.get()
        try:
            return in_a_process(study, name, place, show, stop.is_set)
        finally:
            slots.put(place)

    with ThreadPoolExecutor(len(places)) as pool:
        futures = {pool.submit(run, number, name): name for number, name in enumerate(names, 1)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:  # mainly after Ctrl-C
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)


def gpu_places(options: RunOptions) -> list[RunOptions]:
    """Return the options of simultaneous runs: one per GPU, else one."""
    import torch

    count = torch.cuda.device_count() if options.device != "cpu" else 0
    if count < 2:
        return [options]
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else [str(i) for i in range(count)]
    return [replace(options, environment={"CUDA_VISIBLE_DEVICES": name}) for name in names[:count]]


def in_a_process(
    study: Path,
    name: str,
    options: RunOptions,
    progress: Progress,
    stopping: Callable[[], bool],
    environment: Mapping[str, str] = os.environ,
) -> str | None:
    """Call `run_one` in a separate process, which ends with this one in any case."""
    command = [sys.executable, "-P", "-m", "hulldown.training.study.run_process", str(study), name]
    command += [options.device] if options.workers is None else [options.device, str(options.workers)]
    log = study / LOGS_NAME / f"{name}.txt"
    log.parent.mkdir(exist_ok=True)
    log.unlink(missing_ok=True)
    reasons: list[str] = []

    def on_line(line: bytes) -> None:
        try:
            message = json_of(line, RunMessage)
        except ValueError:
            return  # output of a library
        if message.failed is not None:
            reasons.append(message.failed)
        else:
            progress(message.what, message.done, message.total)

    env = {**environment, **options.environment}
    with Child(command, env=env, on_line=on_line, log=log) as child:
        while child.wait(POLL_S) is None:
            if stopping():
                break
        if child.kill() == 0:
            return None
        return reasons[0] if reasons else child.last_words()


def run_here(study: Path, name: str, options: RunOptions, wanted: Callable[[], bool]) -> str | None:
    """Do a run for a client in a separate process; return the reason of a failure, or None."""
    environment = {key: value for key, value in os.environ.items() if not (key in NANNYS and value == "1")}
    lock = study / RUNS_NAME / read_manifest(study).run(name).folder / LOCK_NAME
    if lock.exists():  # a lost worker's process may still run
        with suppress(Timeout), FileLock(lock, timeout=LEFT_S):
            pass
    return in_a_process(study, name, options, lambda what, done, total: None, lambda: not wanted(), environment)


def unseen(study: Path, manifest: str) -> str:
    """Return why this machine can't do runs of the study with this manifest, such as unseen files; empty if it can."""
    try:
        if manifest_digest(study) != manifest:
            return f"sees another study in {study}"
        lost = [data.folder for data in read_manifest(study).datasets.values() if not Path(data.folder).is_dir()]
    except OSError:
        lost = [str(study)]
    return f"does not see {lost[0]}, which all machines must share" if lost else ""


def manifest_digest(study: Path) -> str:
    """Return the SHA-256 of a study's manifest."""
    return sha256_of(study / MANIFEST_NAME)


def _write_failures(out: Path, failed: Mapping[str, str]) -> None:
    replace_file(out / FAILURES_NAME, orjson.dumps(dict(failed), option=orjson.OPT_INDENT_2) + b"\n")


def read_failures(out: Path) -> dict[str, str]:
    """Return the reasons by name of the runs that failed before."""
    path = out / FAILURES_NAME
    refuse = partial(ConfigError, path=path, remedy="delete it")
    return read_json(path, dict[str, str], refuse, what="a table of failures") if path.exists() else {}
