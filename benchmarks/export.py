"""Reading asset files: what starting Blender, a million triangles and many instances cost, and what the cache saves."""

from __future__ import annotations

import itertools
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

from reading.build import Options
from reading.cache import cached

matplotlib.use("Agg")

BUILD = """
import bpy, math, sys
path, cells, copies = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=1000)
ground = bpy.context.object
ground.name = "Terrain"
if copies:
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)
    tree = bpy.context.object
    tree.name, tree.hide_render = "Tree", False
    system = ground.modifiers.new("trees", "PARTICLE_SYSTEM") and ground.particle_systems[0].settings
    system.type, system.count, system.use_advanced_hair = "HAIR", copies, True
    system.render_type, system.instance_object = "OBJECT", tree
bpy.ops.wm.save_as_mainfile(filepath=path)
"""
START = "import bpy"
LONG = 15.0  # seconds: no more rounds after so many


def run(quick: bool) -> dict:
    """Measure."""
    cells = (10, 300) if quick else (10, 300, 700, 1500)
    copies = (1_000, 10_000) if quick else (1_000, 10_000, 100_000)
    rounds = 1 if quick else 3
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        return {
            "start": _seconds(lambda: subprocess.run([sys.executable, "-c", START], check=True), rounds),
            "triangles": {str(2 * n * n): _reading(here, n, 0, rounds) for n in cells},
            "instances": {str(n): _reading(here, 10, n, rounds) for n in copies},
        }


def _reading(folder: Path, cells: int, copies: int, rounds: int) -> dict[str, float]:
    path = folder / f"{cells}-{copies}.blend"
    subprocess.run(
        [sys.executable, "-c", BUILD, str(path), str(cells), str(copies)], check=True, stdout=subprocess.DEVNULL
    )
    caches = (folder / f"cache {number}" for number in itertools.count())
    first = _seconds(lambda: cached(path, next(caches), kind="scenery", options=Options()), rounds)
    again = _seconds(lambda: cached(path, folder / "cache 0", kind="scenery", options=Options()), rounds)
    return {"read": first, "cached": again}


def _seconds(work: Callable[[], object], rounds: int) -> float:
    """The least of `rounds`: what the machine can do when nobody disturbs it; what takes long is done once."""
    taken: list[float] = []
    while len(taken) < rounds and sum(taken) < LONG:
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def report(results: dict) -> str:
    """A Markdown section."""
    lines = [
        "## Reading asset files",
        "",
        f"A process that starts Blender and does nothing takes {results['start']:.2f} s; reading a file into the cache "
        "contains that.",
        "",
        "| scenery | read (s) | out of the cache (s) |",
        "|---|---|---|",
    ]
    for what in ("triangles", "instances"):
        for count, taken in results[what].items():
            lines.append(f"| {int(count):,} {what} | {taken['read']:.2f} | {taken['cached']:.3f} |")
    return "\n".join(lines) + "\n"


def plots(results: dict, folder: Path) -> list[Path]:
    """Seconds against triangles and instances."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.5), sharey=True)
    for axis, what in zip(axes, ("triangles", "instances"), strict=True):
        counts = [int(n) for n in results[what]]
        for key in ("read", "cached"):
            axis.loglog(counts, [results[what][str(n)][key] for n in counts], marker="o", label=key)
        axis.axhline(results["start"], color="grey", linestyle=":", label="starting Blender")
        axis.set_xlabel(what)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("seconds")
    axes[0].legend()
    figure.tight_layout()
    path = folder / "export.png"
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    return [path]
