"""Exposure by the planned light, with the errors of a camera."""

import numpy as np
import pytest

from hulldown.assets.plan_assets import Assets
from hulldown.assets.skylight import SkyLight
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.camera.response import CARD_LEVEL, display_levels, gray_card_radiance
from hulldown.tests.builders.planning_assets import plan, small_assets, small_config

NIGHT = SkyLight((0.01, 0.012, 0.02), 12.5)
NOON = SkyLight((6.0, 6.2, 6.6), 1.0)
LIGHTS = {"noon": NOON, "dusk": NIGHT}


def lit() -> Assets:
    made = small_assets()
    return Assets(made.vehicles, made.categories, made.sceneries, made.hdris, skies=LIGHTS)


def rows(**light):
    return list(plan(small_config(light=light, budget={"images_per_class": 6}), lit()))


def test_a_gray_card_is_mid_gray_for_each_hdri_and_strength():
    for row in rows(exposure_error_ev=0.0, strength=[0.1, 10.0]):
        level = (
            display_levels(
                gray_card_radiance(np.array(lit().hdri_skylight(row.hdri).irradiance), row.strength) * 2.0**row.exposure_ev
            )
            @ LUMINANCE_WEIGHTS
        )
        assert level == pytest.approx(CARD_LEVEL, abs=0.01)


def test_exposure_errors_are_within_their_bounds_and_vary():
    exact, off = rows(exposure_error_ev=0.0), rows(exposure_error_ev=[-1.0, 0.5], white_balance_error_k=[-300, 600])
    errors = np.array([b.exposure_ev - a.exposure_ev for a, b in zip(exact, off, strict=True)])
    assert errors.min() >= -1.0
    assert errors.max() <= 0.5
    assert len(set(errors.round(3))) == len(errors)
    kelvins = [row.white_balance_k for row in off]
    assert -300 <= min(kelvins) < max(kelvins) <= 600
    assert {row.white_balance_k for row in exact} == {0.0}


def test_a_sky_without_light_has_the_longest_exposure():
    assert {row.exposure_ev for row in rows(strength=0.0, exposure_error_ev=0)} == {32.0}


def test_the_visible_sky_begins_at_its_hdris_horizon():
    assert {row.horizon_deg for row in rows()} == {None}
    assert {(row.hdri, row.horizon_deg) for row in rows(backdrop="sky")} == {("noon", 1.0), ("dusk", 12.5)}
