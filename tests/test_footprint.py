import numpy as np
import pytest

from placement.footprint import contact_footprint


def box_points(low, high, n=5):
    return np.stack(np.meshgrid(*np.linspace(low, high, n).T, indexing="ij"), -1).reshape(-1, 3)


HULL = box_points([-3.0, -1.7, 0.4], [3.0, 1.7, 1.4])
TRACKS = np.concatenate([box_points([-2.5, y - 0.3, 0.0], [2.4, y + 0.3, 0.9]) for y in (-1.4, 1.4)])
BARREL = box_points([1.0, -0.1, 1.7], [7.0, 0.1, 1.9])


def test_a_long_barrel_does_not_count():
    box = contact_footprint(np.concatenate([HULL, TRACKS, BARREL]))
    np.testing.assert_allclose(box, [[-2.5, -1.7], [2.4, 1.7]])


def test_four_wheels_span_the_footprint():
    wheels = np.array([[x, y, 0.0] for x in (-1.5, 1.6) for y in (-0.8, 0.8)])
    np.testing.assert_allclose(contact_footprint(np.concatenate([HULL, wheels])), [[-1.5, -0.8], [1.6, 0.8]])


def test_one_low_point_is_no_footprint():
    hook = np.array([[-2.9, 0.0, 0.3]])
    np.testing.assert_allclose(contact_footprint(np.concatenate([HULL, hook])), [[-3.0, -1.7], [3.0, 1.7]])


def test_a_flat_sheet_and_a_single_point_stand_on_all_they_have():
    np.testing.assert_array_equal(contact_footprint([[0, 0, 1], [2, 3, 1]]), [[0, 0], [2, 3]])
    np.testing.assert_array_equal(contact_footprint([[4, 5, 6]]), [[4, 5], [4, 5]])


@pytest.mark.parametrize(
    ("vertices", "band", "message"),
    [(np.zeros((0, 3)), 0.1, "vertices: expected at least one vertex"), (HULL, 0.0, "band, least: expected shares")],
)
def test_a_wrong_call_names_the_argument(vertices, band, message):
    with pytest.raises(ValueError, match=message):
        contact_footprint(vertices, band=band)
