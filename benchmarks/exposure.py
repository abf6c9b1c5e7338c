"""Exposure: the grey card in real renders under many HDRIs of any scale, and the error of smaller maps of them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from assets.skylight import level_irradiance
from benchmarks.exposure_skies import KINDS
from camera.response import ALBEDO, CARD, LUMINANCE, displayed, metered

HERE = Path(__file__).parent
POWERS = (-8, 0, 8)  # of two, by which each HDRI is scaled
ROWS = (256, 128, 64, 32, 16)  # of smaller maps
FOG_M = (100.0, 1000.0, 4000.0)


def run(quick: bool) -> dict[str, Any]:
    """Render the card under each HDRI, exposed as a plan would have it."""
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name).resolve()
        kinds = list(KINDS)[:: 6 if quick else 1]
        said = _blender("exposure_skies.py", folder, {"kinds": kinds, "powers": POWERS, "rows": ROWS})
        jobs: list[dict[str, Any]] = []
        for sky in said:
            (exposure,) = metered(ALBEDO / np.pi * np.array([sky["irradiance"]]))
            jobs.append({"hdri": sky["path"], "yaw": 0.7, "exposure": float(exposure)})
        for sky, job in list(zip(said, jobs, strict=True)):
            if sky["power"] == 0 and sky["kind"] in (*kinds[:2], "sunset"):
                jobs += [{**job, "visibility_m": metres} for metres in FOG_M]
        levels = _blender("exposure_blender.py", folder, jobs)
    cards = [
        {"kind": Path(job["hdri"]).stem, "fog_m": job.get("visibility_m"), "error_ev": error_ev(level)}
        for job, level in zip(jobs, levels, strict=True)
    ]
    maps = {
        str(rows): [_off(sky["smaller"][str(rows)], sky["irradiance"]) for sky in said if sky["power"] == 0]
        for rows in ROWS
    }
    return {"cards": cards, "maps": maps}


def _blender(script: str, folder: Path, asked: Any) -> Any:
    """What a script that runs Blender answers."""
    given, answer = folder / f"{script}.json", folder / f"{script}.answer.json"
    given.write_text(json.dumps(asked))
    subprocess.run(
        [sys.executable, "-P", str(HERE / script), str(given), str(answer)], check=True, stdout=subprocess.DEVNULL
    )
    return json.loads(answer.read_text())


def error_ev(level: list[float]) -> float:
    """EV that a card's colour in a picture is brighter than was asked for."""
    ev = np.linspace(-4.0, 4.0, 801)
    ramp = displayed(ALBEDO * np.exp2(ev)[:, None] * np.ones(3)) @ LUMINANCE
    return float(np.interp(np.dot(level, LUMINANCE), ramp, ev) - np.interp(CARD, ramp, ev))


def _off(found: list[float], true: list[float]) -> float:
    return float(np.log2(np.dot(found, LUMINANCE) / np.dot(true, LUMINANCE)))


def smaller(pixels: np.ndarray, rows: int) -> np.ndarray:
    """Irradiance by the means over squares of a picture, `rows` high."""
    step = len(pixels) // rows
    means = pixels.reshape(rows, step, 2 * rows, step, 3).mean(axis=(1, 3), dtype=np.float64)
    return level_irradiance(means)


def report(results: Mapping[str, Any]) -> str:
    """Markdown of the figures."""
    cards = results["cards"]
    clear = np.abs([card["error_ev"] for card in cards if card["fog_m"] is None])
    foggy = np.abs([card["error_ev"] for card in cards if card["fog_m"] is not None])
    lines = [
        "## Exposure",
        "",
        f"A level card of 18 % in {len(clear)} renders, under {len(clear) // len(POWERS)} HDRIs (physical skies by day "
        "and at night, suns of one pixel, studios, Blender's own), each times 2^-8, 1 and 2^8, exposed as a plan "
        "exposes it: its luminance in the picture, as EV off what was asked for.",
        "",
        "| | renders | median | worst |",
        "|---|---:|---:|---:|",
        f"| clear air | {len(clear)} | {np.median(clear):.3f} | {clear.max():.3f} |",
        f"| fog of 100 to 4000 m | {len(foggy)} | {np.median(foggy):.3f} | {foggy.max():.3f} |",
        "",
        "### Irradiance by a smaller map",
        "",
        "The same integral over means of squares, as EV off that over all pixels. Plans use all pixels, once a file.",
        "",
        "| rows of the map | median | worst |",
        "|---:|---:|---:|",
    ]
    for rows, off in results["maps"].items():
        lines.append(f"| {rows} | {np.median(np.abs(off)):.4f} | {np.abs(off).max():.4f} |")
    return "\n".join(lines)


def plots(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """None."""
    del results, folder
    return []
