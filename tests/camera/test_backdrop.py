"""The even color that replaces high surroundings, by the law of the oracle of rendered pictures."""

import numpy as np
import pytest

from hulldown.camera.backdrop import backdrop_color, backdrop_fade_sines
from hulldown.tests.oracles.rendered import radiance


def street():
    """A sky of 2 over houses of 0.1; one of them, a fifth of the horizon, is higher than the horizon of 30 degrees."""
    sky = np.full((180, 360, 3), 2.0)
    sky[60:] = 0.1
    sky[20:60, 100:172] = 0.1
    return sky


def at(elevation_deg):
    up, azimuths = np.radians(elevation_deg), np.linspace(-np.pi, np.pi, 97)
    return np.stack([np.cos(up) * np.cos(azimuths), np.cos(up) * np.sin(azimuths), np.full(97, np.sin(up))], axis=-1)


def test_objects_above_a_high_horizon_leave_no_streaks_below():
    assert backdrop_color(street(), np.radians(30.0)).tolist() == [2.0] * 3
    for elevation in (-5.0, 10.0, 29.9):
        seen = radiance(street(), at(elevation), yaw=0.4, strength=1.5, horizon_deg=30.0)
        np.testing.assert_allclose(seen, 3.0, rtol=1e-12)


def test_a_low_horizon_keeps_its_surroundings_colors():
    sky = np.repeat(np.linspace(1.0, 2.0, 360)[None, :, None], 180, axis=0).repeat(3, axis=2)
    seen = radiance(sky, at(0.0), yaw=0.0, strength=1.0, horizon_deg=5.0)
    assert np.ptp(seen) > 0.9


@pytest.mark.parametrize("horizon_deg", [15.1, 60.0, 79.9, 85.0, 90.0])
def test_the_fade_ends_above_its_start(horizon_deg):
    low, high = backdrop_fade_sines(np.radians(horizon_deg))
    assert low < high <= 1.0
