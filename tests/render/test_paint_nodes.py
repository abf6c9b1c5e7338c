"""Cycles renders paint on the right materials of an odd file, and on nothing else."""

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv
from scipy import ndimage

from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.base.errors import ConfigError
from hulldown.plan.coats import Coat
from hulldown.plan.library import load_library
from hulldown.planning.check import check_plan
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.blender_plans import draw, make_plan, run_script
from hulldown.tests.builders.plan_lines import altered
from hulldown.weather.kinds import Weather

pytestmark = pytest.mark.blender
RAIN = Weather(2000.0, "rain", 15.0, ground_cover=1.0, vehicle_cover=1.0)
SNOW = Weather(500.0, "snow", ground_cover=0.8, vehicle_cover=0.8)
BODY = ["Skin", "soil", "Gun", "Slot*", "stone"]
PAINT = {"materials": BODY, "colors": ["#c01010"]}
CONFIG = {
    "assets": {"vehicles": [{"path": "odd.blend", "category": "tank", "paint": PAINT}]},
    "budget": {"images_per_class": 1, "images_per_position": 1},
    "camera": {
        "target_fraction": [0.25, 0.3],
        "distance_factor": [0.7, 0.8],
        "elevation_deg": [10.0, 20.0],
        "visible_fraction": [0.95, 1.0],
        "framing": 0.0,
    },
    "placement": {"vehicles_per_image": [2, 2], "companion_distance": [8.0, 9.0]},
    "render": {"width": 144, "height": 81},
}


@pytest.fixture(scope="module")
def folder(own_worlds):
    run_script("painted_blends.py", own_worlds)
    return own_worlds


@pytest.fixture(scope="module")
def plan(folder):
    made = make_plan(folder, seed=5, **CONFIG)
    assert check_plan(made, load_library(made.config).assets) == []
    return made


def repainted(row, coats):
    """The row with other paint on its target."""
    return altered(row, target=altered(row.target, paint=coats))


@pytest.fixture(scope="module")
def row(plan):
    """The planned row, with its companion moved to the right of the target."""
    (other,) = plan[0].companions
    pose = plan[0].target.world_from_vehicle.copy()
    pose[:3, 3] += 7.0 * plan[0].world_from_camera[:3, 0]
    return altered(plan[0], companions=[altered(other, world_from_vehicle=pose)])


@pytest.fixture(scope="module")
def pictures(row, library, folder):
    """The row without paint, as planned, with a blue companion, with green tires, and without paint again."""
    red = row
    (other,) = red.companions
    blue = altered(other, paint=[Coat(BODY, "#1010c0")])
    bare = repainted(altered(red, companions=[altered(other, paint=[])]), [])
    tires = repainted(bare, [Coat(["Slot", "stone"], None), Coat(["Tire", "s*"], "#10c010")])
    return rendered([bare, red, altered(red, companions=[blue]), tires, bare], library, folder)


def rendered(rows, library, folder):
    """Pictures of rows, rendered by one worker."""
    return draw(folder, [(row, library) for row in rows], samples=8)


@pytest.fixture(scope="module")
def masks(row, library):
    """Masks of the target and of its companion, without their outermost pixels, which show some background."""
    world = Scene.from_scenery(library.assets.sceneries["field"])
    shape = VehicleCaster(library.shapes["odd"])
    return [
        ndimage.binary_erosion(
            whole_and_visible_masks(PosedVehicle(shape, v.world_from_vehicle[None], v.articulation), row.camera, world=world)[1]
        )
        for v in row.vehicles
    ]


def hues(picture):
    """Hues of pixels in degrees."""
    return 360.0 * rgb_to_hsv(picture / 255.0)[..., 0]


def is_hue(picture, wanted, within=25.0):
    colored = np.ptp(picture, axis=2) > 15.0
    return colored & (np.abs((hues(picture) - wanted + 180.0) % 360.0 - 180.0) < within)


def test_named_materials_are_painted_and_no_others(pictures, masks):
    bare, red, *_ = pictures
    tires = masks[0] & is_hue(bare, 45.0)
    body = masks[0] & ~is_hue(bare, 45.0, 40.0)
    assert tires.sum() > 30
    assert body.sum() > 300
    assert is_hue(red, 0.0)[body].mean() > 0.97
    assert not is_hue(bare, 0.0)[body].any()
    # The tires get red light from their surroundings.
    assert is_hue(red, 45.0, 30.0)[tires].mean() > 0.9


def test_paint_keeps_the_brightness_of_a_texture(pictures, masks):
    bare, red, *_ = pictures
    body = masks[0] & ~is_hue(bare, 45.0, 40.0)
    assert np.corrcoef(bare.max(axis=2)[body], red.max(axis=2)[body])[0, 1] > 0.7


def test_two_vehicles_of_one_file_have_different_paint_in_one_picture(pictures, masks):
    picture = pictures[2]
    first, second = masks
    assert is_hue(picture, 0.0)[first].mean() > 0.6
    assert is_hue(picture, 240.0)[first].mean() < 0.02
    assert is_hue(picture, 240.0)[second].mean() > 0.5
    assert is_hue(picture, 0.0)[second].mean() < 0.02


def test_the_scenery_keeps_its_colors(pictures, masks):
    bare, red, *_ = pictures
    far = ~ndimage.binary_dilation(masks[0] | masks[1], iterations=6)
    assert np.median(np.abs(bare - red)[far]) < 2.0
    assert (np.abs(bare - red)[far].max(axis=-1) > 40.0).mean() < 0.01


def test_a_material_keeps_its_own_color_if_the_first_coat_that_names_it_says_so(pictures, masks):
    bare, _, _, green, _ = pictures
    tires = masks[0] & is_hue(bare, 45.0)
    assert is_hue(green, 120.0)[tires].mean() > 0.9
    assert is_hue(green, 120.0)[masks[0]].mean() < 0.9
    assert np.median(np.abs(green - bare)[masks[0] & ~is_hue(green, 120.0)]) < 3.0


def test_the_next_picture_shows_no_earlier_paint(pictures):
    assert np.array_equal(pictures[0], pictures[4])
    assert not np.array_equal(pictures[0], pictures[1])


def test_rain_and_paint_do_not_affect_later_pictures(row, library, folder):
    """Paint is added to wet materials, and stays when they dry."""
    bare = repainted(altered(row, companions=[]), [])
    red = altered(row, companions=[])
    rows = [altered(bare, weather=RAIN), altered(red, weather=RAIN), red, altered(bare, weather=SNOW)]
    alone = [rendered([one], library, folder)[0] for one in rows]
    for found, expected in zip(rendered(rows, library, folder), alone, strict=True):
        assert np.array_equal(found, expected)
    assert not np.array_equal(alone[1], alone[2])


def test_inspect_lists_materials_and_their_shares(plan):
    report = load_library(plan.config).models["odd"].report
    assert {row.name for row in report.materials} == {"Skin", "soil", "Gun", "Slot", "Slot.001", "stone", "Tire"}
    assert sum(row.share for row in report.materials) == pytest.approx(1.0)
    (line,) = [line for line in report.lines() if line.startswith("materials: ")]
    assert "Tire (" in line


def test_a_pattern_of_paint_without_a_material_is_refused_by_name(folder):
    assets = {"vehicles": [{"path": "odd.blend", "category": "tank", "paint": {**PAINT, "materials": ["Skn"]}}]}
    with pytest.raises(ConfigError, match=r"'Skn' matches none of its materials: 'Skin', .*'Tire'"):
        make_plan(folder, seed=5, **{**CONFIG, "assets": assets})
