"""What planning builds once: a vehicle that cannot fit a scenery is a mistake, said before anything is tried."""

from dataclasses import replace

import pytest

from geometry.errors import ConfigError
from planning.stage import make_stage
from tests.planning_assets import hills, small_assets, small_config, vehicle


def test_a_vehicle_larger_than_the_scenery_is_refused_by_name():
    assets = replace(small_assets(), vehicles={"t72": vehicle("t72", 25.0)})
    with pytest.raises(ConfigError, match=r"'t72' is 210 m long; in 'hills' vehicles are placed within 192 x 192 m"):
        make_stage(small_config(), assets)


def test_a_scenery_smaller_than_a_vehicle_is_refused_by_name():
    assets = replace(small_assets(), sceneries={"yard": hills("yard", size=9.0, trees=0)})
    with pytest.raises(ConfigError, match=r"in .yard. vehicles are placed within 7\.2 x 7\.2 m"):
        make_stage(small_config(), assets)


def test_ordinary_assets_make_a_stage():
    stage = make_stage(small_config(), small_assets())
    assert [site.name for site in stage.sites] == ["hills", "bare"]
    assert set(stage.models) == {"t72", "leo", "ural"}
