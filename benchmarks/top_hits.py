"""Top hits: speed, error, time to build, and memory, beside every installed peer."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hulldown.benchmarks import top_hits_peers as peers
from hulldown.benchmarks.tables import table
from hulldown.benchmarks.top_hits_cases import cases, errors
from hulldown.geometry.meshes import Mesh

OURS = "hulldown"
RAW = "raw embreex"
TWO = ", 2 threads"
OPEN3D = "Open3D"
BLENDER = "Blender scene.ray_cast"
# Slow peers get one in so many of the rays: their rate is the same for fewer.
FEWER = {BLENDER: 50, "mathutils BVHTree": 50, "trimesh intersects_first": 5, "trimesh intersects_location": 5}
TERRAIN = "map coordinates (5e5, 5.4e6)"  # the case whose error the plot shows


def run(quick: bool) -> dict:
    """Measure."""
    sizes = (20_000, 200_000) if quick else (20_000, 500_000, 2_000_000, 8_000_000)
    rays, rounds = (100_000, 3) if quick else (1_000_000, 5)
    return {"rays": rays, "speed": {str(n): _speed(n, rays, rounds) for n in sizes}, "errors": _errors(300 if quick else 2_000)}


def _speed(faces: int, rays: int, rounds: int) -> dict[str, dict[str, float]]:
    """Rays a second, and the median of each round's ratio to raw embreex in that round."""
    mesh = peers.hills(faces)
    xy = peers.points(mesh, rays)
    raw = peers.raw_embreex(mesh)
    queries: dict[str, Callable] = {RAW: raw, f"{RAW}{TWO}": peers.by_two_threads(raw), **peers.ours(mesh)}
    for peer in (peers.trimesh_peer, peers.open3d_peer, peers.blender_peer):
        try:
            queries |= peer(mesh)
        except ImportError:
            continue
    seconds = timed(queries, xy, rounds, time.perf_counter)
    base = np.array(seconds[RAW])
    return {
        name: {"rays_per_s": rays / float(np.median(took)), "ratio": float(np.median(base / np.array(took)))}
        for name, took in seconds.items()
    }


def timed(queries: Mapping[str, Callable], xy: np.ndarray, rounds: int, clock: Callable[[], float]) -> dict[str, list[float]]:
    """Seconds of each query for all points, in each round but a first one that warms up; queries take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in queries}
    for warming in [True] + [False] * rounds:
        for name, query in queries.items():
            some = xy[: len(xy) // FEWER.get(name, 1)]
            start = clock()
            query(some)
            if not warming:
                seconds[name].append((clock() - start) * len(xy) / len(some))
    return seconds


def _errors(n: int) -> dict[str, dict[str, dict[str, float]]]:
    blender = _scene_ray_cast if importlib.util.find_spec("bpy") else None
    return {name: errors(mesh, xy, blender) for name, mesh, xy in cases(n)}


def _scene_ray_cast(mesh: Mesh) -> Callable:
    return peers.blender_peer(mesh)[BLENDER]


def report(results: dict) -> str:
    """Return a Markdown section."""
    speed = results["speed"]
    sizes = [f"{int(n):,}" for n in speed]
    rows = [(bold(name), *(_rate(some.get(name)) for some in speed.values())) for name in next(iter(speed.values()))]
    return "\n\n".join([
        "## Top hits",
        f"Million points a second, for {results['rays']:,} random ones over hilly terrain, with sorting and repairing. "
        "Errors are in [hard cases](hard-cases.md).",
        table(["triangles", *sizes], rows),
    ])  # fmt: skip


def bold(name: str) -> str:
    return f"**{name}**" if name == OURS else name


def _rate(figures: dict[str, float] | None) -> str:
    return f"{figures['rays_per_s'] / 1e6:.2f}" if figures else ""


def hard_cases(results: dict) -> str:
    """Return a Markdown table: every hard case against rational arithmetic."""
    found = results["errors"]
    methods = [name for name in next(iter(found.values())) if name != BLENDER]
    rows = [(case, *(_format_errors(by_method[m]) for m in methods)) for case, by_method in found.items()]
    return table(["case", *map(bold, methods)], rows, left=len(methods) + 1)


def _format_errors(e: dict[str, float]) -> str:
    rates = "/".join(f"{100 * e[key]:.2g}" if e[key] else "·" for key in ("missed", "false", "wrong"))
    return f"{rates}, {e['height']:.0e}, {e['normal_deg']:.0e}"


def plots(results: dict, folder: Path) -> list[Path]:
    """Error on one axis, time on the other; and the speeds by size."""
    from matplotlib.figure import Figure

    size = "2000000" if "2000000" in results["speed"] else list(results["speed"])[-1]
    speed, error = results["speed"][size], results["errors"]
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for i, method in enumerate(error[TERRAIN]):
        x = 1e6 / speed[RAW if method not in speed else method]["rays_per_s"]
        ordinary = max(error[TERRAIN][method]["height"], 1e-16)
        worst = min(max(by_method[method]["height"] for by_method in error.values()), 1e3)
        marker, size_ = ("*", 14) if method == OURS else ("o", 7)
        left.plot([x, x], [ordinary, worst], color=f"C{i}", lw=1, ls=":")
        left.plot(x, worst, marker, ms=size_, mfc="none", color=f"C{i}")
        left.plot(x, ordinary, marker, ms=size_, color=f"C{i}", label=method)
    left.set(
        xscale="log", yscale="log", xlabel=f"microseconds a point, {int(size):,} triangles",
        ylabel="largest height error, m", title="filled: at map coordinates; hollow: worst hard case",
    )  # fmt: skip
    left.grid(alpha=0.3)
    left.legend(fontsize=7, loc="center right")
    sizes = [int(n) for n in results["speed"]]
    ways = [name.removesuffix(TWO) for name in speed if not name.endswith(TWO)]
    for name in speed:
        rates = [results["speed"][str(n)][name]["rays_per_s"] for n in sizes]
        marker, width = ("*", 2.5) if name == OURS else (".", 1)
        line = "--" if name.endswith(TWO) else "-"
        right.plot(sizes, rates, line, marker=marker, lw=width, color=f"C{ways.index(name.removesuffix(TWO))}", label=name)
    right.set(xscale="log", yscale="log", xlabel="triangles", ylabel="points a second", title="Speed by size")
    right.grid(alpha=0.3)
    right.set_ylim(top=right.get_ylim()[1] * 6)
    right.legend(fontsize=6.5, ncols=2)
    path = folder / "top_hits.png"
    figure.savefig(path, dpi=120)
    return [path]
