"""Weather: laws, random draws, and limits of contrast."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from hulldown.base.errors import ConfigError
from hulldown.plan.config.scene_sections import WeatherSection
from hulldown.planning.appearance import hdri_weights, sample_light_columns
from hulldown.planning.search.random_streams import RandomStreams
from hulldown.planning.search.tables import WEATHER_NAMES, sample_weathers
from hulldown.tests.builders.planning_assets import plan, small_assets, small_config
from hulldown.weather.extinction import rain_visibility_m, surface_wetness
from hulldown.weather.kinds import WEATHER_KINDS, Weather

IMAGES = np.arange(4000)
ASSETS = small_assets()
BUDGET = {"images_per_class": 3, "images_per_position": 2}
ALL = {"fog": 0.1, "rain": 0.2, "snow": 0.25, "dust": 0.3}


def drawn(**keys):
    return sample_weathers(WeatherSection(**keys), draws=RandomStreams(5), image=IMAGES)


def test_the_config_has_the_keys_of_every_kind_and_three_for_all():
    named = [{name, kind.visibility, kind.rate, *kind.covers} - {""} for name, kind in WEATHER_KINDS.items()]
    assert set().union(*named, {"wind_m_s", "exposure_s", "min_contrast"}) == set(WeatherSection.model_fields)


def test_other_weather_does_not_change_fog():
    alone, beside = drawn(fog=0.1), drawn(**ALL)
    assert any(alone)
    assert alone == [weather if weather and weather.kind == "fog" else None for weather in beside]


@pytest.mark.parametrize("shares", [{}, ALL, {"snow": 1.0}, {"fog": 0.02, "dust": 0.9}])
def test_every_kind_has_its_share(shares):
    counts = Counter(weather.kind for weather in drawn(**shares) if weather)
    for name in WEATHER_NAMES:
        share = shares.get(name, 0.0)
        assert abs(counts[name] - share * len(IMAGES)) <= 5.0 * math.sqrt(share * (1.0 - share) * len(IMAGES))


def test_wind_comes_from_all_sides_equally_at_any_speed():
    weathers = drawn(**ALL, wind_m_s=(2.0, 5.0))
    wind = np.array([weather.wind_m_s for weather in weathers if weather is not None and any(weather.wind_m_s)])
    speed, turn = np.hypot(*wind.T), np.arctan2(wind[:, 1], wind[:, 0])
    for some in (speed < 3.5, speed >= 3.5):
        sectors, n = np.histogram(turn[some], np.linspace(-np.pi, np.pi, 9))[0], some.sum()
        # Counts are binomial; five standard deviations.
        assert np.abs(sectors - n / 8).max() <= 5.0 * math.sqrt(n * 7 / 64)


def test_draws_are_within_the_config():
    weathers = [one for one in drawn(**ALL, wind_m_s=(2.0, 5.0), exposure_s=0.01) if one is not None]
    of = {kind: [one for one in weathers if one.kind == kind] for kind in WEATHER_NAMES}
    assert all(2.0 - 1e-8 <= math.hypot(*one.wind_m_s) <= 5.0 + 1e-8 for kind in WEATHER_NAMES[1:] for one in of[kind])
    assert {one.exposure_s for kind in WEATHER_NAMES[1:] for one in of[kind]} == {0.01}
    assert all(300.0 <= one.visibility_m <= 3000.0 for one in of["fog"])
    foggy = {(one.wind_m_s, one.rain_mm_h, one.ground_cover, one.vehicle_cover) for one in of["fog"]}
    assert foggy == {((0, 0), 0, 0, 0)}
    for one in of["rain"]:
        assert 2.0 <= one.rain_mm_h <= 50.0
        assert one.visibility_m == pytest.approx(float(rain_visibility_m(one.rain_mm_h)), abs=1e-8)
        assert one.ground_cover == one.vehicle_cover == pytest.approx(float(surface_wetness(one.rain_mm_h)), abs=1e-8)
    assert all(300.0 <= one.visibility_m <= 2000.0 and 0.3 <= one.ground_cover <= 1.0 for one in of["snow"])
    assert all(200.0 <= one.visibility_m <= 2000.0 and 0.1 <= one.vehicle_cover <= 0.8 for one in of["dust"])
    assert {one.rain_mm_h for kind in ("snow", "dust") for one in of[kind]} == {0.0}


def test_rain_and_snow_have_overcast_skies():
    light = small_config(light={"hdris": ["noon"], "overcast": ["gray*"]}).light
    assets = replace(ASSETS, hdris=("noon", "gray_one", "dusk", "gray_two"))
    weights = hdri_weights(light, assets.hdris)
    assert weights.tolist() == [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0]]
    weathers = drawn(rain=0.3, snow=0.3, dust=0.2)
    hdris = sample_light_columns(light, weathers, weights, assets=assets, draws=RandomStreams(5), image=IMAGES)["hdri"]
    kinds = [weather.kind if weather else "clear" for weather in weathers]
    assert {(kind, hdri) for kind, hdri in zip(kinds, hdris, strict=True)} == {
        *((kind, hdri) for kind in ("rain", "snow") for hdri in ("gray_one", "gray_two")),
        *((kind, "noon") for kind in ("clear", "dust")),
    }


@pytest.mark.parametrize(
    ("light", "message"),
    [
        ({"overcast": ["gray*"]}, "light.overcast: 'gray\\*' matches no HDRI"),
        ({"hdris": [{"name": "noon", "weight": 0}, "dusk"], "overcast": ["noon"]}, "light.overcast: all weights are 0"),
    ],
)
def test_a_missing_overcast_sky_is_reported(light, message):
    with pytest.raises(ConfigError, match=message):
        hdri_weights(small_config(light=light).light, ("noon", "dusk"))


@pytest.mark.parametrize(
    "wrong",
    [
        *({key: math.nan} for key in ("visibility_m", "rain_mm_h", "exposure_s", "ground_cover", "vehicle_cover")),
        *({"visibility_m": x} for x in (0.0, 2e9)),
        *({"wind_m_s": (0.0, x)} for x in (math.inf, -101.0)),
        *({"ground_cover": 1.5}, {"vehicle_cover": -0.1}, {"kind": "hail"}),
    ],
)
def test_weather_out_of_range_is_refused(wrong):
    with pytest.raises(ValueError, match="weather: expected one of fog, rain"):
        Weather(**{"visibility_m": 500.0, "kind": "rain", **wrong})


def test_every_target_has_the_least_contrast():
    thick = {"fog": 0.7, "visibility_m": [100.0, 200.0]}
    loose = list(plan(small_config(budget=BUDGET, weather={**thick, "min_contrast": 0.0}), ASSETS))
    rows = list(plan(small_config(budget=BUDGET, weather={**thick, "min_contrast": 0.2}), ASSETS))
    assert min(row.target.air_contrast for row in loose) < 0.2
    assert min(row.target.air_contrast for row in rows) >= 0.2
    assert len(rows) == len(loose)
    assert sum(row.rejected.get("faint", 0) for row in rows) > 0
    assert [row.weather for row in rows] == [row.weather for row in loose]


def test_a_least_contrast_that_no_camera_meets_is_an_error(monkeypatch):
    monkeypatch.setattr("hulldown.planning.search.positions.MAX_PLACES_WITHOUT_CAMERA", 2)
    config = small_config(budget=BUDGET, weather={"fog": 1.0, "visibility_m": [5.0, 6.0], "min_contrast": 0.5})
    with pytest.raises(ConfigError, match=r"100 % kept less contrast through the air than weather\.min_contrast"):
        list(plan(config, ASSETS))
