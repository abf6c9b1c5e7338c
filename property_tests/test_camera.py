"""Cameras in any case and in hard cases: poles, map coordinates, lenses of 0.1 and 179 degrees, one-pixel images."""

import math
from itertools import product

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import pan_center_to_pixel, turn_cameras_to_targets
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import solve_distance
from hulldown.tests.builders.cameras import unproject

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
widths = st.integers(1, 4096)
lenses = st.builds(
    lambda w, h, fov: Intrinsics(w, h, math.radians(fov)),
    widths,
    widths,
    st.one_of(st.floats(0.1, 179), st.sampled_from([0.1, 60.0, 179.0])),
)
centers = st.one_of(
    st.tuples(*[st.floats(-1000, 1000)] * 3), st.sampled_from([(0.0, 0.0, 0.0), (5e5, 5.4e6, 100.0), (1e7, -1e7, 0.0)])
).map(np.array)
azimuths = st.one_of(st.floats(0, 2 * math.pi), st.sampled_from([0.0, math.pi / 2, math.pi, 2 * math.pi]))
elevations = st.one_of(
    st.floats(-math.pi / 2, math.pi / 2), st.sampled_from([-math.pi / 2, math.pi / 2, 0.0, math.nextafter(math.pi / 2, 0)])
)
distances = st.floats(0.5, 1e5)
seeds = st.integers(0, 2**32 - 1)


def tables(rows: int, low: float, high: float, columns: int = 3) -> st.SearchStrategy[np.ndarray]:
    """(rows, columns) of numbers."""
    return arrays(float, (rows, columns), elements=st.floats(low, high, allow_subnormal=False))


def centered(points: np.ndarray) -> np.ndarray:
    return points - (points.min(axis=0) + points.max(axis=0)) / 2


def rounding(center: np.ndarray, lens: Intrinsics, distance: float) -> float:
    """Pixels by which rounding of world coordinates in float64 moves a point at this distance."""
    size = float(np.abs(center).max()) + distance
    return 1e-9 + 32 * np.finfo(float).eps * (size * lens.f_px / distance + lens.width + lens.height + lens.f_px)


@given(lenses, centers, distances, azimuths, elevations, tables(10, -1, 2, 2), tables(10, 0.1, 3, 1))
def test_unprojecting_inverts_projecting(
    lens: Intrinsics,
    center: np.ndarray,
    distance: float,
    azimuth: float,
    elevation: float,
    places: np.ndarray,
    depths: np.ndarray,
) -> None:
    camera = Cameras(lens, camera_pose(center, distance, azimuth, elevation))
    pixels, depth = places * [lens.width, lens.height], distance * depths[:, 0]
    points = unproject(camera, pixels, depth)
    again, same = camera.project(points)
    aside = np.abs((pixels - lens.center) / lens.f_px).max()
    far = np.abs(center).max() + depth.max() * (1 + aside)
    tolerance = 64 * np.finfo(float).eps * far
    np.testing.assert_allclose(same, depth, atol=tolerance)
    np.testing.assert_allclose(again, pixels, atol=float(lens.f_px / depth.min() * tolerance * (1 + aside)) + 1e-9)
    np.testing.assert_allclose(unproject(camera, again, same), points, atol=4 * tolerance)


# Targets of eight corners, moved a little, and points between them; the middle of their bounds is the origin.
clouds = st.builds(
    lambda size, moved, inner: centered(np.concatenate((CORNERS + moved, inner))) * size,
    st.tuples(*[st.floats(0.5, 5)] * 3), tables(8, -0.5, 0.5), tables(4, -1, 1),
)  # fmt: skip
places = st.one_of(st.just((0.5, 0.5)), st.tuples(*[st.floats(-0.5, 1.5)] * 2))


@given(lenses, centers, distances, azimuths, elevations, places)
def test_the_center_projects_to_the_framing_offset(
    lens: Intrinsics, center: np.ndarray, distance: float, azimuth: float, elevation: float, place: tuple
) -> None:
    pixel = np.array(place) * [lens.width, lens.height]
    camera = pan_center_to_pixel(Cameras(lens, camera_pose(center, distance, azimuth, elevation)), pixel)
    pose = camera.world_from_camera
    aside = 1 + float(np.abs((pixel - lens.center) / lens.f_px).max()) ** 2
    found = camera.project(center[None]).pixels[0]
    np.testing.assert_allclose(found, pixel, atol=aside * rounding(center, lens, distance))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-14)


@given(
    lenses, centers, azimuths, elevations, st.sampled_from(["height", "width", "diagonal", "area"]), clouds,
    st.tuples(*[st.floats(0, 1)] * 2), tables(6, 0.01, 1.5, 1),
)  # fmt: skip
def test_the_exact_distance_gives_the_exact_size(
    lens: Intrinsics, center: np.ndarray, azimuth: float, elevation: float, measure: str, points: np.ndarray,
    place: tuple, shares: np.ndarray,
) -> None:  # fmt: skip
    points = points + center
    camera = Cameras(lens, camera_pose(center, 10.0, azimuth, elevation))
    pose = pan_center_to_pixel(camera, np.array(place) * [lens.width, lens.height]).world_from_camera
    cameras = Cameras(lens, np.tile(pose, (6, 1, 1)))
    sizes = np.sort(shares[:, 0]) * lens.height
    wanted = sizes**2 if measure == "area" else sizes
    found = solve_distance(cameras, points[None], center=center, pixels=wanted, measure=measure)
    assert np.isfinite(found).all()
    assert (np.diff(found) <= 1e-9 * found[1:]).all()
    cameras.position[:] = center + (cameras.position - center) * found[:, None] / 10.0
    width, height = np.ptp(cameras.project(points).pixels, axis=1).T
    lengths = {"width": width, "height": height, "diagonal": np.hypot(width, height), "area": np.sqrt(width * height)}
    # A camera that almost touches the target loses digits by subtracting close numbers, mostly far from the origin.
    np.testing.assert_allclose(lengths[measure], sizes, rtol=1e-7 + 1e-8 * np.abs(center).max() ** 0.5)


ordinary = st.builds(lambda w, h, fov: Intrinsics(w, h, math.radians(fov)), *[st.integers(300, 4096)] * 2, st.floats(5, 85))


bands = st.tuples(*[st.floats(0, 1)] * 2).map(sorted) | st.just([1.0, 1.0])


@given(lenses | ordinary, st.floats(-1.5, 1.5), st.none() | st.floats(0, 0.05), st.floats(3, 100), bands, seeds)
def test_framed_cameras_cut_as_requested(
    lens: Intrinsics, elevation: float, below: float | None, lengths: float, band: list, seed: int
) -> None:
    rng, (least, most) = np.random.default_rng(seed), band
    if below is not None:  # just below the elevation from which horizons aren't kept level
        elevation = float(np.clip(math.acos(lens.sin_half_fov_x) - below, 0, 1.5))
    points = rng.uniform(-1, 1, (12, 3)) * [3.5, 1.7, 1.2]
    poses = camera_pose([0, 0, 0], 3.5 * lengths / min(1.0, *lens.half_tangents), rng.uniform(0, 6, 200), elevation)
    framed = turn_cameras_to_targets(Cameras(lens, poses), points[None], rng=rng, truncated=(least, most))
    pixels, size = framed.project(points).pixels, [lens.width, lens.height]
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    kept = np.clip(np.minimum(high, size) - np.maximum(low, 0), 0, None)
    np.testing.assert_array_equal(framed.position, poses[:, :3, 3])
    axes = framed.world_from_camera[:, :3, :3]
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-14)
    # With ordinary fields of view, a target that fits is cut exactly as requested, by shares from the whole band.
    fits = (high - low < size).all(axis=1)
    assume(lens.fov_x < 1.5 and lens.half_tangents[1] < math.tan(0.75) and fits.any())
    cut, slack = 1 - (kept / (high - low))[fits].prod(axis=1), 0.01 / (high - low).min()
    assert ((cut >= least - slack) & (cut <= min(most, 1 - 1e-6) + slack)).all()
    assert np.ptp(cut) >= 0.9 * (most - least) - slack or fits.sum() < 100
