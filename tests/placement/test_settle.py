import math

import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.placement.footprint import vehicle_underside
from hulldown.placement.settle import SettleRules, settle
from hulldown.placement.terrain import Terrain
from hulldown.plan.rejection import Rejection
from hulldown.tests.builders.shapes import box, plane_mesh, surface
from hulldown.tests.placement.test_footprint import tank

TANK = np.array([7.0, 3.5, 2.5])
ORIGIN, AHEAD = np.zeros((1, 2)), np.zeros(1)


def height_field(height, half=20.0, cell=0.5):
    """A regular mesh of z = height(x, y) on a square."""
    x = np.linspace(-half, half, round(2 * half / cell) + 1)
    return surface(x, x, height(*np.meshgrid(x, x, indexing="ij")), "field")


def wheels(*axles):
    """A hull 0.6 m above the ground on narrow wheels."""
    on = [box((x - 0.1, y - 0.1, 0.0), (x + 0.1, y + 0.1, 0.6)) for x in axles for y in (-1.2, 1.2)]
    return merge_meshes_with_sources([*on, box((-3.0, -1.3, 0.6), (3.0, 1.3, 1.5))])[0]


def placed(terrain, xy=ORIGIN, yaw=AHEAD, *, footprint=None, **rules):
    """The tank settled, at the origin unless these are other places."""
    return settle(terrain, TANK, xy, yaw, footprint=footprint, rules=SettleRules(**rules))


SLOPE = Terrain(plane_mesh([math.tan(0.1), 0.0], 0.0))


def test_each_rejection_has_its_reason_and_later_fields_are_nan():
    ground = height_field(lambda x, y: np.where(x > 0, 4.0 * x, 0.0))
    xy = [[-10.0, 0.0], [10.0, 0.0], [100.0, 0.0], [-19.9, 0.0], [-0.2, 0.0]]
    settled = placed(Terrain(ground), xy, np.zeros(5))
    assert settled.rejection.tolist() == [
        Rejection.NONE, Rejection.TOO_STEEP, Rejection.OFF_GROUND, Rejection.OVERHANG, Rejection.MEAN_TOO_STEEP,
    ]  # fmt: skip
    known = np.isfinite(settled.world_from_vehicle).all(axis=(1, 2))
    assert known.tolist() == [True, False, False, False, True]
    assert np.isfinite(settled.slope).tolist() == [True, True, False, True, True]
    assert np.isfinite(settled.gap).tolist() == [True, False, False, False, False]


def nose_up(settled):
    return math.degrees(math.asin(settled.world_from_vehicle[0, 2, 0]))


@pytest.mark.parametrize(
    ("height", "n", "rest"),
    [
        (lambda x, y: np.where(x > 0.8, 0.5, 0.0), 9, math.degrees(math.atan(0.5 / 4.375))),
        (lambda x, y: -math.tan(math.radians(20)) * np.abs(x - 0.875), 9, 20.0),
        (lambda x, y: np.minimum(0, math.tan(math.radians(20)) * (np.abs(x - 1.5) - 1.5)), 8, 0.0),
    ],
    ids=["step", "ridge", "ditch"],
)
def test_the_support_plane_finds_the_rest_pose_that_the_average_misses(height, n, rest):
    terrain = Terrain(height_field(height, half=8, cell=0.05))
    support, averaged = (placed(terrain, rule=rule, n=n) for rule in ("support", "averaged"))
    # The reference rests on solid ground, whose edges are under samples.
    assert abs(nose_up(support) - rest) < 0.5
    assert abs(nose_up(averaged) - rest) > 1.5
    assert support.penetration[0] < 0.02 < averaged.penetration[0]


def test_the_margin_is_the_distance_of_the_center_from_the_contact_polygon():
    # Three cones as feet, under samples of 5 x 5: at the nose, and on both sides 1.75 m behind the center.
    def cones(x, y):
        return sum(np.maximum(0.0, 0.2 - np.hypot(x - a, y - b)) for a, b in ((3.5, 0), (-1.75, 1.75), (-1.75, -1.75)))

    terrain = Terrain(height_field(cones, half=8, cell=0.05))
    xy, yaw = [[0.0, 0.0], [0.0, 0.0], [-7.9, 0.0]], [0.0, math.pi, 0.0]
    settled = placed(terrain, xy, yaw)
    np.testing.assert_allclose(settled.margin[:2], 3.5 * 1.75 / math.hypot(5.25, 1.75), atol=1e-9)
    assert settled.rejection.tolist() == [Rejection.NONE, Rejection.NONE, Rejection.OVERHANG]
    assert np.isnan(settled.margin[2])
    assert np.isnan(placed(terrain, xy, yaw, rule="averaged").margin).all()


def test_bumps_between_the_rays_and_gaps_over_holes_are_limited():
    bump = Terrain(height_field(lambda x, y: 0.4 * np.exp(-(x**2 + (y - 0.44) ** 2) / 0.15**2), half=8, cell=0.05))
    hole = Terrain(height_field(lambda x, y: np.where(np.hypot(x - 2, y) < 0.9, -1.0, 0.0)))
    assert placed(bump).penetration[0] > 0.35
    assert placed(bump, max_penetration=0.3).rejection.tolist() == [Rejection.PENETRATION]
    np.testing.assert_allclose(placed(hole).gap, 1.0, atol=1e-9)
    assert placed(hole, max_gap=0.8).rejection.tolist() == [Rejection.GAP]


def test_the_footprint_can_be_off_the_origin():
    ground = Terrain(height_field(lambda x, y: 0.1 * x + np.where(x > 2.1, 5.0, 0.0)))
    whole = placed(ground)
    rear = placed(ground, footprint=[[-3.5, -1.75], [1.5, 1.75]])
    assert whole.rejection.tolist() == [Rejection.MEAN_TOO_STEEP]
    assert rear.ok.all()
    np.testing.assert_allclose(rear.world_from_vehicle[0, :3, 3], 0, atol=1e-12)


def test_a_ridge_that_fits_between_the_rails_does_not_lift_the_vehicle():
    # The sides of the ridge, 0.4 m high and 1 m wide, aren't slopes to refuse.
    ridge = Terrain(height_field(lambda x, y: np.maximum(0, 0.4 - 0.8 * np.abs(y)), half=8, cell=0.1))
    places, rails = ([[0.5, 0.0]] * 2, [0.0, math.pi]), vehicle_underside(tank())
    over_plate, over_rails = (placed(ridge, *places, footprint=f, max_slope=1.2) for f in (rails.box, rails))
    flat = placed(Terrain(0.0), *places, footprint=rails)
    np.testing.assert_allclose(over_plate.world_from_vehicle[:, 2, 3], 0.4, atol=1e-12)
    np.testing.assert_array_equal(over_rails.world_from_vehicle, flat.world_from_vehicle)
    for settled in (over_rails, flat):
        np.testing.assert_array_equal([settled.gap, settled.penetration], np.zeros((2, 2)))


def test_an_axle_between_the_samples_can_carry_the_vehicle():
    # A bump under both middle wheels, 0.75 m from samples of 5 x 5.
    six = vehicle_underside(wheels(-2.9, 0.75, 2.9))
    bump = Terrain(height_field(lambda x, y: np.where(np.abs(x - 0.75) < 0.25, 0.2, 0.0), half=8, cell=0.05))
    plate, seen = (placed(bump, footprint=f) for f in (six.box, six))
    assert plate.penetration[0] > 0.1
    assert seen.penetration[0] < 0.01
    assert seen.world_from_vehicle[0, 2, 3] > 0.14


@pytest.mark.parametrize("corners", [[(-2, 1.5), (2, 1.5), (-2, -1.5)], [(-2, -1), (2, 1.5), (-2, -1.5)]])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_triangular_footprint_rests_in_either_direction(corners, mirror):
    # The center of its bounding box is on the long side of one and outside the other; neither found a place.
    base = np.array(corners, dtype=float) * [1.0, mirror]
    vertices = np.concatenate([np.column_stack([base, np.full(3, z)]) for z in (0.0, 1.0)])
    walls = [side for i, j in ((0, 1), (1, 2), (2, 0)) for side in ([i, j, 3 + j], [i, 3 + j, 3 + i])]
    wedge = vehicle_underside(Mesh(vertices, np.array([[0, 2, 1], [3, 4, 5], *walls]), "wedge"))
    settled = settle(SLOPE, [4.0, 3.0, 1.0], [[0.0, 0.0]] * 3, [0.0, 1.0, 2.5], footprint=wedge)
    assert settled.ok.all()
    np.testing.assert_allclose(settled.tilt, 0.1, atol=1e-12)
