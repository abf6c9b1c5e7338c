"""The oracles of rendered pictures find another sky, and outlines of something else."""

import math

import numpy as np
import orjson
import pytest

from hulldown.camera.response import display_levels
from hulldown.plan.row import decode_row
from hulldown.scene.ground import Plane
from hulldown.scene.posed_scene import Scene
from hulldown.tests.builders.plan_lines import altered
from hulldown.tests.builders.render_plans import make_row
from hulldown.tests.dataset.test_target_appearance import scene
from hulldown.tests.oracles.rendered import MAX_SKY_DIFFERENCE, MIN_OUTLINE_STEP, outline_steps, radiance, sky_difference
from hulldown.weather.kinds import Weather

ROW = altered(
    decode_row(orjson.dumps(make_row(0, width=160, height=90, fov_x_deg=60.0))),
    **{"hdri_yaw_deg": 40.0, "strength": 1.2, "weather": None, "exposure_ev": 0.0, "white_balance_k": 0.0},
)
FOG = Weather(200.0, "fog")


def sky(red, blue, bright_at):
    """A map that is red below, blue above, and bright around one azimuth in degrees."""
    rows, columns = np.mgrid[0:64, 0:128]
    azimuth = np.pi - (columns + 0.5) / 128 * 2 * np.pi
    glow = 0.2 + 2.0 * np.exp(3.0 * (np.cos(azimuth - math.radians(bright_at)) - 1.0))
    share = (rows + 0.5)[..., None] / 64
    return glow[..., None] * (share * np.array([red, 0.3, 0.2]) + (1 - share) * np.array([0.2, 0.4, blue]))


EAST, WEST = sky(0.9, 0.6, 0.0), sky(0.5, 0.9, 180.0)


def picture(row, sky=EAST):
    """A noisy picture of an endless plain."""
    along = row.camera.rays(row.intrinsics.pixel_centers)[1]
    yaw = math.radians(row.hdri_yaw_deg)
    seen = display_levels(radiance(sky, along, yaw=yaw, strength=row.strength, weather=row.weather))
    shown = np.where(along[:, 2:] < 0.0, 70.0, seen).reshape(row.height, row.width, 3)
    return (shown + np.random.default_rng(0).normal(0.0, 25.0, (row.height, row.width, 1))).clip(0, 255)


def difference(picture, row=ROW):
    return sky_difference(picture, row, Scene(ground=Plane(0.0)), EAST)


@pytest.mark.parametrize("weather", [None, FOG])
def test_the_planned_sky_passes(weather):
    row = altered(ROW, weather=weather)
    assert difference(picture(row), row) < MAX_SKY_DIFFERENCE


@pytest.mark.parametrize("change", [{"hdri_yaw_deg": 130.0}, {"strength": 0.6}, {"weather": FOG}])
def test_another_turn_strength_or_fog_is_found(change):
    assert difference(picture(altered(ROW, **change))) > MAX_SKY_DIFFERENCE


def test_another_sky_is_found():
    assert difference(picture(ROW, WEST)) > MAX_SKY_DIFFERENCE


def test_a_picture_without_sky_has_no_difference():
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]])
    assert math.isnan(difference(picture(ROW), altered(ROW, world_from_camera=down)))


@pytest.mark.parametrize(
    ("horizon_deg", "rows"), [(None, [42, 31, 24, 14, 0]), (5.0, [30, 30, 24, 14, 0]), (20.0, [22.5, 22.5, None, 14, 0])]
)
def test_rows_of_the_map_are_elevations_and_a_horizon_covers_those_below(horizon_deg, rows):
    elevation = np.radians([-30.0, 2.0, 22.0, 50.0, 88.0])
    along = np.stack([np.cos(elevation), 0.0 * elevation, np.sin(elevation)], axis=1)
    numbered = np.broadcast_to(np.arange(64.0)[:, None, None], (64, 128, 3))
    if None in rows:  # a high horizon fades out, linearly in the sine, from 20 to 30 degrees: rows 24 to 21
        begin, end = np.sin(np.radians([20.0, 30.0]))
        rows = [24.0 - 1.5 * (end - math.sin(elevation[2])) / (end - begin) if row is None else row for row in rows]
    found = radiance(numbered, along, yaw=0.4, strength=2.0, horizon_deg=horizon_deg)
    np.testing.assert_allclose(found, 2.0 * np.repeat(np.array(rows)[:, None], 3, axis=1), rtol=1e-12)


@pytest.mark.parametrize("kind", ["fog", "rain", "snow"])
def test_weather_keeps_an_even_sky(kind):
    along = np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    found = radiance(np.full((64, 128, 3), 0.5), along, yaw=0.0, strength=3.0, weather=Weather(150.0, kind))
    np.testing.assert_allclose(found, 1.5, rtol=1e-6)


def test_outlines_of_the_picture_stand_out_and_those_of_another_do_not():
    (first, mask), (second, other) = scene(1), scene(3)
    assert min(*outline_steps(first, [mask]), *outline_steps(second, [other])) > 4 * MIN_OUTLINE_STEP
    assert max(*outline_steps(first, [other]), *outline_steps(second, [mask])) < MIN_OUTLINE_STEP
