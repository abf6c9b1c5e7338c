"""`python -m hulldown.benchmarks.sensor_ablation FOLDER`: which parts of the sensor help detectors.

FOLDER is what `python -m hulldown.demo.like FOLDER large` has made. The images of its `large-like` and `large-like-2`
are rendered once in linear light and developed for each arm: without a sensor, with a preset, and with preset "phone"
less one part. Detectors learn from these, some also without augmentation or with all of the paper's Table 1. They are
tested on `large-photographs`, stand-ins of other vehicles, scenery, and skies, and on `large-like-3`, other images of
the same ones, degraded in the same way. Finished trainings stay.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hulldown.camera.sensor import Sensor
from hulldown.dataset.exports.split import SPLITS
from hulldown.dataset.store.document import COCO_NAME
from hulldown.dataset.store.seals import PICTURE_KEY, RECORD_KEY
from hulldown.demo.study import photographed
from hulldown.planning.appearance.sensor import draw_sensors
from hulldown.planning.config.sensor_section import SensorSection
from hulldown.planning.plan_file import read_plan
from hulldown.planning.search.draws import RandomStreams
from hulldown.render.jobs import render_assets, render_job
from hulldown.render.messages import Settings, StartJob, to_json
from hulldown.training.augment import TABLE
from hulldown.training.evaluation.evaluate import Evaluation, Threshold
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.evaluation.predictions import read_predictions
from hulldown.training.settings import load_settings
from hulldown.training.study.manifest import PlannedRun
from hulldown.training.study.results import Judged, cell_interval, cells, difference, judged, mean

PARTS: dict[str, dict[str, Any]] = {
    "JPEG": {"jpeg_quality": 0},
    "noise": {"full_well_e": 0},
    "blur": {"blur_px": 0},
    "sharpening": {"sharpening": 0},
    "vignetting": {"vignetting_ev": 0},
    "aberration": {"aberration_px": 0},
}
ARMS: dict[str, dict[str, Any]] = {
    "none": {},
    "phone": {"preset": "phone"},
    "camera": {"preset": "camera"},
    **{f"phone without {part}": {"preset": "phone", **off} for part, off in PARTS.items()},
}
NAMES = ("large-like", "large-like-2")
AUGMENTATIONS: dict[str, dict[str, Any]] = {
    "augmentation off": {name: {"probability": 0.0} for name in TABLE},
    "Table 1": {name: {"probability": line.probability, **line.options} for name, line in TABLE.items()},
}
TRAINED = {  # name of a detector -> its arm and augmentation; nothing: the small model's own
    **{arm: (arm, {}) for arm in ARMS},
    **{f"{arm} {name}": (arm, lines) for name, lines in AUGMENTATIONS.items() for arm in ("none", "phone")},
}
SEEDS = (0, 1, 2)
SETTINGS = {"model": "small", "budget": 12000, "resolution": 160}


def develop_arms(folder: Path, out: Path) -> None:
    """Write a dataset for each arm and name, from one rendering in linear light."""
    from hulldown.render.blender import film
    from hulldown.render.blender.renderer import Renderer

    develop_file = film.develop_file
    renderer = Renderer()
    renderer.do(to_json(StartJob("cpu", 0, 1)))
    for name in NAMES:
        plan = read_plan(folder / f"{name}.jsonl")
        assets, rows = render_assets(plan), list(plan)
        config = plan.config
        of = config.render
        settings = Settings(of.samples, of.denoise, of.adaptive_threshold, of.bounces)
        sensors = {arm: sampled(values, rows=len(rows), seed=config.seed) for arm, values in ARMS.items()}
        for arm in ARMS:
            (out / name / arm / "images").mkdir(parents=True, exist_ok=True)

        def develop_all(
            linear: Path, output: Path, sensor: Any, camera: Any, *, seed: int, threads: int,
            name: str = name, sensors: Mapping[str, list[Sensor]] = sensors,
        ) -> None:  # fmt: skip
            for arm, of_rows in sensors.items():
                sensor = of_rows[int(output.stem) - 1]
                picture = (out / name / arm / "images" / output.stem).with_suffix(sensor.suffix)
                develop_file(linear, picture, sensor, camera, seed=seed, threads=threads)

        film.develop_file = develop_all
        for i, row in enumerate(rows):
            job = replace(render_job(row, assets, settings, out / f"{i + 1:08d}.png"), sensor=Sensor())
            renderer.do(to_json(job))
            print("rendered", name, i + 1, "of", len(rows), flush=True)
        coco = json.loads((folder / name / "annotations.json").read_text())
        for arm, of_rows in sensors.items():
            write_records(coco, out / name / arm / "annotations.json", of_rows[0].suffix)


def sampled(values: Mapping[str, Any], *, rows: int, seed: int) -> list[Sensor]:
    """The sensors of an arm's images."""
    sensors = draw_sensors(SensorSection(**values), draws=RandomStreams(seed), image=np.arange(rows))
    return [Sensor() if sensor is None else sensor for sensor in sensors]


def write_records(coco: Mapping[str, Any], path: Path, suffix: str) -> None:
    """Write a dataset's records for other pictures."""
    images = [
        {key: value for key, value in image.items() if key not in (PICTURE_KEY, RECORD_KEY)}
        | {"file_name": str(Path(image["file_name"]).with_suffix(suffix))}
        for image in coco["images"]
    ]
    path.write_text(json.dumps({**coco, "images": images}))


def write_tests(folder: Path, out: Path) -> None:
    """Write both test sets: all the stand-ins, and degraded pictures of the arms' own vehicles, scenery, and skies."""
    others, own = out / "others", out / "own"
    merged: dict[str, list[Any]] = {"images": [], "annotations": []}
    for split in SPLITS:
        shutil.copytree(folder / "large-photographs" / split, others, dirs_exist_ok=True)
        coco = json.loads((others / COCO_NAME).read_text())
        for key, records in merged.items():
            records += coco[key]
    for i, annotation in enumerate(merged["annotations"]):
        annotation["id"] = i + 1
    (others / COCO_NAME).write_text(json.dumps({**coco, **merged}))
    coco = json.loads((folder / "large-like-3/annotations.json").read_text())
    (own / "images").mkdir(parents=True, exist_ok=True)
    for image in coco["images"]:
        with Image.open(folder / "large-like-3" / image["file_name"]) as picture:
            taken = photographed(np.asarray(picture.convert("RGB")), rng=np.random.default_rng([7, image["id"]]))
        (own / image["file_name"]).with_suffix(".jpg").write_bytes(taken)
    write_records(coco, own / "annotations.json", ".jpg")


def judge(run: Path, test: Path, *, arm: str, seed: int) -> Judged:
    """A detector's figures on a test set."""
    from hulldown.training.predict import predict

    path = run / f"{test.name}.json"
    if not path.exists():
        predict(run, test, path, progress=lambda done, total: None)
    labels = read_labels(test)
    about = PlannedRun(
        name=run.name, folder=run.name, arm=arm, base="synthetic", fraction=None, seed=seed, photographs=0,
        sources=(arm,), drawn={}, settings=load_settings(None, SETTINGS),
    )  # fmt: skip
    return judged(about, Evaluation(labels, read_predictions(path, labels), threshold=Threshold(0.5, "given"), iou=0.5))


def table(results: Sequence[Judged]) -> Iterator[str]:
    """Lines of a Markdown table: AP50 of each arm, and its difference from the arm that it's a change of."""
    by_arm = {cell.arm: cell for cell in cells(results)}
    for arm, cell in by_arm.items():
        low, high = cell_interval(cell, "ap50")
        text = f"| {arm} | {mean(cell, 'ap50'):.3f} ({low:.3f} to {high:.3f}) | "
        base = by_arm.get(f"none{arm.removeprefix('phone')}", by_arm["phone" if arm.startswith("phone ") else "none"])
        if base is not None and base is not cell and (gain := difference(base, cell, "ap50")) is not None:
            text += f"{gain.value:+.3f} ({gain.ends[0]:+.3f} to {gain.ends[1]:+.3f}) |"
        yield text


def main() -> None:
    """Make and train what isn't there yet, and print a table of each test set after each arm."""
    from hulldown.training.train import train

    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.sensor_ablation", description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    out = folder / "sensor"
    if not (out / "own" / "annotations.json").exists():
        develop_arms(folder, out)
        write_tests(folder, out)
    results: dict[str, list[Judged]] = {"others": [], "own": []}
    for seed in SEEDS:
        for name, (arm, augmentation) in TRAINED.items():
            run = out / "runs" / f"{name} {seed}".replace(" ", "-")
            settings = load_settings(None, {**SETTINGS, "seed": seed, "augmentation": augmentation})
            train({of: out / of / arm for of in NAMES}, run, settings=settings, progress=lambda what, done, total: None)
            for test, judged_runs in results.items():
                judged_runs.append(judge(run, out / test, arm=name, seed=seed))
            print(run.name, {test: round(runs[-1].values["ap50"], 3) for test, runs in results.items()}, flush=True)
    for test, runs in results.items():
        print("\n".join([f"{test}:", *table(runs)]), flush=True)


if __name__ == "__main__":
    main()
