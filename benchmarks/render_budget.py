"""`python -m hulldown.benchmarks.render_budget FOLDER`: AP50 for equal CPU seconds of rendering.

FOLDER is what `python -m hulldown.benchmarks.sensor_ablation FOLDER` has made. Each setting of samples, denoising, and
image size renders as many images of one plan as fit into a budget of CPU seconds; detectors learn from each with equal
draws and are tested as there. The largest budget is what the first 36 images take with 128 samples. CPU seconds are
those of one process with one thread without starting Blender; settings take turns. Finished work stays.
"""

from __future__ import annotations

import argparse
import json
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.benchmarks.sensor_ablation import SEEDS, judge
from hulldown.demo.like import renders_of
from hulldown.demo.study import write_side
from hulldown.planning.config.schema import Config
from hulldown.planning.loading import load_library
from hulldown.planning.plan_file import Plan, read_plan
from hulldown.planning.write import write_plan
from hulldown.render.jobs import render_assets, render_job
from hulldown.render.messages import Settings, StartJob, to_json
from hulldown.training.settings import load_settings
from hulldown.training.study.results import Judged, cell_interval, cells, difference, mean


@dataclass(frozen=True, slots=True)
class Setting:
    """How images are rendered; `scale` multiplies the sides of 256 x 144 pixels."""

    samples: int
    denoise: bool = True
    scale: float = 1.0


SETTINGS = {
    **{str(samples): Setting(samples) for samples in (4, 8, 16, 32, 128)},
    "8 noisy": Setting(8, denoise=False),
    "8 large": Setting(8, scale=1.5),
}
REFERENCE, IMAGES = "128", 36  # what the largest budget pays for
BUDGETS = (1 / 3, 2 / 3, 1.0)  # of the largest
TRAINING = {"model": "small", "budget": 6000, "resolution": 160}


def planned(folder: Path) -> Plan:
    """The plan that all settings render, written if it isn't there."""
    path = folder / "hour.jsonl"
    if not path.exists():
        side = replace(renders_of("large")["like"], name="hour", images_per_class=90, seed=11)
        config = Config.read(write_side(side, folder))
        write_plan(config, load_library(config).assets, path, workers=1, progress=lambda *done: None)
    return read_plan(path)


def render(plan: Plan, order: Sequence[int], out: Path) -> dict[str, list[float]]:
    """Render rows in an order until each setting has used the largest budget: CPU seconds of each image."""
    from hulldown.render.blender.renderer import Renderer

    assets, rows = render_assets(plan), list(plan)
    of = plan.config.render
    log = out / "costs.json"
    costs: dict[str, list[float]] = json.loads(log.read_text()) if log.exists() else {name: [] for name in SETTINGS}
    renderer = Renderer()
    renderer.do(to_json(StartJob("cpu", 0, 1)))
    for k, i in enumerate(order):
        full = len(costs[REFERENCE]) >= IMAGES
        budget = sum(costs[REFERENCE][:IMAGES]) if full else np.inf
        for name in np.roll(list(SETTINGS), -k).tolist():
            setting, paid = SETTINGS[name], costs[name]
            if len(paid) > k or sum(paid) >= budget:
                continue
            path = out / name / "images" / f"{i + 1:08d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            quality = Settings(setting.samples, setting.denoise, of.adaptive_threshold, of.bounces)
            job = render_job(rows[i], assets, quality, path)
            lens = job.camera.intrinsics
            size = int(lens.width * setting.scale), int(lens.height * setting.scale)
            started = time.process_time()
            renderer.do(to_json(replace(job, camera=replace(job.camera, intrinsics=lens.resized(*size)))))
            paid.append(time.process_time() - started)
        log.write_text(json.dumps(costs))
        if all(sum(paid) >= budget for paid in costs.values()):
            break
    return costs


def write_datasets(plan: Plan, order: Sequence[int], costs: dict[str, list[float]], out: Path) -> None:
    """A dataset for each setting and budget: the images that it pays for."""
    rows, largest = list(plan), sum(costs[REFERENCE][:IMAGES])
    classes = sorted({str(row.target.category) for row in rows})
    for name, setting in SETTINGS.items():
        sums = np.cumsum(costs[name])
        for part in BUDGETS:
            count = int((sums <= largest * part * 1.0001).sum())
            images: list[dict[str, Any]] = []
            annotations: list[dict[str, Any]] = []
            for i in order[:count]:
                row, number = rows[i], i + 1
                width, height = int(row.width * setting.scale), int(row.height * setting.scale)
                images.append({"id": number, "file_name": f"images/{number:08d}.png", "width": width, "height": height})
                assert row.target.bbox is not None
                box = [float(side) * setting.scale for side in row.target.bbox]
                annotations.append(
                    {"id": number, "image_id": number, "category_id": classes.index(str(row.target.category)) + 1,
                     "bbox": box, "area": box[2] * box[3], "iscrowd": 0}
                )  # fmt: skip
            folder = out / "data" / f"{name} {part:.2f}"
            folder.mkdir(parents=True, exist_ok=True)
            if not (folder / "images").exists():
                (folder / "images").symlink_to(out / name / "images")
            categories = [{"id": k + 1, "name": category} for k, category in enumerate(classes)]
            content = {"images": images, "annotations": annotations, "categories": categories}
            (folder / "annotations.json").write_text(json.dumps(content))
            print(name, f"{part:.2f}", count, "images", round(float(sums[count - 1])), "CPU s", flush=True)


def main() -> None:
    """Make and train what isn't there yet, and print AP50 for each test set, budget, and setting."""
    from hulldown.training.train import train

    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.render_budget", description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    out, plan = folder / "hour", planned(folder)
    order = list(range(len(plan)))
    random.Random(5).shuffle(order)
    if not (out / "data").exists():
        write_datasets(plan, order, render(plan, order, out), out)
    results: dict[str, list[Judged]] = {"others": [], "own": []}
    for seed in SEEDS:
        for part in BUDGETS[::-1]:
            for name in SETTINGS:
                arm = f"{name} {part:.2f}"
                run = out / "runs" / f"{arm} {seed}".replace(" ", "-")
                settings = load_settings(None, {**TRAINING, "seed": seed})
                train({"s": out / "data" / arm}, run, settings=settings, progress=lambda what, done, total: None)
                for test, runs in results.items():
                    runs.append(judge(run, folder / "sensor" / test, arm=arm, seed=seed))
                print(run.name, {test: round(runs[-1].values["ap50"], 3) for test, runs in results.items()}, flush=True)
    for test, runs in results.items():
        by_arm = {cell.arm: cell for cell in cells(runs)}
        for arm, cell in by_arm.items():
            low, high = cell_interval(cell, "ap50")
            gain = difference(by_arm[f"{REFERENCE} {arm[-4:]}"], cell, "ap50")
            text = "" if gain is None else f"{gain.value:+.3f} ({gain.ends[0]:+.3f} to {gain.ends[1]:+.3f})"
            print(f"{test} | {arm} | {mean(cell, 'ap50'):.3f} ({low:.3f} to {high:.3f}) | {text} |")


if __name__ == "__main__":
    main()
