"""Dust, rain, and snow in Cycles' pictures: the veil follows its law, and the streaks are the drawn drops."""

import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.response import display_levels
from hulldown.render.blender.messages import CameraInput, CyclesSettings, LightInput, RenderJob
from hulldown.render.process import Blender
from hulldown.tests.builders.blender_plans import drawn
from hulldown.weather.kinds import (
    DUSTY_AIR_ALBEDO,
    WEATHER_KINDS,
    Weather,
    air_extinction,
    air_layers,
    airlight_radiance,
    even_sky_radiance,
)
from hulldown.weather.precipitation import precipitation_view, rain_sizes, sample_drops_in_view

pytestmark = pytest.mark.blender
AHEAD = [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
SKY = 0.5  # radiance of gray.exr
WALL = 0.05  # of the wall in wall.blend
NO_VEIL = 1e9
RAIN = Weather(NO_VEIL, "rain", 100.0, (0.0, 2.0), 0.01, 0.0, 0.0)


class Studio:
    """A worker that renders jobs in small worlds."""

    def __init__(self, worlds, folder):
        self.worlds, self.folder, self._count = worlds, folder, 0
        self.blender = Blender(folder / "log", device="cpu")

    def picture(self, weather, *, world="wall", sky="gray", pose=AHEAD, fov_x_deg=60.0, width=96, samples=16, seed=1):
        output = self.folder / f"{self._count}.png"
        self._count += 1
        job = RenderJob(
            scenery=str(self.worlds / f"{world}.blend"),
            vehicles=[],
            camera=CameraInput(pose, Intrinsics(width, width * 9 // 16, math.radians(fov_x_deg)), 0.1, 0.0, 0.0),
            light=LightInput(str(self.worlds / f"{sky}.exr"), 0.0, 1.0, None),
            weather=weather,
            seed=seed,
            settings=CyclesSettings(samples, False, 0.0, 2),
            output=str(output),
        )
        return drawn(self.blender, job)


@pytest.fixture(scope="module")
def studio(worlds, tmp_path_factory):
    made = Studio(worlds, tmp_path_factory.mktemp("air"))
    with made.blender:
        yield made


@pytest.mark.parametrize(("kind", "color"), [("fog", (1.0, 1.0, 1.0)), ("rain", (1.0, 1.0, 1.0)), ("dust", DUSTY_AIR_ALBEDO)])
@pytest.mark.parametrize("visibility", [50.0, 200.0])
def test_the_veil_follows_koschmieders_law(studio, kind, color, visibility):
    """Black walls at three distances have the airlight's radiance times 1 - exp(-3.912 d / visibility)."""
    weather = Weather(visibility, kind, 0.0, (0.0, 0.0), 0.004, 0.0, 0.0)
    seen = studio.picture(weather, world="walls", fov_x_deg=90.0, width=128, samples=4)
    for x, y in ((19.75, -8.0), (59.75, 0.0), (149.75, 70.0)):
        veil = 1.0 - math.exp(-3.912 * math.hypot(x, y) / visibility)
        column = round(64.0 - 64.0 * y / x)
        expected = display_levels(SKY * veil * np.array(color))
        assert np.abs(seen[35:37, column - 1 : column + 1] - expected).max() <= 4.0


def test_dust_thins_above_the_camera():
    tops = [layer.above for layer in air_layers("dust", 400.0)]
    assert sum(tops) / len(tops) == pytest.approx(100.0)  # all of the decay is above
    assert max(tops) > 5.0 * min(tops)


@pytest.mark.parametrize("kind", ["fog", "dust"])
@pytest.mark.parametrize("visibility", [100.0, 2000.0])
def test_the_sun_fades_and_airlight_reaches_the_ground(studio, kind, visibility):
    """Level ground has the brightness of the integral over the sky, with each direction's light dimmed by its air."""
    weather = Weather(visibility, kind, 0.0, (0.0, 0.0), 0.004, 0.0, 0.0)
    pose = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 2.0], [0.0, 0.0, 0.0, 1.0]]
    seen = studio.picture(weather, world="ground", sky="sunny", pose=pose, fov_x_deg=20.0, width=32, samples=64)
    elevation = math.pi / 2 - (np.arange(64) + 0.5) / 128 * math.pi
    sunny = np.load(studio.worlds / "sunny.npy")
    glow = airlight_radiance(kind, even_sky_radiance(np.repeat(sunny[..., None], 3, axis=2)))
    depth = np.zeros(64)
    for layer in air_layers(kind, visibility):
        up = (layer.above + 2.0) / np.sin(elevation)
        depth += layer.extinction * np.minimum(up, layer.reach / np.cos(elevation))
    clear = np.exp(-depth)[:, None]
    weight = np.sin(2 * elevation)[:, None] * math.pi**2 / 128  # weight of a row of the sky, on level ground
    ground = 0.5 / math.pi * ((clear * sunny[:64].mean(axis=1)[:, None] + (1 - clear) * glow) * weight).sum(axis=0)
    near = math.exp(-air_extinction(visibility) * 2.0)
    expected = display_levels(ground * near + glow * (1 - near))
    assert np.abs(seen.mean(axis=(0, 1)) - expected).max() <= 3.0


def hidden_by(picture, radiance):
    """Share of the wall hidden by streaks of this radiance in a gray picture, in blocks of 6 x 6 pixels."""
    levels = np.linspace(WALL / 2.0, radiance, 4000)
    curve = display_levels(np.repeat(levels[:, None], 3, axis=1))[:, 1]
    share = (np.interp(picture[..., 1], curve, levels) - WALL) / (radiance - WALL)
    h, w = share.shape
    return share.reshape(h // 6, 6, w // 6, 6).mean(axis=(1, 3))


def moved(drops, view, width, *, times=96, fine=3):
    """The same for moving discs, sampled in time on a finer grid: neither quads nor closed form."""
    height = width * 9 // 16
    y, x = np.mgrid[0 : height * fine, 0 : width * fine]
    rays = np.stack([((x + 0.5) / fine - width / 2) * view.pixel, ((y + 0.5) / fine - height / 2) * view.pixel], axis=2)
    rays = np.concatenate([rays, np.ones((*x.shape, 1))], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    through = np.ones(x.shape)
    centers, velocities = drops.centers @ view.axes, drops.velocities @ view.axes
    for center, diameter, velocity in zip(centers, drops.diameters, velocities, strict=True):
        moments = center + ((np.arange(times) + 0.5) / times - 0.5)[:, None] * view.exposure_s * velocity
        wide = max(diameter / math.sqrt(2.0), 0.75 * view.pixel * np.linalg.norm(center))
        at = moments[:, :2] / moments[:, 2:] / view.pixel + [width / 2, height / 2]
        margin = wide / center[2] / view.pixel + 2.0
        low = np.floor((at.min(axis=0) - margin) * fine).astype(int).clip(0)
        high = np.ceil((at.max(axis=0) + margin) * fine).astype(int).clip(0)
        part = rays[low[1] : high[1], low[0] : high[0]]
        along = part @ moments.T
        beside = (moments**2).sum(axis=1) - along**2  # squared distance of the ray from the disc's center
        hidden = np.maximum(1.0 - beside / wide**2, 0.0).mean(axis=2)
        through[low[1] : high[1], low[0] : high[0]] *= 1.0 - hidden * (diameter / math.sqrt(2.0) / wide) ** 2
    share = 1.0 - through
    return share.reshape(height // 6, 6 * fine, width // 6, 6 * fine).mean(axis=(1, 3))


def test_streaks_hide_as_much_as_the_falling_drops(studio):
    """In front of a dark wall, a picture is as bright as the share hidden by moving drops."""
    found = studio.picture(RAIN, fov_x_deg=25.0, width=192, samples=64, seed=7)
    view = precipitation_view(np.array(AHEAD), Intrinsics(192, 108, math.radians(25.0)), RAIN.exposure_s)
    drops = sample_drops_in_view(rain_sizes(RAIN.rain_mm_h), view, RAIN.wind_m_s, seed=7)
    expected = moved(drops, view, 192)
    bare = hidden_by(studio.picture(None, fov_x_deg=25.0, width=192, samples=1), SKY * WEATHER_KINDS["rain"].share_of_sky)
    share = hidden_by(found, SKY * WEATHER_KINDS["rain"].share_of_sky) - bare
    assert len(drops.diameters) > 80
    assert share.mean() == pytest.approx(expected.mean(), rel=0.1)
    assert np.corrcoef(share.ravel(), expected.ravel())[0, 1] > 0.95
