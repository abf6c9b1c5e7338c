"""Cluster: the cost of Dask, compared with workers of this machine, and of kills. Real Dask and Blender processes."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.benchmarks.rendering import planned
from hulldown.benchmarks.rendering_error import FAST
from hulldown.benchmarks.tables import table
from hulldown.cluster.scheduler import SHARE_VARIABLE, Scheduler
from hulldown.demo.project import create_project
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan
from hulldown.render.blender.messages import CyclesSettings, RenderJob
from hulldown.render.cluster_pool import ClusterPool
from hulldown.render.jobs import blender_readable_paths, make_render_job
from hulldown.render.outline import row_sort_key
from hulldown.render.pool import Engine, Pool
from hulldown.render.process import Confinement
from hulldown.render.supervisor import render_remaining_images
from hulldown.tests.builders.clusters import Cluster, blenders, cluster, digests

SIZES = ((96, 54), (480, 270))
WORKER_COUNT = 2
ROWS_PER_TURN = 8  # rows that one way renders before the other does
TINY = {"profile": "fast", "samples": 2}


def run(quick: bool) -> dict[str, Any]:
    """Measure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = create_project(folder, seed=0)
        return {
            "overhead": [
                overhead(
                    *planned(folder, config, 6, size, one_of_a_class=True, scenery="dry_steppe", render=dict(FAST)),
                    folder / f"overhead-{size[0]}",
                    2 if quick else 3,
                )
                for size in SIZES
            ],
            "kills": _kills(folder, config, 3 if quick else 20),
        }


def overhead(plan: Plan, library: Library, output: Path, rounds: int) -> dict[str, Any]:
    """Time the same rows on two workers of this machine and on two of Dask's, in turn; all keep loaded assets."""
    rows = sorted(plan, key=row_sort_key)[:ROWS_PER_TURN]
    settings = plan.config.render
    cycles = CyclesSettings(settings.samples, settings.denoise, settings.adaptive_threshold, settings.bounces)
    output.mkdir()

    def job(i: int) -> RenderJob:
        return make_render_job(rows[i], library, cycles, output / f"{i}.png")

    def once(pool: Pool | ClusterPool) -> float:
        began = time.perf_counter()
        assert not any(outcome.reasons for _, outcome in pool.results(range(len(rows)), job))
        return time.perf_counter() - began

    engine = Engine(workers=WORKER_COUNT, device="cpu")
    took: dict[str, list[float]] = {"local": [], "cluster": []}
    with cluster(output / "nodes") as nodes:
        for _ in range(WORKER_COUNT):
            nodes.add(environment={SHARE_VARIABLE: str(WORKER_COUNT)})
        with (
            Pool(output / "logs", engine, confinement=Confinement(output, blender_readable_paths(library))) as local,
            ClusterPool(Scheduler(nodes.address), engine, library, say=lambda line: None, stopping=lambda: False) as dask,
        ):
            once(local), once(dask)  # everything is loaded
            for _ in range(rounds):
                took["local"].append(once(local))
                took["cluster"].append(once(dask))
    per_second = {way: ROWS_PER_TURN / statistics.median(seconds) for way, seconds in took.items()}
    size = (rows[0].width, rows[0].height)
    return {"size": size, "rows": ROWS_PER_TURN, "seconds": took, "images_per_second": per_second}


def _kills(folder: Path, config: Path, n: int) -> dict[str, Any]:
    """Render a plan on three workers; one of them, or its Blender, is killed again and again, and replaced."""
    plan, library = planned(folder, config, 4 * n, SIZES[0], one_of_a_class=True, render=TINY)
    render_remaining_images(plan.path, folder / "whole", library=library, engine=Engine(device="cpu"))
    found: dict[str, Any] = {"images": len(plan), "workers": 3}
    rng = np.random.default_rng(3)
    for name in ("quiet", "killed"):
        victims: list[str] = []
        with cluster(folder / name / "nodes", 3) as nodes:
            report = render_remaining_images(
                plan.path,
                folder / name / "dataset",
                library=library,
                progress=lambda progress, nodes=nodes, victims=victims, kill=name == "killed": (
                    _strike(nodes, victims, rng)
                    if kill and len(victims) < n and progress.finished > 3 * (len(victims) + 1)
                    else None
                ),
                engine=Engine(device="cpu", scheduler=Scheduler(nodes.address)),
            )
        found[name] = {
            "seconds": report.seconds,
            "workers killed": victims.count("worker"),
            "Blenders killed": victims.count("Blender"),
            "differences": {"files": len(digests(folder / "whole").items() ^ digests(folder / name / "dataset").items())},
        }
    return found


def _strike(nodes: Cluster, victims: list[str], rng: np.random.Generator) -> None:
    alive = [worker for worker in nodes.workers if worker.poll() is None and blenders(worker)]
    if not alive:
        return
    worker = alive[rng.integers(len(alive))]
    if rng.random() < 0.5:
        for process in blenders(worker):
            process.kill()
        victims.append("Blender")
    else:
        worker.kill()
        worker.wait()
        nodes.add()
        victims.append("worker")


def report(results: dict) -> str:
    """Return a Markdown section."""
    return "\n\n".join(["## Cluster", _told_overhead(results["overhead"]), _told_kills(results["kills"])])


def _told_overhead(entries: list[dict]) -> str:
    rows = []
    for entry in entries:
        speed, seconds = entry["images_per_second"], entry["seconds"]
        ratios = [b / a for a, b in zip(seconds["local"], seconds["cluster"], strict=True)]
        rows.append((
            f"{entry['size'][0]} x {entry['size'][1]}",
            f"{speed['local']:.2f}",
            f"{speed['cluster']:.2f}",
            f"{100 * (statistics.median(ratios) - 1):+.0f}%",
        ))  # fmt: skip
    return (
        f"**Overhead.** {ROWS_PER_TURN} rows of one scenery, fast profile, in turn by "
        f"`hulldown render --workers {WORKER_COUNT}` and by {WORKER_COUNT} `dask worker` on the same machine, with "
        "everything loaded.\n\n"
    ) + table(["picture", "local, images/s", "Dask, images/s", "Dask takes"], rows)


def _told_kills(kills: dict) -> str:
    quiet, killed = kills["quiet"], kills["killed"]
    workers, blenders = killed["workers killed"], killed["Blenders killed"]
    wrong = any(count for run in (quiet, killed) for count in run["differences"].values())
    each = (killed["seconds"] - quiet["seconds"]) / max(workers + blenders, 1)
    return (
        f"**Kills.** {kills['images']} images of 96 x 54 on {kills['workers']} workers, with {workers + blenders} "
        f"kills without warning: {workers} workers, which are replaced, and {blenders} Blenders. "
        f"{killed['seconds']:.0f} s in place of {quiet['seconds']:.0f} s, {each:.1f} s a kill. "
        + ("**The datasets differ.**" if wrong else "All files but logs are equal to those of a run without Dask.")
    )


def plots(results: dict, folder: Path) -> list[Path]:
    """Return nothing: the tables are enough."""
    return []
