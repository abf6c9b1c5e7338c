"""Writes HDRIs of many kinds with Blender, scaled: `python -P exposure_skies.py ASKED.json ANSWER.json`.

Besides Blender's own, skies of a gradient with a sun of any size, height and colour, lamps in the dark, clouds.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from assets.skylight import level_irradiance

HEIGHT = 512
OWN = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
# Elevation and diameter of the sun in degrees, its radiance, colour of sky and sun, noise.
_BLUE, _WHITE, _WARM, _DUSK = (0.3, 0.5, 1.0), (1.0, 1.0, 1.0), (1.0, 0.6, 0.3), (0.9, 0.35, 0.2)
MADE = {
    **{f"noon {size:g} degrees": (60.0, size, 2e5 / size**2, _BLUE, _WHITE, 0.0) for size in (0.53, 1.0, 3.0, 10.0)},
    **{f"sun at {up:g} degrees": (up, 0.53, 3e4, _BLUE, _WARM, 0.1) for up in (1.0, 3.0, 10.0, 30.0, 89.0)},
    **{f"overcast {noise:g}": (45.0, 40.0, 1.5, _WHITE, _WHITE, noise) for noise in (0.0, 0.3, 0.9)},
    **{f"dusk {up:g}": (up, 8.0, 30.0, _DUSK, _WARM, 0.2) for up in (2.0, 6.0)},
    "moon": (35.0, 0.5, 20.0, (0.002, 0.003, 0.006), _WHITE, 0.0),
    "stars": (80.0, 0.5, 0.0, (1e-3, 1e-3, 2e-3), _WHITE, 0.9),
    **{f"lamp {up:g}": (up, 12.0, 400.0, (0.01, 0.01, 0.01), _WARM, 0.0) for up in (15.0, 50.0, 80.0)},
    "soft box": (60.0, 60.0, 20.0, (0.05, 0.05, 0.05), _WHITE, 0.0),
    "green lamp": (40.0, 20.0, 50.0, (0.01, 0.03, 0.01), (0.3, 1.0, 0.3), 0.0),
}
KINDS = (*OWN, *MADE)


def sky(kind: str) -> np.ndarray:
    """An HDRI of a kind, the lowest row first."""
    up, size, radiance, air, sun, noise = MADE[kind]
    elevation = ((np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi - np.pi / 2)[:, None]
    azimuth = np.pi - (np.arange(2 * HEIGHT) + 0.5) / HEIGHT * np.pi
    height = np.radians(up)
    cosine = np.sin(elevation) * np.sin(height) + np.cos(elevation) * np.cos(height) * np.cos(azimuth - 0.3)
    disc = cosine > np.cos(np.radians(size) / 2)
    disc.flat[np.argmax(cosine)] = True  # of a sun smaller than a pixel, one
    clouds = np.random.default_rng(1).uniform(1.0 - noise, 1.0 + noise, (HEIGHT // 8, HEIGHT // 4)).repeat(8, 0)
    gradient = np.where(elevation > 0.0, 0.6 + 0.4 * np.exp(-4.0 * elevation), 0.25)
    pixels = (gradient * clouds.repeat(8, 1))[..., None] * np.array(air)
    return (pixels + disc[..., None] * radiance * np.array(sun)).astype(np.float32)


def main() -> None:
    """Write what is asked for, and say where, with the irradiance that it has."""
    import bpy

    from benchmarks.exposure import smaller
    from reading.blender.pictures import _pixels, _write
    from reading.hdri import mend

    asked, folder = json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[1]).parent
    os.dup2(2, 1)
    own = Path(bpy.utils.resource_path("LOCAL")) / "datafiles" / "studiolights" / "world"
    answers = []
    for number, kind in enumerate(asked["kinds"]):
        pixels = mend(_pixels(bpy.data.images.load(str(own / f"{kind}.exr"))))[0] if kind in OWN else sky(kind)
        for power in asked["powers"]:
            path = folder / f"{number:02d} {kind} {power}.exr"
            _write(pixels * np.float32(2.0**power), str(path))
            answers.append({
                "kind": kind, "power": power, "path": str(path),
                "irradiance": (level_irradiance(pixels) * 2.0**power).tolist(),
                "smaller": {str(rows): smaller(pixels, rows).tolist() for rows in asked["rows"]},
            })  # fmt: skip
    Path(sys.argv[2]).write_text(json.dumps(answers))


if __name__ == "__main__":
    main()
