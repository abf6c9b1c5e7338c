"""Top hits on hills of one, two, and ten sheets, and on the demo's sceneries, whose fields and roads are sheets."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hulldown.assets.bundle import load_scenery
from hulldown.benchmarks import top_hits_peers as peers
from hulldown.benchmarks.tables import table
from hulldown.benchmarks.top_hits import RAW, bold, timed
from hulldown.demo.project import create_project
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.reading.cache import cached_export_and_digest
from hulldown.reading.pieces.options import Options

HILL_TRIANGLES = 150_000  # triangles, about as many as the demo's sceneries have
SCENERIES = ("temperate_hills", "dry_steppe")


def run(quick: bool) -> dict:
    """Measure."""
    rays, rounds = (100_000, 3) if quick else (500_000, 5)
    return {
        "rays": rays,
        "speed": {name: {"triangles": len(mesh.faces), **_speed(mesh, rays, rounds)} for name, mesh in _grounds()},
    }


def _grounds() -> Iterator[tuple[str, Mesh]]:
    hills = peers.hills(HILL_TRIANGLES)
    yield "hills", hills
    for sheets in (2, 10):
        layers = [Mesh(hills.vertices - [0, 0, float(i)], hills.faces) for i in range(sheets)]
        yield f"{sheets} sheets", merge_meshes_with_sources(layers)[0]
    with TemporaryDirectory() as folder:
        create_project(folder)
        for name in SCENERIES:
            file = Path(folder, "sceneries", f"{name}.blend")
            exported, _ = cached_export_and_digest(file, Path(folder, "cache"), kind="scenery", options=Options())
            ground = load_scenery(exported.bundle).ground
            assert ground is not None
            yield name, ground


def _speed(mesh: Mesh, rays: int, rounds: int) -> dict[str, float]:
    """Median rays a CPU second, each way on one thread."""
    xy = peers.points(mesh, rays)
    queries: dict[str, Callable] = {RAW: peers.raw_embreex(mesh), "embreex, sorted and centered": peers.sorted_embreex(mesh)}
    for peer in (peers.ours, peers.trimesh_peer, peers.open3d_peer):
        try:
            queries |= {name: query for name, query in peer(mesh).items() if "threads" not in name}
        except ImportError:
            continue
    seconds = timed(queries, xy, rounds, time.process_time)
    return {name: rays / float(np.median(took)) for name, took in seconds.items()}


def report(results: dict) -> str:
    """Return a Markdown section."""
    speed = results["speed"]
    head = [f"{name}, {figures['triangles']:,}" for name, figures in speed.items()]
    names = [name for name in next(iter(speed.values())) if name != "triangles"]
    rows = [(bold(name), *(f"{some[name] / 1e6:.2f}" for some in speed.values())) for name in names]
    return "\n\n".join([
        "## Top hits on ground of several sheets",
        f"Million points a CPU second on one thread, for {results['rays']:,} random ones: hills of one, two, and ten "
        "sheets, 1 m apart, and the demo's sceneries, with fields and roads over the terrain.",
        table(["ground, triangles", *head], rows),
    ])  # fmt: skip


def plots(results: dict, folder: Path) -> list[Path]:
    """None: the table shows it."""
    return []
