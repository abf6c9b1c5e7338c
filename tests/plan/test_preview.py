"""Pictures of a plan without Blender: positions, light, and the sheet."""

import numpy as np
import pytest
from PIL import Image

from hulldown.plan.pictures.preview import TILE_WIDTH, Artist, image_caption, write_preview_sheet
from hulldown.plan.pictures.shading import preview_sun_direction
from hulldown.planning.write import write_plan
from hulldown.tests.builders.plan_lines import altered
from hulldown.tests.builders.planning_assets import small_assets, small_config
from hulldown.weather.kinds import Weather

ASSETS = small_assets()


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    config = small_config(
        budget={"images_per_class": 3},
        weather={"fog": 0.5},
        placement={"vehicles_per_image": 2, "companion_distance": [30, 40]},  # some are out of the frame
        light={"strength": 1.0},
    )
    return write_plan(config, ASSETS, tmp_path_factory.mktemp("preview") / "plan.jsonl")


@pytest.fixture(scope="module")
def artist(plan):
    return Artist(plan, ASSETS)


def clear(row):
    return altered(row, weather=None)


def test_the_vehicle_is_where_its_box_is(plan, artist):
    row = altered(clear(plan[0]), companions=[])
    with_it = artist.shade(row, 160, 90)
    pose = row.target.world_from_vehicle.copy()
    pose[2, 3] += 500.0
    lifted = artist.shade(altered(row, target=altered(row.target, world_from_vehicle=pose)), 160, 90)
    changed = np.abs(lifted - with_it).max(axis=2) > 1e-9
    x, y, w, h = (v / 12 for v in row.target.bbox)
    inside = np.zeros((90, 160), dtype=bool)
    inside[int(y) : int(y + h) + 1, int(x) : int(x + w) + 1] = True
    # Outside the box only the dark shadow differs.
    assert (changed & inside).sum() > 0.2 * inside.sum()
    shadow = changed & ~inside
    assert (with_it[shadow].sum(axis=-1) < lifted[shadow].sum(axis=-1)).all()


def test_pictures_have_the_requested_size_and_valid_colors(plan, artist):
    for row in plan:
        image = artist.shade(row, 32, 18)
        assert image.shape == (18, 32, 3)
        assert (image >= 0.0).all()
        assert (image <= 1.0).all()


def test_fog_hides_distant_objects(plan, artist):
    row = plan[0]
    thick = artist.shade(altered(row, weather=Weather(visibility_m=1.0, kind="fog")), 64, 36)
    thin = artist.shade(clear(row), 64, 36)
    assert np.ptp(thick, axis=(0, 1)).max() < 0.05 < np.ptp(thin, axis=(0, 1)).max()


def test_the_sun_turns_with_the_hdri():
    a, b = preview_sun_direction("noon", 10.0), preview_sun_direction("noon", 100.0)
    assert a[0] * b[0] + a[1] * b[1] == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(a) == pytest.approx(1.0)


@pytest.mark.parametrize(("count", "shown"), [(5, 5), (100, 6)])
def test_the_sheet(plan, tmp_path, count, shown):
    assert any(row.companions[0].bbox is None for row in plan)
    path = tmp_path / "sheet.png"
    write_preview_sheet(plan, path, count=count, assets=ASSETS)
    with Image.open(path) as sheet:
        assert sheet.width > 4 * TILE_WIDTH
        pixels = np.asarray(sheet)
    second_row = np.array_split(pixels[len(pixels) // 2 :], 4, axis=1)
    assert [np.ptp(tile) > 100 for tile in second_row] == [True, shown == 6, False, False]
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


def test_a_caption_has_what_the_picture_cannot_show(plan):
    target = altered(plan[0].target, visible_fraction=0.5)
    row = altered(plan[0], weather=Weather(visibility_m=250.0, kind="fog"), target=target)
    words = image_caption(row)
    assert words.startswith(f"1: {row.target.vehicle} in {row.scenery}, ")
    assert words.endswith(f"50 % visible, {row.hdri}, fog 250 m")
