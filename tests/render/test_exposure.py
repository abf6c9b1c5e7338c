"""Cycles renders a gray card with the requested brightness under any sky."""

import numpy as np
import psutil
import pytest

from hulldown.assets.skylight import level_irradiance
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.response import CARD_ALBEDO, CARD_LEVEL, display_levels, metered_exposures_ev, white_balance_matrix
from hulldown.render.blender.messages import CameraInput, CyclesSettings, LightInput, RenderJob
from hulldown.render.process import Blender
from hulldown.tests.builders.blender_plans import drawn, run_script
from hulldown.weather.kinds import Weather

pytestmark = pytest.mark.blender
HEIGHT = 512
# Looks down from so near that air hardly matters.
ABOVE = [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.15], [0.0, 0.0, 0.0, 1.0]]
BLUE, WHITE, WARM, DUSK = (0.3, 0.5, 1.0), (1.0, 1.0, 1.0), (1.0, 0.6, 0.3), (0.9, 0.35, 0.2)
# Elevation and diameter of the sun in degrees, its radiance, colors of sky and sun, contrast of the clouds.
SKIES = {
    "overcast": (45.0, 40.0, 1.5, WHITE, WHITE, 0.3),
    "dusk": (2.0, 8.0, 30.0, DUSK, WARM, 0.2),
    "lamp": (50.0, 12.0, 400.0, (0.01, 0.01, 0.01), WARM, 0.0),
    "noon": (60.0, 0.53, 7e5, BLUE, WHITE, 0.0),  # a sun of one or two pixels
}


def sky(kind):
    """A gradient (h, w, 3) with a sun and clouds, the lowest row first."""
    up, size, radiance, air, sun, noise = SKIES[kind]
    elevation = ((np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi - np.pi / 2)[:, None]
    azimuth = np.pi - (np.arange(2 * HEIGHT) + 0.5) / HEIGHT * np.pi
    height = np.radians(up)
    cosine = np.sin(elevation) * np.sin(height) + np.cos(elevation) * np.cos(height) * np.cos(azimuth - 0.3)
    disc = cosine > np.cos(np.radians(size) / 2)
    disc.flat[np.argmax(cosine)] = True  # a sun smaller than a pixel gets one
    clouds = np.random.default_rng(1).uniform(1.0 - noise, 1.0 + noise, (HEIGHT // 8, HEIGHT // 4)).repeat(8, 0)
    gradient = np.where(elevation > 0.0, 0.6 + 0.4 * np.exp(-4.0 * elevation), 0.25)
    pixels = (gradient * clouds.repeat(8, 1))[..., None] * np.array(air)
    return (pixels + disc[..., None] * radiance * np.array(sun)).astype(np.float32)


def rendered(folder, jobs, *, samples=4096, watch=lambda pid: None):
    """The mean color, from 0 to 255, of a picture that shows only a gray card, for each job; `watch` after each."""
    run_script("gray_cards.py", folder)
    levels = []
    with Blender(folder / "log", device="cpu") as blender:
        for number, (sky, strength, horizon, exposure, white_balance, weather) in enumerate(jobs):
            job = RenderJob(
                scenery=str(folder / "card.blend"),
                vehicles=[],
                camera=CameraInput(ABOVE, Intrinsics(4, 4, 0.2), 0.01, exposure, white_balance),
                light=LightInput(str(folder / f"{sky}.exr"), 0.7, strength, horizon),
                weather=weather,
                seed=0,
                settings=CyclesSettings(samples, denoise=False, adaptive_threshold=0.0, bounces=4),
                output=str(folder / f"{number}.png"),
            )
            levels.append(drawn(blender, job).mean(axis=(0, 1)))
            watch(blender.process_id)
    return np.array(levels)


def error_ev(level):
    """EV by which a card is brighter in a picture than requested."""
    ev = np.linspace(-4.0, 4.0, 801)
    ramp = display_levels(CARD_ALBEDO * np.exp2(ev)[:, None] * np.ones(3)) @ LUMINANCE_WEIGHTS
    return float(np.interp(np.dot(level, LUMINANCE_WEIGHTS), ramp, ev) - np.interp(CARD_LEVEL, ramp, ev))


def test_a_gray_card_has_the_requested_brightness(tmp_path):
    names, irradiance = [], []
    for kind in SKIES:
        for power in (-8, 8):
            pixels = sky(kind) * np.float32(2.0**power)
            names.append(f"{kind}{power}")
            np.save(tmp_path / f"{names[-1]}.npy", pixels)
            irradiance.append(level_irradiance(pixels))
    radiance = CARD_ALBEDO / np.pi * np.array(irradiance)
    exact = metered_exposures_ev(radiance).tolist()
    jobs = [(name, 1.0, None, ev, 0.0, None) for name, ev in zip(names, exact, strict=True)]
    first, ev, n = names[0], exact[0], len(names)
    jobs += [(first, 1.0, None, ev, 0.0, Weather(100.0, "fog")), (first, 1.0, None, ev, 900.0, None)]
    jobs += [(first, 1.0, 0.8, ev, 0.0, None), (first, 4.0, None, ev - 2.0, 0.0, None)]
    levels = rendered(tmp_path, jobs)
    assert [abs(error_ev(level)) < 0.1 for level in levels[: n + 1]] == [True] * (n + 1), "fog matters"
    balanced = display_levels(white_balance_matrix(900.0) @ radiance[0] * 2.0 ** exact[0])
    np.testing.assert_allclose(levels[n + 1], balanced, atol=4.0)
    np.testing.assert_allclose(levels[n + 2], levels[0], atol=0.5)  # the visible horizon doesn't change the light
    np.testing.assert_allclose(levels[n + 3], levels[0], atol=0.5)


def test_memory_does_not_grow_with_exposures_and_white_balances(tmp_path):
    """OpenColorIO kept 3 MB of each exposure."""
    np.save(tmp_path / "sky.npy", sky("overcast"))
    held = []
    jobs = [("sky", 1.0, None, i / 4, 4000.0 + 400 * i, None) for i in range(8)]
    rendered(tmp_path, jobs, samples=1, watch=lambda pid: held.append(psutil.Process(pid).memory_info().rss))
    assert max(held) - held[0] < 8 << 20
