"""Shares of weather: each kind is as frequent as configured, independently for each image."""

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.planning.appearance.air import NAMES, draw_weathers
from hulldown.planning.config.weather_section import WeatherSection
from hulldown.planning.search.draws import RandomStreams

IMAGES = np.arange(2000)
SEEDS = st.integers(0, 2**63 - 1)


@st.composite
def shares(draw):
    parts = [draw(st.floats(0.0, 1.0)) for _ in NAMES]
    return {kind: part / max(1.0, sum(parts)) for kind, part in zip(NAMES, parts, strict=True)}


@given(shares(), SEEDS)
def test_every_kind_has_its_share(wanted, seed):
    weathers = draw_weathers(WeatherSection(**wanted), draws=RandomStreams(seed), image=IMAGES)
    counts = Counter(weather.kind for weather in weathers if weather is not None)
    for name in NAMES:
        # Six standard deviations of a share of 2000 are 0.067 at most.
        assert abs(counts[name] / len(IMAGES) - wanted[name]) < 0.067


@given(shares(), SEEDS, st.permutations(list(range(40))))
def test_weather_of_an_image_does_not_depend_on_the_batch(wanted, seed, order):
    section, draws = WeatherSection(**wanted), RandomStreams(seed)
    together = draw_weathers(section, draws=draws, image=np.arange(40))
    again = draw_weathers(section, draws=draws, image=np.array(order))
    assert [together[i] for i in order] == again
    assert [draw_weathers(section, draws=draws, image=np.array([i]))[0] for i in range(40)] == together
