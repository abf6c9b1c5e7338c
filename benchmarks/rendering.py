"""Rendering: what an image costs beside Cycles' sampling, what keeping things loaded saves, samples against error.

All on the CPU, on the demo assets.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from planning.config import load_config, parse_config
from planning.plan_file import Plan
from planning.write import write_plan
from render.demo.project import create_project
from render.jobs import RenderAssets, job, render_assets
from render.process import WorkerProcess, worker_command
from render.reading.cache import load_assets
from render.session import sort_key

PLAIN = Path(__file__).with_name("plain_rendering.py")
PAPER = {"samples": 128, "denoise": True, "adaptive_threshold": 0.0, "bounces": 12}
SAMPLES = (8, 16, 32, 64, 128, 256)
ADAPTIVE = (0.01, 0.03, 0.05, 0.1)
BOUNCES = (1, 2, 4, 8)


class Talk:
    """A worker that is asked one thing after the other."""

    def __init__(self, folder: Path) -> None:
        self.answers: queue.SimpleQueue[dict | None] = queue.SimpleQueue()
        self.worker = WorkerProcess(worker_command(None), folder / "log", lambda _, a: self.answers.put(a))
        self.answers.get()
        self.ask({"do": "start", "device": "cpu", "index": 0, "threads": 0})

    def ask(self, message: dict) -> dict:
        self.worker.send(message)
        answer = self.answers.get()
        assert answer is not None, "the worker has died"
        assert "failed" not in answer, answer
        return answer


def run(quick: bool) -> dict:
    """Measure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config_path = create_project(folder, seed=0)
        return {
            "loading": _loading(folder, config_path, quick),
            "memory": _memory(folder, config_path, quick),
            "error": _error(folder, config_path, quick),
        }


def planned(
    folder: Path,
    config_path: Path,
    per_class: int,
    size: tuple[int, int],
    *,
    one_of_a_class: bool = False,
    **sections: dict,
) -> tuple[Plan, RenderAssets]:
    given = load_config(config_path).model_dump(mode="json")
    if one_of_a_class:
        given["assets"]["vehicles"] = list({v["category"]: v for v in given["assets"]["vehicles"]}.values())
    given["budget"] = {"images_per_class": per_class, "images_per_position": 2}
    given["render"] |= {"width": size[0], "height": size[1]}
    for section, values in sections.items():
        given[section] |= values
    config = parse_config(given, path=config_path)
    plan = write_plan(config, load_assets(config), folder / f"{per_class}-{size[0]}.jsonl")
    return plan, render_assets(plan)


def _in_order(plan: Plan) -> list[dict[str, Any]]:
    """As the supervisor sorts them."""
    return sorted(plan, key=sort_key)


def _loading(folder: Path, config_path: Path, quick: bool) -> dict:
    """Twelve images our way and the plain way: the same rows, settings and process count.

    Three vehicles with four images each: in a dataset of some size a vehicle has many more that follow each other.
    """
    size = (160, 90) if quick else (480, 270)
    plan, assets = planned(folder, config_path, 4, size, one_of_a_class=True)
    settings = {**PAPER, "samples": 4 if quick else 32}
    jobs = [job(row, assets, settings, folder / f"{i}.png") for i, row in enumerate(_in_order(plan))]
    start = time.perf_counter()
    talk = Talk(folder)
    started = time.perf_counter() - start
    start = time.perf_counter()
    parts = [talk.ask(message)["seconds"] for message in jobs]
    ours = time.perf_counter() - start
    talk.worker.stop()
    ran = subprocess.run(
        [sys.executable, "-P", str(PLAIN)], input=json.dumps(jobs), capture_output=True, text=True, check=True
    )
    plain = json.loads(ran.stdout)
    overhead = [p["load"] + p["sync"] + p["save"] for p in parts]
    return {
        "size": size,
        "samples": settings["samples"],
        "images": len(jobs),
        "start_s": started,
        "parts": parts,
        "first_overhead_s": overhead[0],
        "steady_overhead_s": float(np.median(overhead[1:])),
        "steady_sample_s": float(np.median([p["sample"] for p in parts[1:]])),
        "ours_s": ours,
        "plain_s": sum(plain),
        "plain_overhead_s": float(np.median(plain) - np.median([p["sample"] for p in parts])),
    }


def _memory(folder: Path, config_path: Path, quick: bool) -> dict:
    """Resident memory of one worker after each of many small images; each scenery is loaded once."""
    plan, assets = planned(folder, config_path, 12 if quick else 100, (64, 36))
    settings = {**PAPER, "samples": 1}
    talk = Talk(folder)
    held: dict[str, list[float]] = {}
    for row in _in_order(plan):
        talk.ask(job(row, assets, settings, folder / "m.png"))
        held.setdefault(row["scenery"], []).append(talk.worker.memory / 2**20)
    talk.worker.stop()
    # Sceneries differ in size; what a leak does shows between two images of one.
    start = 6 if quick else 20
    return {
        "megabytes": held,
        "from": start,
        "growth": {name: found[-1] / found[start - 1] - 1.0 for name, found in held.items() if len(found) > start},
    }


def _error(folder: Path, config_path: Path, quick: bool) -> dict:
    size, reference_samples = ((96, 54), 256) if quick else ((240, 135), 4096)
    plan, assets = planned(folder, config_path, 1, size, camera={"target_fraction": [0.3, 0.5]})
    rows = _in_order(plan)[:: 2 if quick else 1]
    talk = Talk(folder)
    points: dict[str, list[dict]] = {}

    def picture(row: dict, settings: dict) -> tuple[np.ndarray, float]:
        answer = talk.ask(job(row, assets, settings, folder / "e.png"))
        with Image.open(folder / "e.png") as image:
            return np.asarray(image, dtype=np.float64), answer["seconds"]["sample"]

    variants = {f"{n} samples": {**PAPER, "samples": n, "denoise": False} for n in SAMPLES}
    variants |= {f"{n} samples, denoised": {**PAPER, "samples": n} for n in SAMPLES}
    variants |= {f"128 samples, denoised, threshold {t}": {**PAPER, "adaptive_threshold": t} for t in ADAPTIVE}
    variants |= {f"128 samples, denoised, {n} bounces": {**PAPER, "bounces": n} for n in BOUNCES}
    for row in rows:
        truth, _ = picture(row, {**PAPER, "samples": reference_samples, "denoise": False})
        x, y, w, h = row["bbox"]
        box = np.s_[int(y) : int(np.ceil(y + h)), int(x) : int(np.ceil(x + w))]
        for name, settings in variants.items():
            seen, seconds = picture({**row, "sample_seed": 7}, settings)
            points.setdefault(name, []).append(
                {"seconds": seconds, "frame": _rmse(seen, truth), "box": _rmse(seen[box], truth[box])}
            )
    talk.worker.stop()
    return {
        "size": size,
        "reference_samples": reference_samples,
        "images": len(rows),
        "variants": {
            name: {key: float(np.mean([p[key] for p in found])) for key in ("seconds", "frame", "box")}
            for name, found in points.items()
        },
    }


def _rmse(seen: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((seen - truth) ** 2)))


def report(results: dict) -> str:
    """A Markdown section."""
    loading, memory, error = results["loading"], results["memory"], results["error"]
    parts = loading["parts"][1:]
    steady = {key: float(np.median([p[key] for p in parts])) for key in ("load", "sync", "sample", "save")}
    width, height = loading["size"]
    lines = [
        "## Rendering",
        "",
        f"{loading['images']} images of the demo at {width} x {height}, {loading['samples']} samples, denoised, on the "
        f"CPU. Starting Blender takes {loading['start_s']:.1f} s once.",
        "",
        "| | s an image |",
        "|---|---:|",
        f"| loading and posing, steady state | {steady['load']:.3f} |",
        f"| syncing, BVH, sky map | {steady['sync']:.3f} |",
        f"| saving | {steady['save']:.3f} |",
        f"| sum outside sampling, steady state | {loading['steady_overhead_s']:.3f} |",
        f"| the same, first image | {loading['first_overhead_s']:.3f} |",
        f"| the same, everything loaded again for each image | {loading['plain_overhead_s']:.3f} |",
        f"| sampling | {steady['sample']:.3f} |",
        f"| whole run, {loading['images']} images | {loading['ours_s']:.1f} in all |",
        f"| whole run, everything loaded again for each image | {loading['plain_s']:.1f} in all, "
        f"{loading['plain_s'] / loading['ours_s']:.2f} times as long |",
        "",
        f"A worker's memory from a scenery's image {memory['from']} to its last (small images, all vehicles in turn): "
        + "; ".join(
            f"{name} {memory['growth'][name]:+.1%} over {len(found)} images, {max(found):,.0f} MB at most"
            for name, found in memory["megabytes"].items()
            if name in memory["growth"]
        )
        + ".",
        "",
        "### Samples against error",
        "",
        f"Mean over {error['images']} images at {error['size'][0]} x {error['size'][1]}; root mean square difference "
        f"from a reference of {error['reference_samples']} samples, in 8-bit steps, over the target's box and over the "
        "frame. Seconds are those that Cycles samples and denoises.",
        "",
        "| settings | s | error in the box | error in the frame |",
        "|---|---:|---:|---:|",
    ]
    for name, found in error["variants"].items():
        lines.append(f"| {name} | {found['seconds']:.2f} | {found['box']:.2f} | {found['frame']:.2f} |")
    return "\n".join(lines)


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw error against time, and memory."""
    variants = results["error"]["variants"]
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    families = {
        "plain samples": [f"{n} samples" for n in SAMPLES],
        "denoised": [f"{n} samples, denoised" for n in SAMPLES],
        "adaptive": [f"128 samples, denoised, threshold {t}" for t in ADAPTIVE],
        "bounces": [f"128 samples, denoised, {n} bounces" for n in BOUNCES],
    }
    for ax, key in zip(axes, ("box", "frame"), strict=True):
        for label, names in families.items():
            ax.plot([variants[n]["seconds"] for n in names], [variants[n][key] for n in names], "o-", label=label)
        default = variants["128 samples, denoised"]
        ax.plot(default["seconds"], default[key], "k*", markersize=14, label="default (paper)")
        ax.set(xscale="log", yscale="log", xlabel="seconds an image", title=f"error in the {key}")
    axes[0].set_ylabel("RMS difference, 8-bit steps")
    axes[0].legend()
    error_path = folder / "rendering_error.png"
    figure.tight_layout()
    figure.savefig(error_path, dpi=120)
    plt.close(figure)
    figure, ax = plt.subplots(figsize=(6, 3))
    for name, held in results["memory"]["megabytes"].items():
        ax.plot(held, label=name)
    ax.legend()
    ax.set(xlabel="images of a scenery", ylabel="MB held by the worker", ylim=(0, None))
    memory_path = folder / "rendering_memory.png"
    figure.tight_layout()
    figure.savefig(memory_path, dpi=120)
    plt.close(figure)
    return [error_path, memory_path]
