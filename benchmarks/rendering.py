"""Rendering: CPU seconds of an image by phases, beside Cycles alone.

On the CPU, on the demo assets.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from msgspec.structs import replace as altered

from hulldown.benchmarks.tables import table
from hulldown.dataset.row_records import Segmenter
from hulldown.demo.project import create_project
from hulldown.plan.config.scene_sections import RENDER_PROFILES
from hulldown.plan.config.schema import Config
from hulldown.plan.library import Library, load_library, load_planned_library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import Row
from hulldown.planning.write import write_plan
from hulldown.render.blender.messages import CyclesSettings, RenderJob
from hulldown.render.jobs import make_render_job
from hulldown.render.outline import row_sort_key
from hulldown.render.process import Allowance, Blender, Limits

SIZES = ((320, 180), (640, 360))
PHASES = {
    "load": "loading and posing",
    "sync": "syncing, BVH, sky map",
    "sample": "sampling and denoising",
    "save": "saving",
    "labels": "labels with masks",
}


def run(quick: bool) -> dict:
    """Measure images that follow each other in `render`; each job is done again: Cycles alone."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = create_project(folder, seed=0)
        given = Config.read(path).model_dump(mode="json")
        given["budget"]["images_per_class"] = 30
        config = Config.of(given, path=path)
        plan = write_plan(config, load_library(config).assets, folder / "plan.jsonl")
        library = load_planned_library(plan)
        rows = [row for row in sorted(plan, key=row_sort_key) if row.labeled]
        rows = rows[len(rows) // 2 :][: 3 if quick else 6]
        return {
            "settings": RENDER_PROFILES["train"],
            "sizes": [
                {"size": size, **_measure_size([_resized(row, size) for row in rows], plan, library, folder)} for size in SIZES
            ],
        }


def _resized(row: Row, size: tuple[int, int]) -> Row:
    boxes = [v.bbox and type(v.bbox)(*(size[0] / row.width * np.array(v.bbox)).tolist()) for v in row.planned]
    planned_vehicles = [altered(v, bbox=box) for v, box in zip(row.planned, boxes, strict=True)]
    return altered(row, width=size[0], height=size[1], planned=type(row.planned)(planned_vehicles))


def _measure_size(rows: list[Row], plan: Plan, library: Library, folder: Path) -> dict[str, Any]:
    segmenter, images = Segmenter.of_plan(plan, library), []
    with make_blender(folder) as blender:
        blender.start_process()
        start = _cpu_seconds(blender)
        for row in rows:
            job = make_job(row, library, RENDER_PROFILES["train"], folder / "image.png")
            began = time.process_time()
            segmenter.label_records_with_masks(row)
            labels, before = time.process_time() - began, _cpu_seconds(blender)
            parts = blender.do(job).seconds
            after = _cpu_seconds(blender)
            assert blender.do(job).content
            alone = _cpu_seconds(blender) - after
            images.append({**parts, "labels": labels, "render": after - before + labels, "alone": alone})
    return {"start": start, "images": images}


def _cpu_seconds(blender: Blender) -> float:
    times = psutil.Process(blender.process_id).cpu_times()
    return times.user + times.system


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


def make_job(row: Row, library: Library, settings: dict[str, Any], output: Path) -> RenderJob:
    """Return the job of rendering a row with these settings."""
    return make_render_job(row, library, CyclesSettings(**settings), output)


def make_blender(folder: Path) -> Blender:
    """Return a Blender on the CPU that may take any time."""
    return Blender(folder / "log", device="cpu", allowance=Allowance(Limits(job_s=math.inf)))


def report(results: dict) -> str:
    """Return a Markdown section."""
    sizes, settings = results["sizes"], results["settings"]
    keys = (*PHASES, "render", "alone")
    means = [{key: float(np.mean([image[key] for image in one["images"][1:]])) for key in keys} for one in sizes]
    titles = {**PHASES, "render": "**`render`**, all of it", "alone": "Cycles alone: the same job again, nothing changed"}
    rows = [(titles[key], *(f"{mean[key]:.2f}" for mean in means)) for key in keys]
    rows.append(("`render` / Cycles alone", *(f"**{mean['render'] / mean['alone']:.2f}**" for mean in means)))
    rows.append(("without labels", *(f"{(m['render'] - m['labels']) / m['alone']:.2f}" for m in means)))
    rows.append(("once: starting Blender", *(f"{one['start']:.2f}" for one in sizes)))
    fixed = [one["images"][0]["render"] - one["images"][0]["alone"] for one in sizes]
    rows.append(("once a scenery: the first image, beyond Cycles alone", *(f"{seconds:.2f}" for seconds in fixed)))
    return "\n\n".join([
        "## Rendering",
        f"CPU seconds an image: {len(sizes[0]['images']) - 1} images that follow each other with `init`'s config, "
        f"profile `train` ({settings['samples']} samples, denoised, adaptive), on the CPU.",
        table(["", *("{} x {}".format(*one["size"]) for one in sizes)], rows),
    ])  # fmt: skip


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw nothing."""
    return []
