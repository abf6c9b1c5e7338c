"""Cluster: what Dask costs beside workers of this machine, what kills cost, what a large plan asks of the scheduler.

Real Dask processes. Real Blender but where a pixel stands in for its picture, which is said.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from distributed import Client
from matplotlib.figure import Figure

from benchmarks.clusters import Cluster, blenders, cluster
from benchmarks.rendering import planned
from benchmarks.rendering_error import FAST
from demo.project import create_project
from planning.config import parse_config
from planning.plan_file import Plan
from render.cluster_pool import ClusterPool
from render.confinement import confinement_of
from render.jobs import RenderAssets, render_job
from render.messages import Settings, to_json
from render.node import SHARE_VARIABLE
from render.pool import DEFAULT_LIMITS, Pool
from render.remaining import sort_key
from render.scheduler import Scheduler
from render.session import Session
from render.supervisor import render_plan
from tests.oracles.resuming import differences

SIZES = ((96, 54), (480, 270))
WORKERS = 2
CHUNK = 8  # rows that one way renders before the other does
TINY = {"profile": "fast", "samples": 2}
STUB = "benchmarks.cluster_stub"
SAMPLES = 40  # of the scheduler's memory


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
            "client": _client(folder, config, 4 if quick else 12),
            "scheduler": large_plan(
                *planned(folder, config, 2, SIZES[0], one_of_a_class=True),
                folder / "pixels",
                2_000 if quick else 100_000,
            ),
        }


def overhead(plan: Plan, assets: RenderAssets, output: Path, rounds: int) -> dict[str, Any]:
    """The same rows by two workers of this machine and by two of Dask's, in turn; all keep what they have loaded."""
    rows = sorted(plan, key=sort_key)[:CHUNK]
    settings = parse_config(plan.header.config, path=plan.path).render
    cycles = Settings(settings.samples, settings.denoise, settings.adaptive_threshold, settings.bounces)
    output.mkdir()

    def message(i: int) -> Mapping[str, Any]:
        return to_json(render_job(rows[i], assets, cycles, output / f"{i}.png"))

    def once(pool: Pool | ClusterPool) -> float:
        began = time.perf_counter()
        pool.run(range(len(rows)), message, lambda i, answer: None, lambda i, why: None)
        return time.perf_counter() - began

    took: dict[str, list[float]] = {"local": [], "cluster": []}
    with cluster(output / "nodes") as nodes:
        for _ in range(WORKERS):
            nodes.add(environment={SHARE_VARIABLE: str(WORKERS)})
        with (
            Pool(
                output / "logs",
                device="cpu",
                workers=WORKERS,
                confinement=confinement_of(assets, output, gpu=False),
            ) as local,
            _pool(nodes, assets, output) as dask,
        ):
            once(local), once(dask)  # everything is loaded
            for _ in range(rounds):
                took["local"].append(once(local))
                took["cluster"].append(once(dask))
    per_second = {way: CHUNK / statistics.median(seconds) for way, seconds in took.items()}
    size = (rows[0].width, rows[0].height)
    return {"size": size, "rows": CHUNK, "seconds": took, "images_per_second": per_second}


def _pool(nodes: Cluster, assets: RenderAssets, output: Path) -> ClusterPool:
    return ClusterPool(
        Scheduler(nodes.address),
        assets,
        device="cpu",
        limits=DEFAULT_LIMITS,
        say=lambda line: None,
        stopping=lambda: False,
    )


def _kills(folder: Path, config: Path, n: int) -> dict[str, Any]:
    """A plan on three workers, of which one, or its Blender, is killed again and again; another takes its place."""
    plan, assets = planned(folder, config, 4 * n, SIZES[0], one_of_a_class=True, render=TINY)
    render_plan(plan.path, folder / "whole", assets=assets, device="cpu")
    found: dict[str, Any] = {"images": len(plan), "workers": 3}
    rng = np.random.default_rng(3)
    for name in ("quiet", "killed"):
        victims: list[str] = []
        with cluster(folder / name / "nodes", 3) as nodes:
            report = render_plan(
                plan.path,
                folder / name / "dataset",
                assets=assets,
                device="cpu",
                scheduler=Scheduler(nodes.address),
                progress=lambda progress, nodes=nodes, victims=victims, kill=name == "killed": (
                    _strike(nodes, victims, rng)
                    if kill and len(victims) < n and progress.finished > 3 * (len(victims) + 1)
                    else None
                ),
            )
        found[name] = {
            "seconds": report.seconds,
            "workers killed": victims.count("worker"),
            "Blenders killed": victims.count("Blender"),
            "differences": differences(folder / "whole", folder / name / "dataset"),
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


def _client(folder: Path, config: Path, images: int) -> dict[str, Any]:
    """What the client does for a picture of 1080p once it has come: look at it, compute masks, publish, record."""
    plan, assets = planned(folder, config, images // 3, (1920, 1080), one_of_a_class=True, render=TINY)
    spent: list[float] = []
    done = Session._done

    def timed(self: Session, *arguments: Any) -> Any:
        began = time.perf_counter()
        result = done(self, *arguments)
        spent.append(time.perf_counter() - began)
        return result

    # Timed where it is called: what mypy forbids is meant, and undone below.
    Session._done = timed  # type: ignore[method-assign]
    try:
        render_plan(plan.path, folder / "client", assets=assets, device="cpu")
    finally:
        Session._done = done  # type: ignore[method-assign]
    sizes = [path.stat().st_size for path in (folder / "client" / "images").iterdir()]
    return {"images": len(spent), "seconds": statistics.median(spent), "bytes": statistics.median(sizes)}


def large_plan(plan: Plan, assets: RenderAssets, output: Path, rows: int) -> dict[str, Any]:
    """So many rows, all the plan's first, whose pictures are a pixel each: what scheduler and client hold and do."""
    output.mkdir()
    job = to_json(render_job(plan[0], assets, Settings(2, True, 0.0, 4), output / "pixel.png"))
    memory: list[tuple[int, float, float]] = []
    finished = 0
    with cluster(output / "nodes") as nodes:
        for _ in range(WORKERS):
            nodes.add("--preload", STUB)
        scheduler, client = psutil.Process(nodes.scheduler.pid), psutil.Process()

        def done(i: int, answer: Mapping[str, Any]) -> None:
            nonlocal finished
            finished += 1
            if finished % (rows // SAMPLES) == 0:
                memory.append((finished, *(p.memory_info().rss / 2**20 for p in (scheduler, client))))

        with _pool(nodes, assets, output) as pool:
            began, spent = time.perf_counter(), _cpu(scheduler)
            pool.run(range(rows), lambda i: job, done, lambda i, why: None)
            seconds, spent = time.perf_counter() - began, _cpu(scheduler) - spent
            sent = _sent(nodes.address)
    return {
        "rows": rows,
        "seconds": seconds,
        "scheduler_cpu_s": spent,
        "memory": memory,
        "mb_per_million": [float(slope) for slope in _slopes(memory)],
        "sent": sent,
    }


def _slopes(memory: list[tuple[int, float, float]]) -> np.ndarray:
    """(2,) MB that scheduler and client grow by in a million rows, once Dask's logs of messages are full."""
    rows, *held = np.array(memory[len(memory) // 2 :]).T
    return np.array([1e6 * np.polyfit(rows, one, 1)[0] for one in held])


def _sent(address: str) -> dict[str, list[int]]:
    """Messages and bytes that the scheduler and the workers have sent so far."""
    with Client(address, set_as_default=False) as client:
        of_workers = client.run(_sent_by_worker).values()
        return {
            "scheduler": list(client.run_on_scheduler(_sent_by_scheduler)),
            "workers": [sum(counts) for counts in zip(*of_workers, strict=True)],
        }


def _sent_by_scheduler(dask_scheduler: Any) -> tuple[int, int]:
    streams = [*dask_scheduler.stream_comms.values(), *dask_scheduler.client_comms.values()]
    return sum(stream.message_count for stream in streams), sum(stream.byte_count for stream in streams)


def _sent_by_worker(dask_worker: Any) -> tuple[int, int]:
    return dask_worker.batched_stream.message_count, dask_worker.batched_stream.byte_count


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def report(results: dict) -> str:
    """A Markdown section."""
    parts = [_told_overhead(results["overhead"]), _told_kills(results["kills"])]
    return "\n\n".join(["## Cluster", *parts, _told_plan(results["scheduler"]), _told_nodes(results["client"])])


def _told_overhead(entries: list[dict]) -> str:
    lines = [
        f"**Overhead.** The same {CHUNK} rows of one scenery, fast profile, in turn by {WORKERS} workers of "
        f"`render --workers {WORKERS}` and by {WORKERS} `dask worker` on the same machine; everything is loaded, "
        "and pictures come back through Dask. Medians.",
        "",
        "| picture | local, images/s | Dask, images/s | Dask takes | ratio of each round |",
        "|---|---:|---:|---:|---|",
    ]
    for entry in entries:
        speed, seconds = entry["images_per_second"], entry["seconds"]
        ratios = [b / a for a, b in zip(seconds["local"], seconds["cluster"], strict=True)]
        lines.append(
            f"| {entry['size'][0]} x {entry['size'][1]} | {speed['local']:.2f} | {speed['cluster']:.2f} | "
            f"{100 * (statistics.median(ratios) - 1):+.0f} % | {', '.join(f'{ratio:.2f}' for ratio in ratios)} |"
        )
    return "\n".join(lines)


def _told_kills(kills: dict) -> str:
    quiet, killed = kills["quiet"], kills["killed"]
    workers, blenders = killed["workers killed"], killed["Blenders killed"]
    wrong = any(count for run in (quiet, killed) for count in run["differences"].values())
    each = (killed["seconds"] - quiet["seconds"]) / max(workers + blenders, 1)
    return (
        f"**Kills.** {kills['images']} images of 96 x 54 on {kills['workers']} workers; {workers + blenders} times one "
        f"is killed without warning: {workers} workers, each of which another replaces, and {blenders} Blenders. "
        f"{killed['seconds']:.0f} s in place of {quiet['seconds']:.0f} s, {each:.1f} s a kill. "
        + ("**The datasets differ.**" if wrong else "All files but logs are equal to those of a run without Dask.")
    )


def _told_plan(plan: dict) -> str:
    (first, *start), (_, *end) = plan["memory"][0], plan["memory"][-1]
    by_scheduler, by_workers = (plan["sent"][who] for who in ("scheduler", "workers"))
    tasks = plan["rows"]
    return (
        f"**A large plan.** {plan['rows']:,} rows on {WORKERS} workers, a pixel in place of each picture: "
        f"a task each, {plan['seconds']:.0f} s, {1e3 * plan['scheduler_cpu_s'] / tasks:.1f} ms of the scheduler's "
        f"CPU a task. A task is {by_scheduler[0] / tasks:.1f} messages of the scheduler "
        f"({by_scheduler[1] / tasks / 1e3:.1f} kB) and {by_workers[0] / tasks:.1f} of its worker "
        f"({by_workers[1] / tasks / 1e3:.1f} kB). From the first {first:,} rows to the last, the scheduler's memory "
        f"goes from {start[0]:.0f} to {end[0]:.0f} MB, and the client's from {start[1]:.0f} to {end[1]:.0f} MB; the "
        f"slopes over the second half are {plan['mb_per_million'][0]:+.0f} and {plan['mb_per_million'][1]:+.0f} "
        "MB for a million rows."
    )


def _told_nodes(client: dict) -> str:
    per_second, carried = 1 / client["seconds"], 125e6 / client["bytes"]
    return (
        f"**How many nodes.** For a picture of 1080p that has come, the client takes {1e3 * client['seconds']:.0f} ms "
        f"(looks at it, computes masks, publishes, records; median of {client['images']}), so it is busy at "
        f"{per_second:.0f} images/s. A picture has {client['bytes'] / 1e6:.1f} MB: 1 Gbit/s carries {carried:.0f} a "
        "second. On paper, from these figures: "
        f"nodes that take 10 s for an image saturate the client at {10 * min(per_second, carried):.0f}."
    )


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw memory against rows."""
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    rows, scheduler, client = zip(*results["scheduler"]["memory"], strict=True)
    axes.plot(rows, scheduler, label="scheduler")
    axes.plot(rows, client, label="client")
    axes.set(xlabel="rows done", ylabel="memory, MB", ylim=(0, None), xlim=(0, None))
    axes.legend()
    path = folder / "cluster.png"
    figure.savefig(path, dpi=120)
    return [path]
