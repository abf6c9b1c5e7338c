import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.placement.footprint import MAX_LEAN_SLOPE, Underside, contact_footprint, underside_samples, vehicle_underside
from hulldown.tests.builders.shapes import box, plane_mesh, surface


def box_points(low, high, n=5):
    return np.stack(np.meshgrid(*np.linspace(low, high, n).T, indexing="ij"), -1).reshape(-1, 3)


HULL = box_points([-3.0, -1.7, 0.4], [3.0, 1.7, 1.4])


WHEELS = np.array([[x, y, 0.0] for x in (-1.5, 1.6) for y in (-0.8, 0.8)])
# One foot is lowest, the others are 8 cm higher: within a tenth of the height, but not within a twentieth.
UNEVEN = np.column_stack([WHEELS[:, :2], [0.0, 0.08, 0.08, 0.08]])
BELOW = [[-1.5, -0.8], [1.6, 0.8]]


@pytest.mark.parametrize(
    ("vertices", "footprint"),
    [
        pytest.param(np.concatenate([HULL, WHEELS]), BELOW, id="four wheels"),
        *((np.concatenate([HULL, UNEVEN]) + np.array([0.0, 0.0, z]), BELOW) for z in (0.0, -50.0)),
        pytest.param(np.concatenate([HULL, [[-2.9, 0.0, 0.3]]]), [[-3.0, -1.7], [3.0, 1.7]], id="a hook is no foot"),
        pytest.param([[0, 0, 1], [2, 3, 1]], [[0, 0], [2, 3]], id="a flat sheet"),
        pytest.param([[4, 5, 6]], [[4, 5], [4, 5]], id="a point"),
    ],
)
def test_the_footprint_is_what_is_low_and_wide_enough(vertices, footprint):
    np.testing.assert_allclose(contact_footprint(vertices), footprint)


def tank():
    """Two rails 0.6 m wide, and a hull between and above them."""
    rails = [box((-3.0, y - 0.3, 0.0), (3.0, y + 0.3, 0.6)) for y in (-1.3, 1.3)]
    return merge_meshes_with_sources([*rails, box((-3.4, -1.2, 0.45), (3.4, 1.2, 1.5))])[0]


def test_the_underside_is_low_at_the_tracks_and_high_between():
    seen = vehicle_underside(tank())
    np.testing.assert_array_equal(seen.box, [[-3.0, -1.6], [3.0, 1.6]])
    y = seen.box[0, 1] + (np.arange(seen.heights.shape[1]) + 0.5) * 3.2 / seen.heights.shape[1]
    np.testing.assert_array_equal(seen.heights[:, np.abs(y) > 1.03], 0.0)
    np.testing.assert_array_equal(seen.heights[:, np.abs(y) < 0.97], 0.45)


def test_a_barrel_outside_the_footprint_is_ignored():
    wheels = [box((x - 0.1, y - 0.1, 0.0), (x + 0.1, y + 0.1, 0.6)) for x in (-2.0, 2.0) for y in (-1.0, 1.0)]
    barrels = [box((2.5, -0.1, 1.7), (5.0, 0.1, 1.9)), box((-0.1, -5.0, 1.7), (0.1, -2.5, 1.9))]
    seen = vehicle_underside(merge_meshes_with_sources([*wheels, *barrels])[0])
    np.testing.assert_allclose(seen.box, [[-2.1, -1.1], [2.1, 1.1]])
    assert np.isin(seen.heights, [0.0, np.inf]).all()


@pytest.mark.parametrize("n", [301, 2])  # pieces shorter and longer than a cell
def test_a_sheet_on_its_edge_has_a_footprint(n):
    x = np.linspace(-2.0, 2.0, n)
    lying = [surface(x, np.array([0.0, 0.5]), np.full((n, 2), y)) for y in (-0.9, 0.9)]
    sheets = [Mesh(each.vertices[:, [0, 2, 1]], each.faces) for each in lying]
    seen = vehicle_underside(merge_meshes_with_sources([*sheets, box((-2.0, -0.9, 0.5), (2.0, 0.9, 1.0))])[0])
    assert not seen.heights[:, [0, -1]].any()
    assert (seen.heights[:, 1:-1] == 0.5).all()


def test_a_slanting_belly_has_the_height_of_its_plane():
    slant = np.array([0.1, -0.05])
    belly = plane_mesh(slant, 0.5, half=(3.0, 1.6))
    rails = [box((-3.0, y - 0.1, 0.0), (3.0, y + 0.1, 3.0)) for y in (-1.5, 1.5)]
    seen = vehicle_underside(merge_meshes_with_sources([belly, *rails])[0])
    cell = np.ptp(seen.box, axis=0) / 128
    middle = seen.box[0] + (np.indices((128, 128)).transpose(1, 2, 0) + 0.5) * cell
    between = np.abs(middle[0, :, 1]) < 1.35
    off = (seen.heights - (0.5 + middle @ slant))[:, between]
    # Some cells of the edge between the two triangles are lower there than in their centers.
    assert off.max() < 1e-12
    assert off.min() > -np.abs(slant) @ cell
    assert (np.abs(off) < 1e-12).mean() > 0.95


def test_both_edges_of_a_track_have_spots():
    at = underside_samples(vehicle_underside(tank()), 5)
    y = at.xy[:, 1].reshape(5, 5)
    np.testing.assert_allclose(y[2], [-1.6, -1.0, 0.0, 1.0, 1.6], atol=0.03)
    np.testing.assert_array_equal(at.height.reshape(5, 5)[2], [0.0, 0.0, 0.45, 0.0, 0.0])
    np.testing.assert_array_equal(at.foot.reshape(5, 5)[2], [True, True, False, True, True])
    np.testing.assert_array_equal(at.center, 0.0)


@pytest.mark.parametrize("n", [1, 2, 5, 7, 9])
def test_a_spot_is_as_low_as_the_geometry_around_its_point(n):
    rng = np.random.default_rng(n)
    seen = Underside(
        np.array([[-3.5, -1.75], [3.5, 1.75]]), rng.choice([0.0, 0.4, 0.9, np.inf], (128, 128), p=[0.01, 0.1, 0.79, 0.1])
    )
    at, share = underside_samples(seen, n), (np.arange(128) + 0.5) / 128
    nearest = np.rint(share * (n - 1)).astype(int)
    spread = np.hypot(7.0, 3.5) / max(n - 1, 1)
    height = at.height.reshape(n, n)[nearest[:, None], nearest]
    assert (height <= seen.heights + MAX_LEAN_SLOPE * spread).all()
