"""Rendering: the time of an image besides Cycles' sampling, and error against samples.

All on the CPU, on the demo assets.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.benchmarks import rendering_error
from hulldown.benchmarks.rendering_error import FAST, PAPER
from hulldown.benchmarks.tables import table
from hulldown.demo.project import create_project
from hulldown.plan.config.schema import Config
from hulldown.plan.library import Library, load_library, load_planned_library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import Row
from hulldown.planning.write import write_plan
from hulldown.render.blender.messages import CyclesSettings, RenderJob
from hulldown.render.jobs import render_job
from hulldown.render.outline import sort_key
from hulldown.render.process import Allowance, Blender, Limits

FEW_SAMPLES = 4  # samples of the pictures whose sampling is not what is measured
MORE_SAMPLES = 32  # samples that, beside few, tell what one more sample takes
STEPPE, HILLS = "dry_steppe", "temperate_hills"


def run(quick: bool) -> dict:
    """Measure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config_path = create_project(folder, seed=0)
        return {
            "loading": _loading(folder, config_path, quick),
            "large": _large(folder, config_path, quick),
            "error": _error(folder, config_path, quick),
        }


def planned(
    folder: Path,
    config_path: Path,
    per_class: int,
    size: tuple[int, int],
    *,
    scenery: str | None = None,
    one_of_a_class: bool = False,
    **sections: dict,
) -> tuple[Plan, Library]:
    """A plan for the demo assets, or one scenery and three vehicles of them, and its library."""
    given = Config.read(config_path).model_dump(mode="json")
    if one_of_a_class:
        given["assets"]["vehicles"] = list({v["category"]: v for v in given["assets"]["vehicles"]}.values())
    if scenery is not None:
        given["assets"]["sceneries"] = [s for s in given["assets"]["sceneries"] if scenery in s["path"]]
        given["assets"]["distractors"] = []  # some occur in one scenery only
    given["budget"] = {"images_per_class": per_class, "images_per_position": 2}
    given["render"] |= {"width": size[0], "height": size[1]}
    for section, values in sections.items():
        given[section] |= values
    config = Config.of(given, path=config_path)
    plan = write_plan(config, load_library(config).assets, folder / f"{scenery or 'all'}-{per_class}-{size[0]}.jsonl")
    return plan, load_planned_library(plan)


def _job(row: Row, library: Library, settings: dict[str, Any], output: Path) -> RenderJob:
    return render_job(row, library, CyclesSettings(**settings), output)


def _in_order(plan: Plan) -> list[Row]:
    """As the supervisor sorts them."""
    return sorted(plan, key=sort_key)


def _overhead(parts: dict[str, float]) -> float:
    return parts["load"] + parts["sync"] + parts["save"]


def _blender(folder: Path) -> Blender:
    return Blender(folder / "log", device="cpu", allowance=Allowance(Limits(job_s=math.inf)))


def _loading(folder: Path, config_path: Path, quick: bool) -> dict:
    """Measure twelve images of three vehicles; in a larger dataset a vehicle has many more that follow each other."""
    size = (160, 90) if quick else (480, 270)
    plan, library = planned(folder, config_path, 4, size, one_of_a_class=True)
    settings = {**FAST, "samples": FEW_SAMPLES} if quick else FAST
    jobs = [_job(row, library, settings, folder / f"{i}.png") for i, row in enumerate(_in_order(plan))]
    with _blender(folder) as blender:
        start = time.perf_counter()
        blender.start_process()
        started = time.perf_counter() - start
        start = time.perf_counter()
        parts = [blender.do(job).seconds for job in jobs]
        ours = time.perf_counter() - start
    overhead = [_overhead(p) for p in parts]
    return {
        "size": size,
        "settings": settings,
        "images": len(jobs),
        "start_s": started,
        "parts": parts,
        "first_overhead_s": overhead[0],
        "steady_overhead_s": float(np.median(overhead[1:])),
        "ours_s": ours,
    }


def _large(folder: Path, config_path: Path, quick: bool) -> dict:
    """Return the time of 1080p images outside sampling, and that of the paper's 128 samples.

    In the scenery that samples faster, which makes the share larger. On a CPU 128 samples take a quarter of an hour, so
    they are reckoned from few and more samples of one picture.
    """
    size = (192, 108) if quick else (1920, 1080)
    plan, library = planned(folder, config_path, 4, size, scenery=STEPPE, one_of_a_class=True)
    rows = _in_order(plan)[:4]
    with _blender(folder) as blender:
        parts = [
            blender.do(_job(row, library, {**PAPER, "samples": samples}, folder / "l.png")).seconds
            for row, samples in zip(
                [*rows, rows[-1]], (FEW_SAMPLES, FEW_SAMPLES, FEW_SAMPLES, FEW_SAMPLES, MORE_SAMPLES), strict=True
            )
        ]
    overhead = float(np.median([_overhead(p) for p in parts[1:]]))
    few, more = parts[-2]["sample"], parts[-1]["sample"]
    sampling = few + (PAPER["samples"] - FEW_SAMPLES) * (more - few) / (MORE_SAMPLES - FEW_SAMPLES)
    return {
        "size": size,
        "samples": PAPER["samples"],
        "parts": parts,
        "overhead_s": overhead,
        "sample_s": sampling,
        "share": overhead / (overhead + sampling),
    }


def _error(folder: Path, config_path: Path, quick: bool) -> dict:
    size = (64, 36) if quick else (128, 72)
    near = {"target_fraction": [0.3, 0.5]}
    # Behind leaves, which let light through: what bounces, and transparency, matter most for.
    hidden = {**near, "visible_fraction": [0.4, 0.85]}
    open_plan, open_library = planned(folder, config_path, 1, size, scenery=STEPPE, one_of_a_class=True, camera=near)
    wood_plan, wood_library = planned(folder, config_path, 1, size, scenery=HILLS, one_of_a_class=True, camera=hidden)
    pictures = [("open ground", open_plan[0], open_library)]
    pictures += [(f"wood {i + 1}", wood_plan[i], wood_library) for i in range(1 if quick else 2)]
    with _blender(folder) as blender:
        return rendering_error.measure(
            pictures, lambda job: blender.do(job).seconds, folder, reference_samples=256 if quick else 4096
        )


def report(results: dict) -> str:
    """Return a Markdown section."""
    loading, large = results["loading"], results["large"]
    parts = loading["parts"][1:]
    steady = {key: float(np.median([p[key] for p in parts])) for key in ("load", "sync", "sample", "save")}
    width, height = loading["size"]
    rows = [
        ("loading and posing, steady state", f"{steady['load']:.3f}"),
        ("syncing, BVH, sky map", f"{steady['sync']:.3f}"),
        ("saving", f"{steady['save']:.3f}"),
        ("sum outside sampling, steady state", f"{loading['steady_overhead_s']:.3f}"),
        ("first image", f"{loading['first_overhead_s']:.3f}"),
        ("sampling and denoising", f"{steady['sample']:.3f}"),
    ]
    return "\n\n".join([
        "## Rendering",
        f"{loading['images']} images of the demo at {width} x {height}, {loading['settings']['samples']} samples, "
        "denoised, adaptive, on the CPU: three vehicles in two sceneries. Starting Blender takes "
        f"{loading['start_s']:.1f} s once.",
        table(["", "s an image"], rows),
        f"At {large['size'][0]} x {large['size'][1]} the sum outside sampling is {large['overhead_s']:.2f} s (median "
        f"of {len(large['parts']) - 1} images in steady state), and {large['samples']} samples, denoised, take "
        f"{large['sample_s']:.0f} s (extrapolated from {FEW_SAMPLES} and {MORE_SAMPLES} samples of one picture): "
        f"**{large['share']:.1%}** of the image's time is not sampling.",
        rendering_error.report(results["error"]),
    ])  # fmt: skip


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw error against time."""
    return [rendering_error.plot(results["error"], folder / "rendering_error.png")]
