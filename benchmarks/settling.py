"""Settling: candidates a second, and each rule's error from the rest pose of a rigid footprint."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cbook import get_sample_data
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from hulldown.benchmarks.tables import table
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rotation_z
from hulldown.placement.candidates import sample_candidates
from hulldown.placement.rest import OTHER_WAYS, PLANE_NUDGE
from hulldown.placement.settle import SettleRules, settle
from hulldown.placement.terrain import Terrain

SIZE = np.array([7.0, 3.5, 2.5])
RULES = ("averaged", "support")
DEFAULT = ("support", 5)
SHOWN = (5, 9)  # rays a side in the tables; the plot shows all
TRUTH_CELL = 0.1  # meters between the samples of the reference
UNSURE_EDGE_M = 0.2  # meters: a center of gravity nearer to the edge of its contact triangle may tip either way


def run(quick: bool) -> dict[str, Any]:
    """Measure everything; seeded."""
    return {"speed": _speed(quick), "error": {name: _errors(*terrain, quick) for name, terrain in terrains(quick).items()}}


def _grid_mesh(heights: np.ndarray, cell: float) -> Mesh:
    rows, columns = heights.shape
    x, y = (np.arange(n) * cell - (n - 1) * cell / 2 for n in (rows, columns))
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    vertices = np.concatenate([grid, heights[..., None]], axis=-1).reshape(-1, 3)
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), "terrain")


def waves(half: float, cell: float, wave: float, relief: float) -> tuple[Mesh, Callable[[np.ndarray], np.ndarray]]:
    """Hills of one wavelength crossed by others: an analytic surface, and its mesh."""

    def height(xy: np.ndarray) -> np.ndarray:
        k = 2 * np.pi / wave
        x, y = xy[..., 0], xy[..., 1]
        return relief * (np.sin(k * x) * np.cos(0.8 * k * y) + 0.5 * np.sin(1.7 * k * x + 1.0) * np.sin(1.3 * k * y))

    x = np.linspace(-half, half, round(2 * half / cell) + 1)
    return _grid_mesh(height(np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)), cell), height


def _dem() -> Mesh:
    """A real elevation model, shrunk with its slopes from 90 m cells to 2 m cells."""
    elevation = np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))["elevation"].astype(float)
    return _grid_mesh(elevation * (2.0 / 90.0), 2.0)


def terrains(quick: bool) -> dict[str, tuple[Mesh, Callable[[np.ndarray], np.ndarray] | None]]:
    """Ground to settle on; where it is analytic, with its height."""
    half = 60.0 if quick else 150.0
    return {
        "rolling, 20 m waves": waves(half, 0.25 if not quick else 0.5, 20.0, 0.8),
        "rough, 6 m waves": waves(half, 0.25 if not quick else 0.5, 6.0, 0.25),
        "elevation model, 2 m cells": (_dem(), None),
    }


def _truth(
    height: Callable[[np.ndarray], np.ndarray], xy: np.ndarray, yaw: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Up axes and heights of the rest poses from a dense sample, and whether the pose is sure."""
    share = [np.linspace(-0.5, 0.5, round(length / TRUTH_CELL) + 1) for length in SIZE[:2]]
    samples = np.stack(np.meshgrid(share[0] * SIZE[0], share[1] * SIZE[1], indexing="ij"), -1).reshape(-1, 2)
    turn = rotation_z(yaw)[:, :2, :2]
    points = xy[:, None] + samples @ np.swapaxes(turn, 1, 2)
    heights = height(points.reshape(-1, 2)).reshape(points.shape[:2])
    gradient, z, margin = (np.array(each) for each in zip(*(_resting(samples, row) for row in heights), strict=True))
    gradient = np.einsum("kij,kj->ki", turn, gradient)
    up = np.column_stack([-gradient, np.ones(len(xy))])
    return up / np.linalg.norm(up, axis=1, keepdims=True), z, margin > UNSURE_EDGE_M


def _resting(samples: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return gradient and height of the facet of the convex hull above the middle, and how far inside the middle is.

    The mean of the facets that four nudges of the middle give, as `fit_support_planes` has it.
    """
    hull = ConvexHull(np.column_stack([samples, heights]))
    upper = hull.equations[:, 2] > 1e-12
    nx, ny, nz, offset = hull.equations[upper].T
    planes = np.column_stack([-nx / nz, -ny / nz, -offset / nz])
    ways = np.concatenate([[[1.0, 1.0]], OTHER_WAYS]) * PLANE_NUDGE * SIZE[:2]
    above = [int(np.argmin(planes[:, 2] + planes[:, :2] @ way)) for way in ways]
    corners = samples[hull.simplices[upper][above[0]]]
    side = np.roll(corners, -1, axis=0) - corners
    apart = np.abs(side[:, 0] * corners[:, 1] - side[:, 1] * corners[:, 0]) / np.linalg.norm(side, axis=1)
    *gradient, z = planes[above].mean(axis=0)
    return np.array(gradient), z, apart.min()


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors; by the chord, since the cosine of a small angle has lost its digits."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2, 0, 1)))


def _errors(mesh: Mesh, height: Callable[[np.ndarray], np.ndarray] | None, quick: bool) -> list[dict[str, Any]]:
    terrain = Terrain(mesh)
    if height is None:

        def height(xy: np.ndarray) -> np.ndarray:
            return terrain.top_hits(xy).z

    xy, yaw = sample_candidates(mesh.bounds, 200 if quick else 2000, rng=np.random.default_rng(1))
    up, z, sure = _truth(height, xy, yaw)
    lean = np.arccos(up[:, 2])
    gate = np.nanmedian(lean)
    rows = []
    for rule in RULES:
        for n in (3, 5, 7, 9):
            settled = settle(terrain, SIZE, xy, yaw, rules=SettleRules(rule=rule, n=n, max_slope=1.5, contact_n=36))
            angle = angle_deg(settled.world_from_vehicle[:, :3, 2], up)
            rows.append({
                "rule": rule, "n": n, "rays": n * n,
                "angle_median_deg": float(np.nanmedian(angle)), "angle_p95_deg": float(np.nanpercentile(angle, 95)),
                "angle_median_sure_deg": float(np.nanmedian(angle[sure])),
                "height_median_m": float(np.nanmedian(np.abs(settled.world_from_vehicle[:, 2, 3] - z))),
                "penetration_p95_m": float(np.nanpercentile(settled.penetration, 95)),
                "gap_median_m": float(np.nanmedian(settled.gap)),
                "gate_flips": float(np.mean((settled.tilt > gate) != (lean > gate))),
                "sure": float(sure.mean()),
            })  # fmt: skip
    return rows


def _speed(quick: bool) -> dict[str, Any]:
    """Candidates a CPU second on one terrain, all ways in turn; medians."""
    cells = 100 if quick else 500
    mesh, _ = waves(cells / 2, 1.0, 30.0, 1.5)
    terrain = Terrain(mesh)
    k = 5_000 if quick else 50_000
    xy, yaw = sample_candidates(mesh.bounds, k, rng=np.random.default_rng(5))

    ways = {f"{rule}, 5 x 5": SettleRules(rule=rule, contact_n=0) for rule in RULES}
    ways["support, 5 x 5, gap and penetration at 9 x 9"] = SettleRules()
    rates: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(3 if quick else 6):
        for name, rules in ways.items():
            start = time.process_time()
            settle(terrain, SIZE, xy, yaw, rules=rules)
            rates[name].append(k / (time.process_time() - start))
    return {
        "triangles": len(mesh.faces),
        "candidates": k,
        "rates": {name: statistics.median(values) for name, values in rates.items()},
    }


def report(results: dict[str, Any]) -> str:
    """Return the section of docs/benchmarks.md."""
    speed = results["speed"]
    parts = [
        "## Settling",
        f"{speed['candidates']:,} candidates on {speed['triangles']:,} triangles.",
        table(["rule and rays", "candidates/CPU s"], [(way, f"{rate:,.0f}") for way, rate in speed["rates"].items()]),
        "Error against the rest pose of a rigid footprint of 7 x 3.5 m, sampled every 0.1 m: median angle/95% angle in "
        "degrees/95% penetration/median gap in meters.",
    ]
    errors = {name: {(r["rule"], r["n"]): _error(r) for r in rows} for name, rows in results["error"].items()}
    lines = [(f"{rule}, {n} x {n}", *(by_rule[rule, n] for by_rule in errors.values())) for rule in RULES for n in SHOWN]
    parts.append(table(["rule and rays", *errors], lines))
    return "\n\n".join(parts)


def _error(r: dict[str, Any]) -> str:
    return "/".join(
        (
            f"{r['angle_median_deg']:.2f}",
            f"{r['angle_p95_deg']:.1f}",
            f"{r['penetration_p95_m']:.2f}",
            f"{r['gap_median_m']:.2f}",
        )
    )


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Angle to the rest pose against the number of rays, one panel a terrain."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    panels = figure.subplots(1, len(results["error"]), sharey=True)
    for panel, (name, rows) in zip(panels, results["error"].items(), strict=True):
        for rule in RULES:
            mine = [r for r in rows if r["rule"] == rule]
            panel.loglog([r["rays"] for r in mine], [r["angle_median_deg"] for r in mine], "o-", label=rule)
        default = next(r for r in rows if (r["rule"], r["n"]) == DEFAULT)
        panel.plot(default["rays"], default["angle_median_deg"], "*", ms=14, color="black", label="default", zorder=3)
        panel.set_title(name, fontsize=10)
        panel.set_xlabel("rays a candidate")
        panel.grid(True, which="both", alpha=0.3)
    panels[0].set_ylabel("median angle to the rest pose (deg)")
    panels[0].legend()
    path = Path(folder) / "settling_error.png"
    figure.savefig(path, dpi=120)
    return [path]
