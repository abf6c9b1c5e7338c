"""`python -m hulldown.benchmarks.like FOLDER SET`: whether renders that follow photographs make better detectors.

The photographs are stand-ins as in `benchmarks.stand_ins`, seen by cameras unlike the default one. Detectors learn
from equal numbers of renders and draws: with the default camera (`default`) and with `camera.like` (`like`, and `again`
with other seeds).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hulldown.base.files import replace_file
from hulldown.benchmarks.stand_ins import SHARED, STAND_INS, SYNTHETIC, Side, make_side, write_stand_ins
from hulldown.demo.make_assets import build_demo_assets
from hulldown.plan.config.scene_sections import CameraSection
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.inputs.settings import load_settings
from hulldown.training.study.results import Cell, Judged, estimate_measure, evaluate_run, group_runs_into_cells
from hulldown.training.study.study_folder import StudyRun

# Cameras of the stand-ins. The default one is at 3 to 35 degrees, and half of its targets fill less than 0.13 of the
# image's height. Stand-ins as small as those have no class that this detector could see.
SETS: dict[str, dict[str, Any]] = {
    "large": {
        "camera.target_fraction": [0.4, 0.8],
        "camera.elevation_deg": [3.0, 8.0],
        "camera.fov_x_deg": [45.0, 60.0],
        "camera.framing": 1.0,
    },
    "high": {
        "camera.target_fraction": [0.2, 0.35],
        "camera.elevation_deg": [25.0, 35.0],
        "camera.fov_x_deg": [25.0, 40.0],
        "camera.framing": 1.0,
    },
}
SHARES = (0.2, 0.3, 0.5)  # of the stand-ins: for camera.like, for thresholds, to test on
STAND_INS_PER_CLASS, RENDERS_PER_CLASS = 60, 40
DEFAULT = {key: CameraSection.model_fields[key.removeprefix("camera.")].default for key in SHARED if key.startswith("camera.")}
ARMS = {  # `again` differs from `like` in the seed of half of its images: how much the choice of images matters
    "default": ("default", "default-2"),
    "like": ("like", "like-2"),
    "again": ("like", "like-3"),
}
SEEDS = (0, 1, 2)
MEASURES = ("ap50", "f1")
SETTINGS = {"model": "small", "budget": 2400, "resolution": 160}


def read_stand_ins(name: str) -> Side:
    """Return what the stand-ins of a set are rendered from."""
    values = {**SETS[name], "budget.images_per_position": 1}
    return replace(STAND_INS, name=f"{name}-stand-ins", images_per_class=STAND_INS_PER_CLASS, values=values)


def read_renders(name: str) -> dict[str, Side]:
    """Return the halves of the arms' training images, by their names in `ARMS`."""
    like = {"camera.like": f"{name}-photographs/train"}
    values = {**DEFAULT, "budget.images_per_position": 1}
    half = replace(SYNTHETIC, images_per_class=RENDERS_PER_CLASS // 2, values=values)
    return {
        "default": replace(half, name="default"),
        "default-2": replace(half, name="default-2", seed=1),
        "like": replace(half, name=f"{name}-like", values={**values, **like}),
        "like-2": replace(half, name=f"{name}-like-2", seed=1, values={**values, **like}),
        "like-3": replace(half, name=f"{name}-like-3", seed=2, values={**values, **like}),
    }


def detector(run: Path, data: Sequence[Path], seed: int) -> Path:
    """Train a detector on some datasets, unless it's finished; return its folder."""
    from hulldown.training.train import train_detector

    settings = load_settings(None, {**SETTINGS, "seed": seed})
    train_detector({path.name: path for path in data}, run, settings=settings, progress=lambda what, done, total: None)
    return run


def found(run: Path, photographs: Path) -> Path:
    """Detect in photographs, unless it's done; return the file of detections."""
    from hulldown.training.predict import predict_detections

    path = run / f"{photographs.parent.name}-{photographs.name}.json"
    if not path.exists():
        predict_detections(run, photographs, path, progress=lambda done, total: None)
    return path


def judged(run: Path, photographs: Path, *, arm: str, seed: int) -> Judged:
    """A detector's figures on the test photographs, at the threshold that is best on the validation photographs."""
    splits = {name: photographs / name for name in ("test", "valid")}
    labels = {name: read_labels(folder) for name, folder in splits.items()}
    about = StudyRun(arm, "synthetic", None, seed, load_settings(None, SETTINGS))
    return evaluate_run(about, labels, {name: found(run, folder) for name, folder in splits.items()}, photographs=0)


def table(arms: Mapping[str, Cell]) -> tuple[list[str], dict[str, Any]]:
    """Lines of a Markdown table, and its numbers: figures of each arm, and their differences from `like`."""
    lines, numbers = ["| arm | AP50 | F1 | AP50 minus `like` | F1 minus `like` |", "|---|---|---|---|---|"], {}
    for name, cell in arms.items():
        figures = {key: estimate_measure(cell, key) for key in MEASURES}
        gains = {} if name == "like" else {key: estimate_measure(cell, key, minus=arms["like"]) for key in MEASURES}
        own, gained = ({key: [one.value, *one.ends.tolist()] for key, one in found.items()} for found in (figures, gains))
        of_seeds = {key: [one.values[key] for one in cell.judged.values()] for key in MEASURES}
        numbers[name] = {"figures": own, "minus_like": gained, "of_seeds": of_seeds}
        shown = ["{:.3f} ({:.3f} to {:.3f})".format(*one) for one in own.values()]
        shown += ["{:+.3f} ({:+.3f} to {:+.3f})".format(*one) for one in gained.values()] or ["", ""]
        lines.append(f"| `{name}` | {' | '.join(shown)} |")
    return lines, numbers


def main() -> None:
    """Make, train, and judge what is missing, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.like", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("set", choices=SETS)
    arguments = parser.parse_args()
    folder, name = arguments.folder, arguments.set
    build_demo_assets(folder)
    photographs, runs = folder / f"{name}-photographs", folder / "runs"
    if not photographs.exists():
        write_stand_ins(make_side(read_stand_ins(name), folder), photographs, SHARES)
    data = {key: make_side(side, folder) for key, side in read_renders(name).items()}
    results = []
    for seed in SEEDS:
        for arm, parts in ARMS.items():
            run = runs / (f"{name}-{arm}-{seed}" if arm != "default" else f"{arm}-{seed}")
            detector(run, [data[part] for part in parts], seed)
            results.append(judged(run, photographs, arm=arm, seed=seed))
            print(run.name, {key: round(results[-1].values[key], 3) for key in MEASURES}, flush=True)
    lines, numbers = table({cell.arm: cell for cell in group_runs_into_cells(results)})
    replace_file(folder / f"{name}.json", json.dumps(numbers, indent=2).encode() + b"\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
