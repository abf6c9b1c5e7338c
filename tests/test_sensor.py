"""Lens and sensor compared with closed forms and laboratory measurements of cameras."""

import numpy as np
import pytest
from scipy import ndimage

from hulldown.camera.sensor import Sensor
from hulldown.planning.appearance.light import draw_sensors
from hulldown.planning.config.sensor_section import PRESETS, SensorSection
from hulldown.planning.search.random_streams import RandomStreams
from hulldown.rendering.blender.sensor_simulation import BAND, WHITE, Lens, develop, read_out
from hulldown.tests.planning_assets import small_config


def developed(light, sensor, *, seed=0, threads=2):
    height, width = light.shape[:2]
    axis = (width / 2.0, height / 2.0)
    return develop(light, sensor, axis=axis, exposure_ev=0.0, seed=seed, view=lambda shown: shown, threads=threads)


def behind(light, sensor):
    """Light behind a lens."""
    height, width = light.shape[:2]
    lens = Lens.of(sensor, width, height, (width / 2.0, height / 2.0))
    bands = [slice(top, min(top + BAND, height)) for top in range(0, height, BAND)]
    return np.concatenate([lens.through(light.astype(np.float32), band) for band in bands])


@pytest.mark.parametrize(("gain", "read_noise_e"), [(1.0, 40.0), (6.0, 12.0)])
def test_a_photon_transfer_curve_has_the_gain_and_the_read_noise(gain, read_noise_e):
    sensor = Sensor(full_well_e=30_000.0, read_noise_e=read_noise_e, gain=gain)
    rng = np.random.default_rng(1)
    levels = WHITE * np.array([0.02, 0.03, 0.05, 0.1, 0.2, 0.4])
    fields = [read_out(np.full((600, 600, 3), level, np.float32), sensor, rng) for level in levels]
    mean = np.array([field.mean(dtype=np.float64) for field in fields])
    variance = np.array([field.var(dtype=np.float64) for field in fields])
    slope, offset = np.polyfit(mean, variance, 1, w=1.0 / variance)
    electrons = 1.0 / slope  # electrons of a unit of light
    assert mean == pytest.approx(levels, rel=1e-3)
    assert electrons == pytest.approx(30_000.0 / (gain * WHITE), rel=0.02)
    assert electrons * np.sqrt(offset) == pytest.approx(read_noise_e, rel=0.02)


@pytest.mark.parametrize(("blur_px", "aberration_px"), [(0.4, 0.0), (0.7, 0.5), (1.5, 0.0), (0.4, -2.0)])
def test_a_grating_has_the_contrast_of_the_point_spread_and_the_shift_of_the_aberration(blur_px, aberration_px):
    y, x = np.mgrid[:200, :320] + 0.5
    frequency = np.array([0.2, 0.1])  # cycles per pixel

    def grating(scale):
        across, down = 160.0 + (x - 160.0) / scale, 100.0 + (y - 100.0) / scale
        return np.sin(2.0 * np.pi * (frequency[0] * across + frequency[1] * down))

    light = 0.5 + 0.4 * np.repeat(grating(1.0)[..., None], 3, axis=2)
    shown = behind(light, Sensor(blur_px=blur_px, aberration_px=aberration_px))
    contrast = np.exp(-2.0 * (np.pi * blur_px) ** 2 * (frequency @ frequency))
    for channel, sign in enumerate((1.0, 0.0, -1.0)):
        expected = 0.5 + 0.4 * contrast * grating(1.0 + sign * aberration_px / np.hypot(160.0, 100.0))
        # A point spread wider by a fiftieth would miss by more.
        assert np.abs(shown[20:-20, 20:-20, channel] - expected[20:-20, 20:-20]).max() < 2e-3


def test_corners_darken_by_the_fourth_power_of_a_cosine():
    light = behind(np.ones((301, 401, 3)), Sensor(vignetting_ev=1.5))[..., 0]
    square = 0.25 * (301**2 + 401**2)
    y, x = np.mgrid[:301, :401]
    tangents = (2.0**0.75 - 1.0) * ((y - 150) ** 2 + (x - 200) ** 2) / square
    assert light == pytest.approx((1.0 + tangents) ** -2, rel=1e-5)
    assert light[150, 200] == pytest.approx(1.0)
    assert np.log2(light[0, 0]) == pytest.approx(-1.5, abs=0.02)


def test_without_effects_light_is_only_rounded():
    light = np.random.default_rng(3).uniform(-0.1, 1.1, (70, 33, 3)).astype(np.float32)
    assert np.array_equal(developed(light, Sensor()), np.rint(np.clip(light, 0.0, 1.0) * 255.0))


def test_noise_covers_the_picture_and_follows_from_the_seed():
    gray = np.full((130, 200, 3), 0.5, np.float32)
    sensor = Sensor(blur_px=0.6, aberration_px=0.4, full_well_e=10_000.0, gain=4.0, sharpening=0.5)
    one, again, other = (developed(gray, sensor, seed=seed, threads=n) for seed, n in ((1, 1), (1, 3), (2, 2)))
    assert np.array_equal(one, again)
    assert (one != other).mean() > 0.9
    tiles = one[:128, :192].astype(float).reshape(8, 16, 12, 16, 3).std(axis=(1, 3))
    assert tiles.max() < 1.5 * tiles.min()
    halves = [one[:64].ravel().astype(float), one[64:128].ravel().astype(float)]
    assert abs(np.corrcoef(halves)[0, 1]) < 0.03, "two bands of rows have the same noise"


def test_a_full_pixel_clips():
    sensor = Sensor(full_well_e=1000.0, read_noise_e=5.0)
    read = read_out(np.full((50, 50, 3), 2.0 * WHITE, np.float32), sensor, np.random.default_rng(0))
    assert read.min() == pytest.approx(WHITE)
    assert read.max() == pytest.approx(WHITE)


def test_sharpening_adds_the_difference_from_a_blurred_copy():
    light = np.random.default_rng(4).uniform(0.3, 0.7, (80, 90, 3)).astype(np.float32)
    kernel = np.outer([1, 2, 1], [1, 2, 1])[..., None] / 16.0
    blurred = ndimage.convolve(light, kernel, mode="nearest")
    wanted = np.clip(light + 0.8 * (light - blurred), 0.0, 1.0) * 255.0
    assert np.abs(developed(light, Sensor(sharpening=0.8)) - wanted).max() < 0.51


@pytest.mark.parametrize("preset", ["camera", "phone"])
def test_a_preset_sets_missing_values(preset):
    section = SensorSection.model_validate({"preset": preset, "gain": 3})
    assert section.gain == (3.0, 3.0)
    assert section.blur_px == PRESETS[preset]["blur_px"]
    image = np.arange(200)
    sensors = draw_sensors(section, draws=RandomStreams(5), image=image)
    assert sensors[20:30] == draw_sensors(section, draws=RandomStreams(5), image=image[20:30])
    low, high = section.jpeg_quality
    assert {sensor.jpeg_quality for sensor in sensors} == set(range(low, high + 1))
    assert {sensor.suffix for sensor in sensors} == {".jpg"}
    shifts = [sensor.aberration_px for sensor in sensors]
    assert min(shifts) < 0.8 * section.aberration_px[0] < 0.8 * section.aberration_px[1] < max(shifts)


def test_plans_without_a_sensor_are_unchanged():
    assert "sensor" not in small_config(sensor={}).model_dump()
    assert draw_sensors(SensorSection(), draws=RandomStreams(0), image=np.arange(3)) == [None] * 3
