"""Plan with several processes and write the file, or continue it after a kill, with the same bytes."""

from __future__ import annotations

import multiprocessing
import os
import platform
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from multiprocessing.connection import wait
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec.structs import asdict

from hulldown.assets.plan_assets import Assets, AssetSource, HdriSource
from hulldown.base.arguments import PATH_PARSER, AnyPath, Count
from hulldown.base.code import package_version
from hulldown.base.errors import ConfigError
from hulldown.base.outputs import require_replaceable_file
from hulldown.dataset.photographs import Photographs, read_photographs
from hulldown.plan.config.asset_sections import CACHE_NAME
from hulldown.plan.config.schema import Config
from hulldown.plan.given_poses import GivenPoses
from hulldown.plan.lines import PLAN_MARK, PlanWriter
from hulldown.plan.plan_file import Plan, read_plan
from hulldown.plan.row import PLAN_FORMAT, Header, ModelSource, ScenerySource
from hulldown.planning.inputs.poses import read_poses
from hulldown.planning.planner import POSITIONS_PER_BLOCK, Planner
from hulldown.planning.search.likeness import Likeness
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.pieces.asset_report import refuse_lost_geometry
from hulldown.reading.pieces.doubt import Doubt, file_warnings

ReportProgress = Callable[[int, int], None]
HEADER_PACKAGES = ("hulldown", "bpy", "numpy", "scipy", "embreex")  # a header has their versions
_BLOCKS_AHEAD_PER_WORKER = 3  # blocks that wait for a slow one; bounds memory
_MIN_BLOCK_POSITIONS = 64


def plan_dataset(
    config: Annotated[Config | str | os.PathLike[str], PATH_PARSER],
    output: AnyPath,
    *,
    workers: Count | None = None,
    strict: bool = False,
    poses: AnyPath | None = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    progress: ReportProgress | None = None,
) -> Plan:
    """Plan every pose of a dataset.

    Reads a config and its assets; writes a plan, one line an image. The same call continues a plan that was stopped.
    Doubts about assets are warnings.

    Parameters
    ----------
    config
        The config, in Python also a `Config`.
    output
        The plan file, such as plan.jsonl; replaced only when the new plan is complete.
    workers
        Processes; by default one per core. The plan doesn't depend on their number.
    strict
        Refuse missing textures and libraries, and vehicles without a place on a scenery.
    poses
        CSV file with a line for each image: scenery, vehicle, place, camera. Empty cells are planned; see
        docs/poses.md. It replaces the config's numbers of images.
    cache
        Folder for data read from assets; by default the config's.
    limits
        Time and memory for reading an asset.
    progress
        Called with the images planned so far and their total; None for a bar on a terminal or in a notebook.

    Raises
    ------
    HulldownError
        If an asset can't be read, no pose meets the config's limits, or the plan can't be written.

    Examples
    --------
    >>> made = plan("project/hulldown.toml", "project/plan.jsonl")  # doctest: +SKIP
    """
    # Local imports, since the worker processes import this module.
    from hulldown.base.terminal import progress_bar
    from hulldown.plan.library import load_library
    from hulldown.planning.appearance import count_hdri_land_images

    config = config if isinstance(config, Config) else Config.read(config)
    given = read_poses(Path(poses)) if poses else None
    path = Path(output)
    if path.suffix.lower() == ".png":
        raise ConfigError("a plan's name can't end in .png", path=path, remedy="end it in .jsonl")
    require_replaceable_file(path, "a plan", PLAN_MARK)
    photographs = None
    if config.camera.like is not None:
        photographs = read_photographs(config.folder / config.camera.like)  # before the long work
        for note in Likeness(photographs, config).box_usability_notes({entry.category for entry in config.assets.vehicles}):
            warnings.warn(note, stacklevel=2)
    library = load_library(config, strict=strict, cache=cache, limits=limits)
    refuse_lost_geometry([exported.report for exported in (*library.models.values(), *library.sceneries.values())])
    doubts = library.doubts(backdrop=config.light.backdrop == "hdri")
    unstated = unstated_doubts(doubts, config)
    for line in file_warnings(unstated):
        warnings.warn(line, stacklevel=2)
    if stated := sum(map(len, doubts.values())) - sum(map(len, unstated.values())):
        warnings.warn(f"{stated} doubts aren't repeated, since `init` wrote them into {config.path}", stacklevel=2)
    assets = library.assets
    with progress_bar("planning", progress) as advance:
        made = write_plan(
            config,
            assets,
            path,
            workers=workers or os.cpu_count() or 1,
            strict=strict,
            poses=given,
            photographs=photographs,
            progress=advance,
        )
    if config.light.backdrop == "hdri" and (seen := count_hdri_land_images(made, assets))[0]:
        warnings.warn(
            f"in {seen[0]} of the {seen[1]} images looked at, the terrain ends before the horizon and the HDRI's land "
            'is seen behind it; set light.backdrop = "sky"',
            stacklevel=2,
        )
    return made


def unstated_doubts(doubts: Mapping[str, Sequence[Doubt]], config: Config) -> dict[str, list[Doubt]]:
    """Return doubts by path, without those that `init` wrote into the config."""
    from hulldown.planning.inputs.found_assets import load_stated_doubts

    stated = load_stated_doubts(config.path, config.folder / CACHE_NAME) if config.path else {}
    return {
        path: [doubt for doubt in some if doubt not in stated.get(str(Path(path).resolve()), ())]
        for path, some in doubts.items()
    }


def write_plan(
    config: Config,
    assets: Assets,
    path: str | Path,
    *,
    workers: int = 1,
    strict: bool = False,
    poses: GivenPoses | None = None,
    photographs: Photographs | None = None,
    progress: ReportProgress | None = None,
) -> Plan:
    """Plan with assets in memory and write the plan, or continue it; parameters as for `plan_dataset` and `Planner`."""
    if workers < 1:
        raise ValueError(f"workers: expected at least 1, got {workers}")
    try:
        planner = Planner(config, assets, strict=strict, poses=poses, photographs=photographs)
    except ConfigError as error:
        # Functions that get a section don't know the config's file.
        raise ConfigError(error.problem, path=error.path or config.path, remedy=error.remedy) from None
    budget = planner.budget
    with PlanWriter(path, make_plan_header(planner, path)) as writer:
        start = _truncate_to_resume_position(writer, planner)
        if progress:
            progress(writer.rows, budget.n_images)
        size = min(max((budget.n_planned_positions - start) // (2 * workers), _MIN_BLOCK_POSITIONS), POSITIONS_PER_BLOCK)
        blocks = [(k, min(k + size, budget.n_planned_positions)) for k in range(start, budget.n_planned_positions, size)]
        workers = min(workers, max(len(blocks), 1))
        for lines, rows in _plan_blocks(planner, blocks, workers):
            writer.write(lines, rows)
            if progress:
                progress(writer.rows, budget.n_images)
        writer.finish()
    return read_plan(path)


def make_plan_header(planner: Planner, path: str | Path) -> Header:
    """Return the first line of a planner's plan that is written to this path."""
    config, assets = planner.config, planner.assets

    def recorded(kind: str, name: str) -> AssetSource:
        return assets.files.get(kind, {}).get(name, AssetSource())

    photographs = planner.photographs
    return Header(
        hulldown_plan=PLAN_FORMAT,
        images=planner.budget.n_images,
        seed=config.seed,
        root=os.path.relpath(config.folder, Path(path).parent),
        config=config.model_dump(mode="json"),
        vehicles={
            name: ModelSource(**asdict(recorded("vehicles", name)), category=assets.categories[name])
            for name in assets.vehicles
        },
        sceneries={
            name: ScenerySource(**asdict(recorded("sceneries", name)), origin=tuple(scenery.origin.tolist()))
            for name, scenery in assets.sceneries.items()
        },
        hdris={name: HdriSource(**asdict(recorded("hdris", name))) for name in assets.hdris},
        distractors={
            entry.name: ModelSource(**asdict(recorded("distractors", entry.name)), category=entry.category)
            for entry in config.assets.distractors
        },
        versions={
            "python": platform.python_version(),
            **{package: package_version(package) or "unknown" for package in HEADER_PACKAGES},
        },
        left_out=list(planner.pairs.left_out),
        photographs=None if photographs is None else AssetSource(path=str(config.camera.like), sha256=photographs.sha256),
        poses=planner.poses,
    )


def _truncate_to_resume_position(writer: PlanWriter, planner: Planner) -> int:
    """Return the first position that isn't completely in the file, and drop its rows."""
    budget = planner.budget
    if writer.rows >= budget.n_images:
        writer.keep_first_rows(budget.n_images)
        return budget.n_planned_positions
    starts = budget.positions.first_image
    position = int(np.searchsorted(starts, writer.rows, side="right")) - 1
    writer.keep_first_rows(int(starts[position]))
    return position


def _plan_blocks(planner: Planner, blocks: list[tuple[int, int]], workers: int) -> Iterator[tuple[bytes, int]]:
    if workers == 1:
        for block in blocks:
            yield planner.lines(*block)
        return
    # Not forked from this process: locks held by its threads, such as Embree's, would stay locked.
    context = multiprocessing.get_context("forkserver" if sys.platform == "linux" else "spawn")
    context.set_forkserver_preload([__name__])
    made_with = {key: getattr(planner, key) for key in ("strict", "pairs", "poses", "photographs")}
    make = partial(Planner, planner.config, planner.assets, **made_with)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(make,))
    running: deque[Future[tuple[bytes, int]]] = deque()
    try:
        for block in blocks:
            running.append(pool.submit(_block_lines_and_count, *block))
            if len(running) >= _BLOCKS_AHEAD_PER_WORKER * workers:
                yield running.popleft().result()
        while running:
            yield running.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


_planner: Planner | None = None  # of a worker process


def _begin_worker(make: Callable[[], Planner]) -> None:
    global _planner
    # The parent handles Ctrl-C, and the workers end with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _planner = make()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _block_lines_and_count(start: int, stop: int) -> tuple[bytes, int]:
    assert _planner is not None
    return _planner.lines(start, stop)
