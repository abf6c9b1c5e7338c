import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.lenses import lenses


def test_equations_2_to_6_on_the_papers_image() -> None:
    hd = Intrinsics(1920, 1080, math.radians(60))
    assert hd.aspect == 16 / 9
    # Equation 3 by hand: 2 atan(tan(30 deg) * 9 / 16).
    assert math.degrees(hd.fov_y) == pytest.approx(35.98339777135764, abs=1e-12)
    assert hd.f_px == pytest.approx((1080 / 2) / math.tan(hd.fov_y / 2), rel=1e-15)
    # Equation 6 by hand: 2 m that shall fill 20 % of 1080 pixels, f = 960 / tan(30 deg).
    assert hd.distance_for(2.0, 0.2) == pytest.approx(2.0 * 960 * math.sqrt(3) / 216, rel=1e-15)


@pytest.mark.parametrize("fov_deg", [0.1, 1, 60, 120, 179])
def test_a_point_at_half_the_field_of_view_is_on_the_images_edge(fov_deg: float) -> None:
    camera = Intrinsics(1920, 1080, math.radians(fov_deg))
    assert camera.f_px * math.tan(camera.fov_x / 2) == pytest.approx(960, rel=1e-14)
    assert camera.f_px * math.tan(camera.fov_y / 2) == pytest.approx(540, rel=1e-12)
    assert camera.half_tangents == pytest.approx((960 / camera.f_px, 540 / camera.f_px), rel=1e-12)
    # A row writes 12 decimals.
    assert lenses(camera).fov_x_deg.round(12) == fov_deg
    record = {"width": 1920, "height": 1080, "fov_x_deg": fov_deg}
    assert Intrinsics.of_record(record) == camera == camera.resized(480, 270).resized(1920, 1080)


def test_a_row_of_cameras_as_arrays() -> None:
    lens = lenses([Intrinsics(100, 50, math.pi / 2), Intrinsics(200, 50, math.pi / 2)])
    np.testing.assert_allclose(lens.focal, [[50, 50], [100, 100]])
    assert lens.size.tolist() == [[100, 50], [200, 50]]
    np.testing.assert_allclose(lens.sin_half_fov_x, math.sin(math.pi / 4))
    assert lens.rows(np.array([1])).size.tolist() == [[200, 50]]
    assert lenses(lens) is lens
    assert [lenses([]).focal.shape, lenses([]).size.shape] == [(0, 2), (0, 2)]
    one = lenses(Intrinsics(4, 3, 1.0))
    assert [one.focal.shape, one.size.shape] == [(2,), (2,)]
    assert one.rows(np.array([0, 0])) is one


@pytest.mark.parametrize(
    ("width", "height", "fov_x", "message"),
    [
        (0, 10, 1.0, r"width: expected a whole number of pixels, at least 1, got 0"),
        (10, 0, 1.0, r"height: .*got 0"),
        (10, 10, 0.0, r"fov_x: expected radians between 0 and pi, got 0.0"),
        (10, 10, math.pi, r"fov_x"),
        (10, 10, 60.0, r"fov_x: expected radians"),
        (10, 10, math.nan, r"fov_x"),
    ],
)
def test_impossible_cameras_are_refused(width: int, height: int, fov_x: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Intrinsics(width, height, fov_x)


@pytest.mark.parametrize(("size", "fraction", "name"), [(0, 0.1, "size"), (1, 0, "target_fraction"), (1, -1, "target")])
def test_impossible_distances_are_refused(size: float, fraction: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}.*: expected positive numbers"):
        Intrinsics(10, 10, 1.0).distance_for(size, fraction)
