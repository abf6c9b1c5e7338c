import math

import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.lenses import lenses


def test_equations_2_to_6_for_the_papers_image() -> None:
    hd = Intrinsics(1920, 1080, math.radians(60))
    assert hd.aspect == 16 / 9
    # Equation 3 by hand: 2 atan(tan(30 deg) * 9 / 16).
    assert math.degrees(hd.fov_y) == pytest.approx(35.98339777135764, abs=1e-12)
    assert hd.f_px == pytest.approx((1080 / 2) / math.tan(hd.fov_y / 2), rel=1e-15)
    # Equation 6 by hand: 2 m at 20 % of 1080 pixels, f = 960 / tan(30 deg).
    assert hd.distance_for(2.0, 0.2) == pytest.approx(2.0 * 960 * math.sqrt(3) / 216, rel=1e-15)


@pytest.mark.parametrize("fov_deg", [0.1, 1, 60, 120, 179])
def test_a_point_at_half_the_field_of_view_is_at_the_images_edge(fov_deg: float) -> None:
    camera = Intrinsics(1920, 1080, math.radians(fov_deg))
    assert camera.f_px * math.tan(camera.fov_x / 2) == pytest.approx(960, rel=1e-14)
    assert camera.f_px * math.tan(camera.fov_y / 2) == pytest.approx(540, rel=1e-12)
    assert camera.half_tangents == pytest.approx((960 / camera.f_px, 540 / camera.f_px), rel=1e-12)
    # A row has 12 decimals.
    assert lenses(camera).fov_x_deg.round(12) == fov_deg
    record = {"width": 1920, "height": 1080, "fov_x_deg": fov_deg}
    assert Intrinsics.of_record(record) == camera == camera.resized(480, 270).resized(1920, 1080)


@pytest.mark.parametrize(
    ("width", "fov_x", "name"),
    [(0, 1.0, "width"), *((10, fov_x, "fov_x") for fov_x in (0.0, math.pi, 60.0, math.nan))],
)
def test_impossible_cameras_are_refused(width: int, fov_x: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Intrinsics(width, 10, fov_x)


@pytest.mark.parametrize(("size", "fraction", "name"), [(0, 0.1, "size"), (1, -1, "target_fraction")])
def test_impossible_distances_are_refused(size: float, fraction: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected positive numbers"):
        Intrinsics(10, 10, 1.0).distance_for(size, fraction)
