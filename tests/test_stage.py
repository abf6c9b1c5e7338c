"""What planning builds once."""

from hulldown.planning.search.stage import make_stage
from hulldown.tests.planning_assets import small_assets, small_config


def test_ordinary_assets_make_a_stage():
    stage = make_stage(small_config(), small_assets())
    assert [site.name for site in stage.sites] == ["hills", "bare"]
    assert set(stage.models) == {"t72", "leo", "ural"}
