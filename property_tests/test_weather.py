"""Properties of weather: shares, what the air leaves, and what follows from the rate of rain."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.camera.weather import air_contrast, rain_visibility_m, wetness
from hulldown.planning.appearance.air import NAMES, draw_air
from hulldown.planning.config.weather_section import WeatherSection
from hulldown.planning.search.draws import RandomStreams

IMAGES = np.arange(2000)
METERS = st.floats(1.0, 1e6)
SEEDS = st.integers(0, 2**63 - 1)


@st.composite
def shares(draw):
    parts = [draw(st.floats(0.0, 1.0)) for _ in NAMES]
    return {kind: part / max(1.0, sum(parts)) for kind, part in zip(NAMES, parts, strict=True)}


@given(shares(), SEEDS)
def test_every_kind_comes_as_often_as_its_share(wanted, seed):
    kind = draw_air(WeatherSection(**wanted), draws=RandomStreams(seed), image=IMAGES).kind
    for i, name in enumerate(NAMES):
        # Six standard deviations of a share of 2000 are 0.067 at most.
        assert abs(np.mean(kind == i) - wanted[name]) < 0.067


@given(shares(), SEEDS, st.permutations(list(range(40))))
def test_weather_is_that_of_the_image_whatever_it_is_drawn_with(wanted, seed, order):
    section, draws = WeatherSection(**wanted), RandomStreams(seed)
    together = draw_air(section, draws=draws, image=np.arange(40)).weathers
    again = draw_air(section, draws=draws, image=np.array(order)).weathers
    assert [together[i] for i in order] == again
    assert [draw_air(section, draws=draws, image=np.array([i])).weathers[0] for i in range(40)] == together


@given(METERS, st.lists(st.floats(0.0, 1e6), min_size=2, max_size=20))
def test_the_air_leaves_a_share_that_falls_with_distance(visibility, distances):
    left = air_contrast(visibility, np.sort(distances))
    assert (left > 0.0).all()
    assert (left <= 1.0).all()
    assert (np.diff(left) <= 0.0).all()


@given(METERS, METERS, METERS)
def test_what_two_stretches_of_air_leave_is_the_product(visibility, first, second):
    whole = air_contrast(visibility, first + second)
    np.testing.assert_allclose(whole, air_contrast(visibility, first) * air_contrast(visibility, second), atol=1e-12)


@given(st.floats(0.1, 300.0), st.floats(0.1, 300.0))
def test_heavier_rain_hides_and_wets_more(one, other):
    light, heavy = sorted([one, other])
    assert rain_visibility_m(heavy) <= rain_visibility_m(light) * (1.0 + 1e-12)
    assert 0.0 <= wetness(light) <= wetness(heavy) <= 1.0
