"""Cycles renders a gray card with the requested brightness under any sky."""

import json

import numpy as np
import pytest

from hulldown.assets.skylight import level_irradiance
from hulldown.camera.response import ALBEDO, CARD, displayed, metered, white_balance
from hulldown.geometry.color import LUMINANCE
from hulldown.tests.blender_plans import run_script

pytestmark = pytest.mark.blender
HEIGHT = 512
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


def rendered(folder, jobs):
    given, answer = folder / "jobs.json", folder / "answer.json"
    given.write_text(json.dumps(jobs))
    run_script("gray_cards.py", given, answer)
    return np.array(json.loads(answer.read_text()))


def error_ev(level):
    """EV by which a card is brighter in a picture than requested."""
    ev = np.linspace(-4.0, 4.0, 801)
    ramp = displayed(ALBEDO * np.exp2(ev)[:, None] * np.ones(3)) @ LUMINANCE
    return float(np.interp(np.dot(level, LUMINANCE), ramp, ev) - np.interp(CARD, ramp, ev))


def test_a_gray_card_has_the_requested_brightness(tmp_path):
    jobs, irradiance = [], []
    for kind in SKIES:
        for power in (-8, 8):
            pixels = sky(kind) * np.float32(2.0**power)
            np.save(tmp_path / f"{kind}{power}.npy", pixels)
            irradiance.append(level_irradiance(pixels))
            jobs.append({"sky": str(tmp_path / f"{kind}{power}.npy"), "yaw": 0.7})
    radiance = ALBEDO / np.pi * np.array(irradiance)
    exact = metered(radiance).tolist()
    jobs = [{**job, "exposure": ev} for job, ev in zip(jobs, exact, strict=True)]
    first, n = jobs[0], len(jobs)
    jobs += [{**first, "visibility_m": 100.0}, {**first, "white_balance": 900.0}, {**first, "horizon": 0.8}]
    jobs += [{**first, "strength": 4.0, "exposure": exact[0] - 2.0}]
    levels = rendered(tmp_path, jobs)
    assert [abs(error_ev(level)) < 0.1 for level in levels[: n + 1]] == [True] * (n + 1), "fog matters"
    balanced = displayed(white_balance(900.0) @ radiance[0] * 2.0 ** exact[0])
    np.testing.assert_allclose(levels[n + 1], balanced, atol=4.0)
    np.testing.assert_allclose(levels[n + 2], levels[0], atol=0.5)  # the visible horizon doesn't change the light
    np.testing.assert_allclose(levels[n + 3], levels[0], atol=0.5)
