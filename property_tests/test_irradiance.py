"""Irradiance of a sky on level ground, compared with its integral and with smaller maps."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from hulldown.assets.skylight import level_irradiance
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.camera.response import CARD_ALBEDO, CARD_LEVEL, display_levels, metered_exposures_ev


@st.composite
def skies(draw, *, rows=(2, 3, 8, 32)):
    """A sky of noise, with a sun of any brightness anywhere, the lowest row first."""
    height = draw(st.sampled_from(rows))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sky = rng.uniform(0.0, 2.0, (height, 2 * height, 3))
    sky[draw(st.integers(0, height - 1)), draw(st.integers(0, 2 * height - 1))] = draw(st.floats(0.0, 1e6))
    return sky


@given(skies(rows=(128,)), st.sampled_from([2, 4, 8]))
def test_the_error_of_a_smaller_map_is_bounded_by_its_sun(sky, step):
    # A mean over a square moves light by half its diagonal at most; with the hat's, elevation moves by `step` rows.
    small = sky.reshape(128 // step, step, 256 // step, step, 3).mean(axis=(1, 3))
    # The weight sin e cos e has a slope of at most 1; light from below the horizon may rise as far.
    reach = 1.5 * step * np.pi / 128
    near = (np.arange(128) + 0.5) / 128 * np.pi - np.pi / 2 > -reach
    light = (sky.sum(axis=1) * near[:, None]).sum(axis=0) * (np.pi / 128) ** 2
    assert (np.abs(level_irradiance(small) - level_irradiance(sky)) <= light * reach).all()


@given(skies())
def test_irradiance_is_the_integral_over_the_hats_of_rows(sky):
    height = len(sky)
    step = np.pi / height
    center = (np.arange(height) + 0.5) * step - np.pi / 2

    def light(elevation, row):
        hat = max(0.0, 1.0 - abs(elevation - center[row]) / step)
        return (1.0 if row == height - 1 and elevation > center[-1] else hat) * np.sin(elevation) * np.cos(elevation)

    breaks = [0.0, *center[center > 0.0], np.pi / 2]
    weights = np.array(
        [sum(integrate.quad(light, low, high, args=(row,))[0] for low, high in pairwise(breaks)) for row in range(height)]
    )
    expected = 2.0 * np.pi * weights @ sky.mean(axis=1)
    np.testing.assert_allclose(level_irradiance(sky), expected, rtol=1e-9)


COLORS = st.tuples(*[st.floats(0.2, 1.0)] * 3)


@given(COLORS, st.floats(-12.0, 12.0))
def test_a_metered_card_is_mid_gray_in_any_light(color, power):
    card = CARD_ALBEDO * np.array([color]) * 2.0**power
    (ev,) = metered_exposures_ev(card)
    assert display_levels(card[0] * 2.0**ev) @ LUMINANCE_WEIGHTS == pytest.approx(CARD_LEVEL, abs=1e-6)
    (brighter,) = metered_exposures_ev(2.0 * card)
    assert brighter == pytest.approx(ev - 1.0, abs=1e-9)
