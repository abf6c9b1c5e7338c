from fractions import Fraction
from operator import mul

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hulldown.geometry.predicates import exact_height_fractions, exact_upward_normals, orientation_sign


def exact_area(ax, ay, bx, by, px, py):
    """Twice the area of a triangle; positive if it's counterclockwise."""
    ax, ay, bx, by, px, py = map(Fraction, (ax, ay, bx, by, px, py))
    return (ax - px) * (by - py) - (ay - py) * (bx - px)


def exact_sign(*coordinates):
    return int(np.sign(exact_area(*coordinates)))


def sign(*coordinates):
    return int(orientation_sign(*(np.array([c]) for c in coordinates))[0])


@pytest.mark.parametrize(
    "coordinates",
    [
        (0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
        (0.0, 0.0, 1.0, 1.0, 0.5, 0.5),
        # One ulp off a diagonal.
        (12.0, 12.0, 24.0, 24.0, 0.5, np.nextafter(0.5, 1)),
        (12.0, 12.0, 24.0, 24.0, np.nextafter(0.5, 1), 0.5),
        # The plain float64 determinant has the wrong sign here.
        (7.2, 3.6, -7.5, 1.5, 154.2, 24.6),
        (-6.7, -6.4, 9.8, 8.1, -26.5, -23.8),
        # Differences that don't fit into float64.
        (1e16, 1.0, -1.0, 1e-16, 1.0, 3e-16),
        (0.1, 0.1, 1e7, 1e7, 1 / 3, 1 / 3),
        (0.1, 0.1, 1e7, 1e7, 1 / 3, np.nextafter(1 / 3, 0)),
        # Products that underflow.
        (5e-324, 0.0, 0.0, 5e-324, 0.0, 0.0),
        (1e-200, 1e-200, 3e-200, 3e-200, 2e-200, np.nextafter(2e-200, 0)),
        (1e-160, 0.0, 1e-170, 1e-310, 0.0, 0.0),
        # The largest allowed coordinates of terrain.
        (1e30, -1e30, -1e30, 1e30, 1.0, np.nextafter(-1.0, 0)),
    ],
)
def test_orientation_is_exact_where_float64_is_not(coordinates):
    assert sign(*coordinates) == exact_sign(*coordinates)


# A few numbers, so that points fall on lines, and their neighbors one ulp off.
NUMBERS = st.builds(
    lambda v, toward: float(np.nextafter(v, toward)) if toward is not None else v,
    st.sampled_from([0.0, 0.1, 0.2, 0.3, 1 / 3, 1.0, 2.0, 3.0, 5e5, 1e7, -1e7, 1e-7, 1e-160, 1e-300]),
    st.sampled_from([None, np.inf, -np.inf]),
)


@given(st.lists(st.tuples(*[NUMBERS] * 6), min_size=1, max_size=20))
def test_orientation_is_exact_in_batches(rows):
    expected = [exact_sign(*row) for row in rows]
    assert orientation_sign(*np.array(rows).T.copy()).tolist() == expected


@given(st.lists(st.tuples(*[NUMBERS] * 11), min_size=1, max_size=8))
def test_heights_are_exact_and_rounded_to_the_nearest_float64(rows):
    rows = [r for r in rows if exact_area(r[0], r[1], r[3], r[4], r[6], r[7])]
    corners = np.array([r[:9] for r in rows]).reshape(-1, 3, 3)
    x, y = np.array([r[9:] for r in rows]).reshape(-1, 2).T.copy()
    numerator, denominator = exact_height_fractions(corners, x, y) if rows else ([], [])
    for row, top, bottom in zip(rows, numerator, denominator, strict=True):
        (ax, ay, az, bx, by, bz, cx, cy, cz), p = map(Fraction, row[:9]), row[9:]
        opposite = [exact_area(bx, by, cx, cy, *p), exact_area(cx, cy, ax, ay, *p), exact_area(ax, ay, bx, by, *p)]
        assert bottom > 0
        assert Fraction(top, bottom) == sum(map(mul, opposite, (az, bz, cz))) / sum(opposite)


def test_normals_of_nearly_vertical_faces_keep_their_digits():
    corners = np.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1e-12, 0.0, 10.0]]])
    np.testing.assert_allclose(exact_upward_normals(corners), [[-1.0, 0.0, 1e-13]], rtol=1e-15)
    np.testing.assert_allclose(exact_upward_normals(corners[:, ::-1]), [[-1.0, 0.0, 1e-13]], rtol=1e-15)
