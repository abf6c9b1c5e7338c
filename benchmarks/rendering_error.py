"""Samples, denoising, adaptive sampling and bounces: seconds against error, held against many samples."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from msgspec.structs import replace as altered
from PIL import Image

from hulldown.benchmarks.rendering import make_blender, make_job, planned
from hulldown.benchmarks.tables import table
from hulldown.demo.project import create_project
from hulldown.plan.library import Library
from hulldown.plan.row import Row
from hulldown.render.blender.messages import RenderJob

PAPER = {"samples": 128, "denoise": True, "adaptive_threshold": 0.0, "bounces": 12}
FAST = {"samples": 32, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4}
SAMPLES = (8, 16, 32, 64, 128, 256)
ADAPTIVE = (0.01, 0.03, 0.05, 0.1)
BOUNCES = (0, 1, 2, 4)
VARIANTS = {
    **{f"{n} samples": {**PAPER, "samples": n, "denoise": False} for n in SAMPLES},
    **{f"{n} samples, denoised": {**PAPER, "samples": n} for n in SAMPLES},
    **{f"128 samples, denoised, threshold {t}": {**PAPER, "adaptive_threshold": t} for t in ADAPTIVE},
    **{f"128 samples, denoised, {n} bounces": {**PAPER, "bounces": n} for n in BOUNCES},
    "profile fast": FAST,
}
DEFAULT = "128 samples, denoised"
# Variants that only the plot shows.
PLOTTED = ("16 ", "64 ", "256 ", *(f"{DEFAULT}, {end}" for end in ("threshold 0.03", "threshold 0.1", "1 b", "2 b")))

Ask = Callable[[RenderJob], Mapping[str, Any]]


def run(quick: bool) -> dict:
    """Measure three pictures of the demo, one on open ground."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config_path = create_project(folder, seed=0)
        size = (64, 36) if quick else (128, 72)
        near = {"target_fraction": [0.3, 0.5]}
        # Behind leaves, which let light through: what bounces, and transparency, matter most for.
        hidden = {**near, "visible_fraction": [0.4, 0.85]}
        pictures = []
        for where, scenery, camera in (("open ground", "dry_steppe", near), ("wood", "temperate_hills", hidden)):
            plan, library = planned(folder, config_path, 1, size, scenery=scenery, one_of_a_class=True, camera=camera)
            pictures += [(f"{where} {i + 1}", plan[i], library) for i in range(1 if quick or camera is near else 2)]
        with make_blender(folder) as blender:
            return measure(pictures, lambda job: blender.do(job).seconds, folder, reference_samples=256 if quick else 4096)


def measure(pictures: list[tuple[str, Row, Library]], ask: Ask, folder: Path, *, reference_samples: int) -> dict[str, Any]:
    """Measure each variant of each picture, in another order for each: no disturbance falls on one variant alone."""
    rng = np.random.default_rng(0)
    found: dict[str, dict[str, dict[str, float]]] = {}

    def picture(row: Row, library: Library, settings: dict[str, Any]) -> tuple[np.ndarray, float]:
        seconds = ask(make_job(row, library, settings, folder / "e.png"))
        with Image.open(folder / "e.png") as image:
            return np.asarray(image, dtype=np.float64), seconds["sample"]

    for where, row, library in pictures:
        truth, _ = picture(row, library, {**PAPER, "samples": reference_samples, "denoise": False})
        x, y, w, h = row.target.bbox
        box = np.s_[int(y) : int(np.ceil(y + h)), int(x) : int(np.ceil(x + w))]
        points = {}
        for name in rng.permutation(list(VARIANTS)):
            seen, seconds = picture(altered(row, sample_seed=7), library, VARIANTS[str(name)])
            points[str(name)] = {
                "seconds": seconds, "frame": _rmse(seen, truth), "box": _rmse(seen[box], truth[box])
            }  # fmt: skip
        found[where] = {name: points[name] for name in VARIANTS}
    size = [pictures[0][1].width, pictures[0][1].height]
    return {"size": size, "reference_samples": reference_samples, "pictures": found}


def _rmse(seen: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((seen - truth) ** 2)))


def means(results: dict) -> dict[str, dict[str, float]]:
    """Of each variant, over the pictures."""
    pictures = results["pictures"].values()
    return {
        name: {key: float(np.mean([p[name][key] for p in pictures])) for key in ("seconds", "frame", "box")}
        for name in next(iter(pictures))
    }


def report(results: dict) -> str:
    """Return a Markdown section."""
    pictures = results["pictures"]
    rows = [
        (name, f"{mean['seconds']:.2f}", f"{mean['box']:.2f}", f"{mean['frame']:.2f}")
        for name, mean in means(results).items()
        if not name.startswith(PLOTTED)
    ]
    return "\n\n".join([
        "### Samples against error",
        f"{len(pictures)} pictures at {results['size'][0]} x {results['size'][1]}: {', '.join(pictures)}. RMS "
        f"difference from {results['reference_samples']} samples and 12 bounces, in 8-bit steps, over the target's "
        "box and over the frame; mean seconds to sample and denoise. The plot has more settings.",
        table(["settings", "s", "box", "frame"], rows),
    ])  # fmt: skip


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw error against time."""
    path = folder / "rendering_error.png"
    variants = means(results)
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    families = {
        "plain samples": [f"{n} samples" for n in SAMPLES],
        "denoised": [f"{n} samples, denoised" for n in SAMPLES],
        "128, adaptive": [f"128 samples, denoised, threshold {t}" for t in ADAPTIVE],
        "128, fewer bounces": [f"128 samples, denoised, {n} bounces" for n in BOUNCES],
    }
    for ax, key in zip(axes, ("box", "frame"), strict=True):
        for label, names in families.items():
            ax.plot([variants[n]["seconds"] for n in names], [variants[n][key] for n in names], "o-", label=label)
        for label, name, marker in (("paper (default)", DEFAULT, "k*"), ("fast", "profile fast", "kP")):
            ax.plot(variants[name]["seconds"], variants[name][key], marker, markersize=13, label=label)
        ax.set(xscale="log", yscale="log", xlabel="seconds an image", title=f"error in the {key}")
    axes[0].set_ylabel("RMS difference, 8-bit steps")
    axes[0].legend()
    figure.savefig(path, dpi=120)
    return [path]
