"""Water, snow, and dust on surfaces, in linear pictures by surface_pictures under an even white sky."""

import numpy as np
import pytest

pytestmark = pytest.mark.blender
SCRIPT = "surface_pictures.py"
SNOW_ALBEDO, DUST_ALBEDO = (0.80, 0.83, 0.86), (0.36, 0.28, 0.19)
NOISE = 0.01  # noise of a mean, from 16 samples a pixel and the snow's patches


def light(written, name):
    """Radiance (64, 64, 3); under this sky a matte surface's radiance is its albedo."""
    return np.load(written / f"{name}.npy").astype(np.float64)


def middle(written, name):
    return light(written, name)[16:48, 16:48].mean(axis=(0, 1))


@pytest.mark.parametrize(
    ("name", "dry", "wet"),
    [
        pytest.param("asphalt", 0.12, 0.08, id="asphalt as measured"),
        pytest.param("soil", 0.26, 0.16, id="moraine soil as measured"),
        pytest.param("grouped", 0.26, 0.16, id="soil, its shader inside a group"),
        pytest.param("mixed", 0.26, 0.16, id="soil, two shaders mixed"),
        pytest.param("matt", 0.26, 0.16, id="soil, a diffuse shader"),
    ],
)
def test_rain_darkens_porous_materials_as_measured(written, name, dry, wet):
    assert middle(written, f"{name} dry") == pytest.approx(dry, abs=0.005)
    assert middle(written, f"{name} wet") == pytest.approx(wet, abs=0.005)


@pytest.mark.parametrize("name", ["paint", "metal", "glass"])
def test_paint_metal_and_glass_keep_their_albedo_in_rain(written, name):
    assert middle(written, f"{name} wet") == pytest.approx(middle(written, f"{name} dry"), abs=0.002)


def test_every_material_can_get_wet(written):
    assert np.load(written / "left.npy").size == 0


@pytest.mark.parametrize("cover", [0.3, 1.0])
def test_snow_cover_follows_the_law_of_slopes(written, cover):
    """A ring of pixels of the dome, seen from above, has one slope. Cover is full up to 30 degrees, and 0 from 60."""
    white = light(written, f"dome {cover}") / SNOW_ALBEDO
    y, x = np.mgrid[:64, :64] + 0.5
    radius = np.hypot(x - 32, y - 32) / 32
    slope = np.degrees(np.arcsin(np.minimum(radius, 1.0)))
    for low in range(0, 80, 10):
        ring = (slope >= low) & (slope < low + 10) & (radius < 0.99)
        cosine = np.cos(np.radians(slope[ring]))
        x = np.clip((cosine - 0.5) / (np.cos(np.radians(30.0)) - 0.5), 0, 1)
        # With partial cover, drifts are as wide as the rings.
        law, abs_ = (cover * x * x * (3 - 2 * x)).mean(), 0.04 if cover == 1.0 else 0.1
        assert white[ring].mean() == pytest.approx(law, abs=abs_)


def test_snow_has_soft_edges(written):
    """1.5 m of half covered ground. With sharp edges, a fifth of it would be between bare and white."""
    white = light(written, "drifts").mean(axis=2) / np.mean(SNOW_ALBEDO)
    assert ((white > 0.15) & (white < 0.85)).mean() > 0.33


@pytest.mark.parametrize(
    ("place", "share"),
    [
        pytest.param("open", 1.0, id="level ground"),
        pytest.param("roofed", 0.0, id="ground under a roof"),
        pytest.param("wall", 0.0, id="wall"),
        pytest.param("lake", 0.0, id="water"),
    ],
)
def test_snow_covers_open_level_ground_only(written, place, share):
    assert middle(written, place) == pytest.approx(share * np.array(SNOW_ALBEDO), abs=2 * NOISE)


def test_holes_in_leaves_stay_open_under_snow(written):
    """Half of the card is holes that show the sky."""
    assert middle(written, "leaf") == pytest.approx(0.5 + 0.5 * np.array(SNOW_ALBEDO), abs=2 * NOISE)


@pytest.mark.parametrize(("car", "vehicle", "ground"), [("driven", 0.0, 1.0), ("parked", 1.0, 0.0)])
def test_vehicles_and_ground_have_separate_snow_cover(written, car, vehicle, ground):
    """Seen from above; both have a material of the same name."""
    picture = light(written, car)
    assert picture[28:36, 28:36].mean(axis=(0, 1)) == pytest.approx(vehicle * np.array(SNOW_ALBEDO), abs=NOISE)
    beside = picture[:4].mean(axis=(0, 1))  # 4 m from the box, which hides some sky
    assert beside == pytest.approx(ground * np.array(SNOW_ALBEDO), abs=0.06)


def test_dust_reaches_a_little_way_up_a_vehicle(written):
    """The black side of a box, 3 m high, seen level: 64 rows are 6 m, with the ground at row 48."""
    side = light(written, "dusty")[16:48, 24:40].mean(axis=1)[::-1]  # from the bottom up
    height = (np.arange(32) + 0.5) * 3 / 32
    assert side[(height > 1.5) & (height < 2.8)].max() < 1e-6
    low = side[height < 0.4].mean(axis=0)
    assert low / low.sum() == pytest.approx(np.array(DUST_ALBEDO) / sum(DUST_ALBEDO), abs=0.01)
    # Noise makes its edge ragged, so the test compares only halves.
    assert low.sum() > 2 * side[(height > 0.6) & (height < 1.2)].sum(axis=1).mean() > 0
