"""A picture doesn't depend on what its Blender rendered before."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from hulldown.tests.builders.blender_plans import draw, make_plan
from hulldown.tests.builders.plan_lines import altered
from hulldown.tests.builders.render_plans import moved
from hulldown.weather.kinds import Weather

pytestmark = pytest.mark.blender
SCRIPT = "hdri_files.py"
WEATHER = (
    None,
    Weather(800.0, "rain", rain_mm_h=10.0, ground_cover=1.0, vehicle_cover=1.0),
    Weather(800.0, "snow", ground_cover=0.8, vehicle_cover=0.5),
    Weather(800.0, "dust", ground_cover=0.5, vehicle_cover=0.5),
)


@pytest.fixture(scope="module")
def plan(own_worlds, written):
    for name in ("rec709.exr", "acescg.exr"):
        shutil.copy(written / name, own_worlds)
    return make_plan(
        own_worlds,
        seed=5,
        assets={"hdris": ["gray.exr", "sky.exr", "rec709.exr", "acescg.exr"]},
        budget={"images_per_class": 4, "images_per_position": 1},
        placement={"vehicles_per_image": 2, "companion_distance": [9.0, 20.0]},
    )


def with_copies(library, folder, *, tank, other="0"):
    """The library with separate files for the vehicles `tank` and `other`, so that Blender loads both."""
    exported, assets = library.models["tank"], library.assets
    for name in (tank, other):
        shutil.copy(exported.tidy, folder / f"{name}.blend")
    return replace(
        library,
        assets=replace(assets, distractors={"other": assets.vehicles["tank"]}),
        models={name: moved(exported, folder / f"{of}.blend") for name, of in (("tank", tank), ("other", other))},
    )


@pytest.mark.parametrize("company", [False, True])
def test_a_vehicle_looks_the_same_after_many_others(plan, library, tmp_path, company):
    """There are more vehicles than Blender keeps in memory."""
    row = next(row for row in plan if row.companions)
    row = altered(row, companions=[altered(row.companions[0], vehicle="other")] if company else [])
    order = [*range(9), 0]
    turns = [(row, with_copies(library, tmp_path, tank=str(i), other=str((i + 1) % 9))) for i in order]
    first, *others = draw(tmp_path, turns)
    assert all(np.array_equal(first, other) for other in others)


def test_a_sky_looks_the_same_after_a_wider_one(plan, library, tmp_path):
    """Cycles kept the importance map's width of the sky before; sky.exr is four times as wide as gray.exr."""
    turns = [(altered(plan[0], hdri=hdri, strength=1.0), library) for hdri in ("gray", "sky", "gray")]
    gray, sky, gray_again = draw(tmp_path, turns)
    (sky_first,) = draw(tmp_path, turns[1:2])
    assert np.array_equal(sky, sky_first)
    assert np.array_equal(gray, gray_again)


def test_a_sky_is_read_in_the_color_space_of_its_file(plan, library, tmp_path):
    """Two files with the same light in different color spaces give the same picture, in any order."""
    hdris = ("gray", "acescg", "rec709", "acescg")
    gray, *tinted = draw(tmp_path, [(altered(plan[0], hdri=hdri, strength=1.0), library) for hdri in hdris], as_planned=False)
    for picture in tinted:
        assert np.abs(picture - tinted[0]).max() <= 1.0
        assert np.abs(picture - gray).mean() > 10.0


def test_weather_looks_the_same_after_other_weather_and_vehicles(plan, library, tmp_path):
    """Unloading a vehicle keeps the weather's node groups, and clear air before and after weather shows none of it."""
    row = altered(plan[0], companions=[])
    files = [with_copies(library, tmp_path, tank=str(i)) for i in range(2)]
    turns = [(altered(row, weather=weather), of) for weather in WEATHER for of in files]
    pictures = draw(tmp_path, turns + turns[::-1])
    assert all(np.array_equal(*pair) for pair in zip(pictures, reversed(pictures), strict=True))
    assert len({picture.tobytes() for picture in pictures}) == len(WEATHER)


def test_a_shot_looks_the_same_after_others_of_its_position(plan, library, tmp_path):
    """Blender keeps what the next shot shares; every shot here differs from the one before in one thing."""
    row = altered(plan[0], companions=[])
    pose = row.world_from_camera.copy()
    pose[:3, 3] += pose[:3, 0]
    changes = {}, {"exposure_ev": row.exposure_ev - 1.0}, {"world_from_camera": pose}
    turns = [(altered(row, **change), library) for change in changes]
    pictures = draw(tmp_path, turns + turns[::-1])
    assert all(np.array_equal(*pair) for pair in zip(pictures, reversed(pictures), strict=True))
    assert len({picture.tobytes() for picture in pictures}) == len(turns)
