import math

import numpy as np
import pytest

from hulldown.camera.framing import frame_target
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import project
from hulldown.camera.shell import camera_pose, draw_azimuth, draw_elevation

HD = Intrinsics(1920, 1080, math.radians(50))
CORNERS = np.array([[x, y, z] for x in (-3.5, 3.5) for y in (-1.7, 1.7) for z in (-1.2, 1.2)])
N = 500


def poses(elevation: tuple[float, float]) -> np.ndarray:
    rng = np.random.default_rng(11)
    distance, azimuth = rng.uniform(20, 80, N), draw_azimuth(N, rng=rng)
    return camera_pose([0, 0, 0], distance, azimuth, draw_elevation(N, elevation, rng=rng))


@pytest.mark.parametrize("band", [(0.0, 0.0), (0.1, 0.1), (0.2, 0.7), (0.0, 0.5), (0.9, 0.95)])
@pytest.mark.parametrize("elevation", [(0.0, 0.6), (1.3, math.pi / 2)])
def test_targets_are_cut_as_much_as_requested(band: tuple[float, float], elevation: tuple[float, float]) -> None:
    framed = frame_target(poses(elevation), CORNERS[None], HD, rng=np.random.default_rng(3), truncated=band)
    pixels = project(HD, framed, CORNERS).pixels
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    kept = np.clip(np.minimum(high, [1920, 1080]) - np.maximum(low, 0), 0, None)
    truncated = 1 - (kept / (high - low)).prod(axis=1)
    assert truncated.min() >= band[0] - 1e-4
    assert truncated.max() <= band[1] + 1e-4
    # The whole range is used.
    assert np.ptp(truncated) >= 0.9 * (band[1] - band[0])


def test_cuts_of_each_kind_are_as_frequent_as_their_area() -> None:
    # The reference: uniform positions in the plane, restricted to a narrow range of shares.
    size, extent = np.array([2000.0, 1000.0]), np.array([300.0, 500.0])
    rng = np.random.default_rng(0)
    place = rng.uniform(-extent, size, (2_000_000, 2))
    inside = np.clip(np.minimum(place + extent, size) - np.maximum(place, 0), 0, None) / extent
    cut = inside[np.abs(inside.prod(axis=1) - 0.4) < 0.005] < 1
    # With a long lens, an upright rectangle has the same image anywhere.
    lens = Intrinsics(2000, 1000, math.radians(0.2))
    corners = np.array([[0, y, z] for y in (-1.5, 1.5) for z in (-2.5, 2.5)])
    pose = np.tile(camera_pose([0, 0, 0], 20 / (2 * math.tan(math.radians(0.1))), 0.0, 0.0), (20_000, 1, 1))
    framed = frame_target(pose, corners[None], lens, rng=rng, truncated=(0.6, 0.6))
    pixels = project(lens, framed, corners).pixels
    out = (pixels.min(axis=1) < -0.1) | (pixels.max(axis=1) > size + 0.1)
    for kind in ([True, False], [False, True], [True, True]):
        expected = float((cut == kind).all(axis=1).mean())
        assert (out == kind).all(axis=1).mean() == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("cameras", [0, 1])
def test_cameras_inside_the_targets_box_are_unchanged(cameras: int) -> None:
    inside = camera_pose([0, 0, 0], np.ones(cameras), 0.3, 0.1)
    framed = frame_target(inside, CORNERS[None], HD, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(framed, inside)


@pytest.mark.parametrize(
    "options",
    [{"spread": 1.5}, {"truncated": (0.5, 0.2)}, {"truncated": (-0.1, 0.2)}, {"points_world": np.zeros((3, 8, 3))}],
)
def test_wrong_calls_are_refused(options: dict) -> None:
    (name,) = options
    arguments = {"points_world": CORNERS[None], **options}
    with pytest.raises(ValueError, match=f"{name}: expected"):
        frame_target(poses((0.0, 0.6)), intrinsics=HD, rng=np.random.default_rng(0), **arguments)
