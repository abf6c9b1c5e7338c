"""Two-level scenes: rays a second and memory against the number of copies, beside one merged mesh."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from geometry.instances import InstancedScene
from geometry.meshes import Mesh, merge
from geometry.rays import RayCaster
from geometry.transforms import apply, rigid, rotation_z

REACH = 100.0  # metres: the sight lines of a dataset are short
DENSITY = 1.0 / 400.0  # trees a square metre


def run(quick: bool) -> dict[str, Any]:
    """Measure; every scene in a process of its own, so that memory can be told apart."""
    faces = 5_000 if quick else 50_000
    copies = (10, 100, 1_000) if quick else (10, 100, 1_000, 10_000)
    rays = 20_000 if quick else 200_000
    rounds = 2 if quick else 5
    merged_most = 1_000_000 if quick else 5_000_000
    rows = []
    for k in copies:
        # The merged peer stops where it would not fit: that is the point of two levels.
        kinds = ["two-level", "merged"] if k * faces <= merged_most else ["two-level"]
        rows += [_in_a_process(kind, faces, k, rays, rounds) for kind in kinds]
    return {"faces": faces, "rays": rays, "reach_m": REACH, "rows": rows}


def _in_a_process(kind: str, faces: int, copies: int, rays: int, rounds: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.instances", kind, *map(str, (faces, copies, rays, rounds))]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    return json.loads(done.stdout.splitlines()[-1])


def _tree(faces: int, rng: np.random.Generator) -> Mesh:
    """Loose leaves in a cone of 12 m."""
    height = rng.uniform(2, 12, (faces, 1))
    radius = (12.5 - height) * 0.3 * np.sqrt(rng.random((faces, 1)))
    around = rng.uniform(0, 2 * np.pi, (faces, 1))
    centre = np.concatenate([radius * np.cos(around), radius * np.sin(around), height], axis=1)[:, None]
    corners = centre + rng.normal(0, 0.1, (faces, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3), "tree")


def _measure(kind: str, faces: int, copies: int, rays: int, rounds: int) -> dict[str, Any]:
    import resource

    rng = np.random.default_rng(0)
    tree = _tree(faces, rng)
    half = np.sqrt(copies / DENSITY) / 2
    places = np.column_stack([rng.uniform(-half, half, (copies, 2)), np.zeros(copies)])
    poses = rigid(rotation_z(rng.uniform(-3, 3, copies)), places)
    poses[:, :3, :3] *= rng.uniform(0.7, 1.3, (copies, 1, 1))
    origins = np.column_stack([rng.uniform(-half, half, (rays, 2)), rng.uniform(1, 3, rays)])
    directions = rng.normal(size=(rays, 3)) * [1, 1, 0.1]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    scene: InstancedScene | RayCaster
    if kind == "merged":
        scene = RayCaster(merge([Mesh(apply(pose, tree.vertices), tree.faces) for pose in poses])[0])
    else:
        scene = InstancedScene([tree], np.zeros(copies, dtype=int), poses)
    built = time.perf_counter() - start
    seconds: dict[str, list[float]] = {"cast": [], "occluded": []}
    for _ in range(rounds):
        for name, took in seconds.items():
            start = time.perf_counter()
            getattr(scene, name)(origins, directions, max_distance=REACH)
            took.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "kind": kind,
        "copies": copies,
        "build_s": built,
        "cast_per_s": rays / float(np.median(seconds["cast"])),
        "occluded_per_s": rays / float(np.median(seconds["occluded"])),
        "memory_mb": (peak - before) / 1024,
        "process_mb": peak / 1024,
        "hit_share": float(scene.occluded(origins, directions, max_distance=REACH).mean()),
    }


def report(results: dict[str, Any]) -> str:
    """The figures as a section of docs/benchmarks.md."""
    lines = [
        "## Two-level scenes",
        "",
        f"A wood of copies of one tree of {results['faces']:,} triangles, one to 400 square metres; "
        f"{results['rays']:,} rays in random order and direction, {results['reach_m']:.0f} m long, one thread. "
        "Memory is the peak above the tree itself, rays included; the merged mesh stops where it would not fit.",
        "",
        "| copies | scene | build (s) | memory (MB) | whole process (MB) | nearest hits a second | any hits a second |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r['copies']:,} | {r['kind']} | {r['build_s']:.2f} | {r['memory_mb']:.0f} | {r['process_mb']:.0f} "
        f"| {r['cast_per_s']:,.0f} | {r['occluded_per_s']:,.0f} |"
        for r in results["rows"]
    ]
    return "\n".join(lines)


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Memory and rays a second against the number of copies."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    memory, speed = figure.subplots(1, 2)
    for kind in ("two-level", "merged"):
        rows = [r for r in results["rows"] if r["kind"] == kind]
        copies = [r["copies"] for r in rows]
        memory.loglog(copies, [max(r["memory_mb"], 1) for r in rows], "o-", label=kind)
        speed.loglog(copies, [r["cast_per_s"] for r in rows], "o-", label=kind)
    memory.set_ylabel("memory (MB)")
    speed.set_ylabel("nearest hits a second")
    for panel in (memory, speed):
        panel.set_xlabel("copies of a tree")
        panel.grid(True, which="both", alpha=0.3)
        panel.legend()
    path = Path(folder) / "instances.png"
    figure.savefig(path, dpi=120)
    return [path]


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1], *map(int, sys.argv[2:]))))
