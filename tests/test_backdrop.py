"""Skies without open land are reported, with the height of their surroundings."""

import numpy as np
import pytest

from hulldown.reading.skies.backdrop import backdrop, small_map


def open_sky():
    """An even blue sky, brighter at the horizon, over dark earth; the zenith in the first row."""
    elevation = np.radians(90.0 - (np.arange(128) + 0.5) / 128 * 180.0)[:, None, None]
    sky = (0.6 + 0.6 * np.exp(-4.0 * np.maximum(elevation, 0.0))) * np.array([0.4, 0.6, 1.0])
    return np.where(elevation > 0.0, sky, [0.12, 0.1, 0.08]) * np.ones((128, 256, 1))


def standing(degrees, columns, level=0.1):
    """The same sky with something dark in front."""
    sky = open_sky()
    elevation = 90.0 - (np.arange(128) + 0.5) / 128 * 180.0
    sky[np.ix_((elevation > 0.0) & (elevation < degrees), columns)] *= level
    return sky


def test_an_open_sky_fits_and_ends_at_the_horizon():
    assert backdrop(open_sky()) == (0.703, ())


@pytest.mark.parametrize(
    ("degrees", "columns", "open_land"),
    [
        pytest.param(8.0, range(256), True, id="low wood"),
        pytest.param(30.0, range(40), False, id="facades"),
        pytest.param(40.0, [7, 8], True, id="lamp post"),
    ],
)
def test_surroundings_are_measured_and_reported_if_wide_and_high(degrees, columns, open_land):
    horizon_deg, misfits = backdrop(standing(degrees, columns))
    assert horizon_deg == pytest.approx(degrees, abs=1.5)
    assert ["above its horizon" in misfit for misfit in misfits] == [True] * (not open_land)


def test_a_ceiling_and_a_roof_are_reported():
    warm = open_sky()[..., ::-1]
    assert backdrop(warm)[1] == ("overhead, it is as warm as a ceiling",)
    beams = open_sky()
    beams[:, ::4] *= 0.6
    assert any("has edges" in misfit for misfit in backdrop(beams)[1])


def test_brightness_and_yaw_of_a_sky_do_not_matter():
    sky = standing(20.0, range(40))
    assert backdrop(sky * 2.0**-12) == backdrop(sky) == backdrop(np.roll(sky, 77, axis=1))


def test_a_sky_of_few_rows_is_not_judged():
    assert backdrop(small_map(np.ones((4, 8, 3)))) == (22.5, ())


def test_a_downsampled_map_has_means_with_the_zenith_first():
    pixels = np.zeros((256, 512, 3))
    pixels[255, 0] = 4.0
    assert small_map(pixels)[0, 0].tolist() == [1.0, 1.0, 1.0]
