"""Rain and snow in front of a camera: number, size, and speed of drops by their laws, and the share that they hide."""

import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.weather.kinds import air_extinction
from hulldown.weather.precipitation import (
    FARTHEST_M,
    MAX_DROPS,
    NEAREST_M,
    Drops,
    precipitation_view,
    rain_sizes,
    sample_drops_in_view,
    snow_sizes,
    streak_quads,
)

AHEAD = np.array([[0.0, 0.0, 1.0, 5.0], [-1.0, 0.0, 0.0, 6.0], [0.0, -1.0, 0.0, 7.0], [0.0, 0.0, 0.0, 1.0]])


def view(width=1280, exposure_s=0.004, fov_x_deg=50.0):
    return precipitation_view(AHEAD, Intrinsics(width, width * 9 // 16, math.radians(fov_x_deg)), exposure_s)


def drawn(sizes, seen, wind=(0.0, 0.0), seed=3):
    return sample_drops_in_view(sizes, seen, wind, seed=seed)


def middle(sizes):
    return (sizes.edges[1:] + sizes.edges[:-1]) / 2.0


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
def test_rain_has_the_extinction_and_about_the_rate_of_its_law(rate):
    sizes = rain_sizes(rate)
    area, volume = np.pi / 4.0 * middle(sizes) ** 2, np.pi / 6.0 * middle(sizes) ** 3
    # Drops below 0.3 mm are left out.
    assert 2.0 * sizes.number @ area * 1000.0 == pytest.approx(0.365 * rate**0.63, rel=0.13)
    # Marshall and Palmer's intercept is a round number, so their law has this error.
    assert sizes.number * volume @ sizes.fall * 3.6e6 == pytest.approx(rate, rel=0.2)


@pytest.mark.parametrize(("diameter", "speed"), [(1.0, 4.03), (2.0, 6.49), (3.0, 8.06), (5.0, 9.09)])
def test_drops_fall_as_gunn_and_kinzer_measured(diameter, speed):
    sizes = rain_sizes(10.0)
    assert np.interp(diameter / 1000.0, middle(sizes), sizes.fall) == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize("visibility", [100.0, 1000.0])
def test_flakes_dim_the_air_over_the_visible_distance(visibility):
    sizes = snow_sizes(air_extinction(visibility))
    assert 2.0 * sizes.number @ (np.pi / 4.0 * middle(sizes) ** 2) == pytest.approx(air_extinction(visibility))
    assert 0.7 < sizes.fall.min() < sizes.number @ sizes.fall / sizes.number.sum() < 1.0


def test_density_and_size_of_drops_equal_those_in_the_air():
    """Drops of 3 mm or more within 5 m, in a long exposure, compared with the integral of their law there."""
    seen = view(exposure_s=0.01)
    drops = [drawn(rain_sizes(50.0), seen, seed=seed) for seed in range(12)]
    local = np.concatenate([d.centers for d in drops]) @ AHEAD[:3, :3]
    diameters = np.concatenate([d.diameters for d in drops])
    inside = (np.abs(local[:, :2]) < local[:, 2:] * seen.half).all(axis=1)
    volume = 12 * 4.0 / 3.0 * math.prod(seen.half) * (5.0**3 - 2.0**3)
    slope = 4.1 * 50.0**-0.21
    for low, high in ((3.0, 3.5), (3.5, 4.5), (4.5, 6.0)):
        of_size = (diameters >= low / 1000.0) & (diameters < high / 1000.0)
        found = np.count_nonzero(inside & (local[:, 2] > 2.0) & (local[:, 2] < 5.0) & of_size)
        expected = volume * 8000.0 / slope * (math.exp(-slope * low) - math.exp(-slope * high))
        assert expected > 50
        assert abs(found - expected) < 4.0 * math.sqrt(expected)
    # Uniform in space: as many on the left as on the right, above as below.
    assert np.abs(np.sign(local[inside, :2]).mean(axis=0)).max() < 4.0 / math.sqrt(np.count_nonzero(inside))


def test_drops_outside_the_frame_reach_into_it_with_their_streaks():
    seen = view(exposure_s=0.03)
    centers = [drawn(rain_sizes(50.0), seen, seed=seed).centers for seed in range(12)]
    local = np.concatenate(centers) @ AHEAD[:3, :3]
    assert np.abs(local[:, 1] / local[:, 2]).max() > 1.5 * seen.half[1]


@pytest.mark.parametrize("wind", [(0.0, 0.0), (0.0, 6.0), (5.0, 0.0)])
def test_a_streak_is_as_long_as_its_drop_moves_and_as_wide_as_the_drop(wind):
    seen = view(width=100_000, exposure_s=0.03)
    drops = drawn(rain_sizes(50.0), seen, wind)
    made = streak_quads(drops, seen)
    assert np.array_equal(made.gain, np.ones(len(made.gain)))
    along = (made.vertices[:, 3] + made.vertices[:, 2] - made.vertices[:, 1] - made.vertices[:, 0]) / 2.0
    across = made.vertices[:, 1] - made.vertices[:, 0]
    toward = drops.centers / np.linalg.norm(drops.centers, axis=1, keepdims=True)
    way = drops.velocities * seen.exposure_s
    way -= np.sum(way * toward, axis=1, keepdims=True) * toward
    wide = math.sqrt(2.0) * drops.diameters
    assert np.allclose(np.linalg.norm(across, axis=1), wide, rtol=1e-6, atol=0.0)
    assert np.allclose(along, way * (1.0 + wide / np.linalg.norm(way, axis=1))[:, None], rtol=1e-6, atol=1e-9)
    assert np.allclose(made.vertices.mean(axis=1), drops.centers, atol=1e-9)


@pytest.mark.parametrize("width", [64, 320, 1920])
def test_a_thin_streak_fades_and_hides_as_much_as_its_drop(width):
    """What a quad's moving disc hides on average over the shutter time equals a drop's area for any image size."""
    seen = view(width)
    drops = Drops(np.array([[4.0, 0.3, 0.2]]), np.array([0.0015]), np.array([[0.0, 1.0, -5.0]]))
    made = streak_quads(drops, seen)
    (right, top, way), steps = made.profile[0, 2], (np.arange(120) + 0.5) / 60.0 - 1.0
    u, v, center = np.meshgrid(right * steps, top * steps, way * steps)
    disc = np.maximum(1.0 - u**2 - (v - center) ** 2, 0.0)
    sides = [np.linalg.norm(made.vertices[0, i] - made.vertices[0, 0]) for i in (1, 3)]
    hidden = disc.mean() * math.prod(sides) * made.gain[0]
    assert hidden == pytest.approx(np.pi / 4.0 * 0.0015**2, rel=0.01)
    assert sides[0] >= 1.5 * seen.pixel * 4.0


def test_a_drop_that_moves_toward_the_camera_is_a_disc():
    made = streak_quads(Drops(np.array([[3.0, 0.0, 0.0]]), np.array([0.02]), np.array([[-5.0, 0.0, 0.0]])), view())
    assert np.isfinite(made.vertices).all()
    assert np.ptp(made.vertices[0], axis=0) == pytest.approx([0.0] + [0.02 * math.sqrt(2.0)] * 2, rel=2e-3, abs=1e-9)


@pytest.mark.parametrize(("fov_x_deg", "exposure_s"), [(0.1, 0.004), (50.0, 1e-4), (50.0, 10.0), (179.0, 0.004)])
@pytest.mark.parametrize("sizes", [rain_sizes(0.0), rain_sizes(1000.0), snow_sizes(4.0), snow_sizes(4e-9)])
def test_a_view_has_a_limited_number_of_drops(sizes, fov_x_deg, exposure_s):
    seen = view(1920, exposure_s, fov_x_deg)
    drops = drawn(sizes, seen, (100.0, -100.0))
    assert len(drops.diameters) <= MAX_DROPS + 6.0 * math.sqrt(MAX_DROPS)
    depth = drops.centers @ AHEAD[:3, 2]
    assert ((depth >= NEAREST_M * (1 - 1e-6)) & (depth <= FARTHEST_M * (1 + 1e-6))).all()
    assert np.isfinite(streak_quads(drops, seen).vertices).all()
