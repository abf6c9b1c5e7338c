"""Weather: what each part of it costs of an image in CPU time, and how far it changes the picture."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from msgspec.structs import replace
from PIL import Image

from benchmarks.rendering import STEPPE, Talk, planned
from camera.weather import rain_visibility_m, wetness
from demo.project import create_project
from planning.weather import Weather
from render.jobs import render_job
from render.messages import Settings, to_json

SETTINGS = Settings(samples=16, denoise=False, adaptive_threshold=0.0, bounces=4)
CLEAR_AIR = 1e9  # metres of visibility


def _rain(rate: float, wet: float) -> Weather:
    return Weather(float(rain_visibility_m(rate)), "rain", rate, (2.0, 1.5), ground_cover=wet, vehicle_cover=wet)


WEATHERS = {
    "clear": None,
    "veil alone: fog of 500 m": Weather(500.0, "fog"),
    "rain of 10 mm/h, streaks and veil": _rain(10.0, 0.0),
    "rain of 10 mm/h": _rain(10.0, float(wetness(10.0))),
    "rain of 50 mm/h": _rain(50.0, float(wetness(50.0))),
    "snow of 500 m, flakes and veil": Weather(500.0, "snow", 0.0, (2.0, 1.5)),
    "snow of 500 m": Weather(500.0, "snow", 0.0, (2.0, 1.5), ground_cover=0.8, vehicle_cover=0.5),
    "dust of 300 m, veil": Weather(300.0, "dust", 0.0, (2.0, 1.5)),
    "dust of 300 m": Weather(300.0, "dust", 0.0, (2.0, 1.5), ground_cover=0.4, vehicle_cover=0.7),
}


def run(quick: bool) -> dict[str, Any]:
    """Render one planned image in each weather, in turn."""
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name)
        return measure(folder, create_project(folder, seed=0), quick)


def measure(folder: Path, config_path: Path, quick: bool) -> dict[str, Any]:
    """The same with assets that are there."""
    size, rounds = ((160, 90), 1) if quick else ((320, 180), 3)
    plan, assets = planned(folder, config_path, 1, size, scenery=STEPPE, one_of_a_class=True)
    rows = {name: replace(plan[0], weather=weather) for name, weather in WEATHERS.items()}
    talk = Talk(folder)
    process = psutil.Process(talk.worker.pid)
    seconds: dict[str, list[float]] = {name: [] for name in rows}
    for turn in range(rounds + 1):
        for number, (name, row) in enumerate(rows.items()):
            before = process.cpu_times()
            talk.ask(to_json(render_job(row, assets, SETTINGS, folder / f"{number}.png")))
            after = process.cpu_times()
            if turn:  # the first compiles and builds what later ones find
                seconds[name].append(after.user + after.system - before.user - before.system)
    talk.worker.stop()
    pictures = [_levels(folder / f"{number}.png") for number in range(len(rows))]
    changed = [float(np.abs(picture - pictures[0]).mean()) for picture in pictures]
    return {"size": size, "seconds": seconds, "changed": dict(zip(rows, changed, strict=True))}


def _levels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(np.float64)


def report(results: Mapping[str, Any]) -> str:
    """Markdown of the figures."""
    seconds, (width, height) = results["seconds"], results["size"]
    clear = float(np.median(seconds["clear"]))
    lines = [
        "## Weather",
        "",
        f"One image of the demo's steppe at {width} x {height}, {SETTINGS.samples} samples, not denoised, in each "
        f"weather in turn by one worker: median CPU time of {len(seconds['clear'])} rounds, with all preparation of "
        "the image, and grey levels of 255 that the picture differs from the clear one on average.",
        "",
        "| weather | CPU s | against clear | grey levels |",
        "|---|---:|---:|---:|",
    ]
    for name, measured in seconds.items():
        median = float(np.median(measured))
        lines.append(f"| {name} | {median:.1f} | {median / clear:.2f} | {results['changed'][name]:.0f} |")
    return "\n".join(lines)


def plots(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """None."""
    del results, folder
    return []
