import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rigid_matrix, rotation_z, transform_points
from hulldown.placement.candidates import sample_candidates
from hulldown.placement.footprint import Underside, underside_samples
from hulldown.placement.settle import SettleRules, settle
from hulldown.placement.terrain import Terrain
from hulldown.plan.rejection import Rejection
from hulldown.tests.builders.shapes import plane_mesh
from hulldown.tests.placement.test_settle import TANK, height_field, placed

RULES = st.sampled_from(["averaged", "support"])
FIELDS = ("world_from_vehicle", "slope", "tilt", "share", "margin", "gap", "penetration", "rejection")


def finite(low, high):
    return st.floats(low, high, allow_subnormal=False)


def numbers(shape, low, high):
    """Arrays whose elements are all drawn."""
    return arrays(float, shape, elements=finite(low, high), fill=st.nothing())


def ground(heights, slope, z, *, half, grain):
    """A square of cells with heights that repeat, some grain, and a slope."""

    def height(x, y):
        i, j = np.indices(x.shape) % len(heights)
        return heights[i, j] + grain * np.random.default_rng(0).random(x.shape) + slope[0] * x + slope[1] * y + z

    return height_field(height, half, cell=1.0)


def grounds(*, relief=0.8, half=20.0, grains=(0.0, 0.1)):
    """Draw the ground; it shrinks to a level square."""
    heights = st.integers(1, 7).flatmap(lambda n: numbers((n, n), 0.0, relief))
    slope, grain = numbers(2, -0.3, 0.3), st.sampled_from(grains)
    return st.builds(ground, heights, slope, finite(-50, 50), half=st.just(half), grain=grain)


PLATE = np.stack([-TANK[:2], TANK[:2]]) / 2


GRAIN = np.random.default_rng(0).random((128, 128))


def underside(blocks, grain):
    """Feet at the corners, with steps and holes in between, some of them low."""
    heights = np.kron(blocks, np.ones((32, 32))) + grain * GRAIN
    for corner in np.ndindex(2, 2):
        heights[tuple(slice(-20, None) if c else slice(20) for c in corner)] = 0.0
    return Underside(PLATE, heights)


BLOCKS = arrays(float, (4, 4), elements=st.sampled_from([0.0, 0.1, 0.4, 0.8, np.inf]), fill=st.nothing())
UNDERSIDES = st.builds(underside, BLOCKS, st.sampled_from([0.0, 0.02]))


@st.composite
def spots(draw, *, least=1, most=12, half=16.0):
    """Positions (n, 2) up to `half` from the origin along each axis, and headings (n,)."""
    n = draw(st.integers(least, most))
    return draw(numbers((n, 2), -half, half)), draw(numbers(n, -math.pi, math.pi))


def headings(world_from_vehicle):
    forward = world_from_vehicle[:, :3, 0]
    return np.arctan2(forward[:, 1], forward[:, 0])


def turned_by(a, b):
    """Angle from b to a, in -pi..pi."""
    return np.angle(np.exp(1j * (a - b)))


@given(mesh=grounds(), where=spots(), rule=RULES, n=st.integers(2, 7))
def test_poses_are_rigid_keep_position_and_heading_and_are_upright(mesh, where, rule, n):
    xy, yaw = where
    settled = placed(Terrain(mesh), xy, yaw, rule=rule, n=n, max_slope=1.4, min_share=0.01)
    known = np.isfinite(settled.tilt)
    poses = settled.world_from_vehicle[known]
    rotation = poses[:, :3, :3]
    squares = rotation @ np.swapaxes(rotation, 1, 2)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
    np.testing.assert_array_equal(poses[:, :2, 3], xy[known])
    np.testing.assert_allclose(turned_by(headings(poses), yaw[known]), 0, atol=1e-14)
    np.testing.assert_allclose(np.arccos(rotation[:, 2, 2]), settled.tilt[known], atol=1e-7)


@given(
    gradient=numbers(2, -1, 1), z=finite(-100, 100), rule=RULES, n=st.integers(2, 6), where=spots(most=8, half=18.0)
)  # fmt: skip
def test_on_a_plane_there_is_no_gap_and_no_penetration(gradient, z, rule, n, where):
    mesh, (xy, yaw) = plane_mesh(gradient, z), where
    settled = placed(Terrain(mesh), xy, yaw, rule=rule, n=n, max_slope=1.2)
    assert settled.ok.all()
    assert settled.gap.max() < 1e-10
    assert settled.penetration.max() < 1e-10
    np.testing.assert_allclose(settled.world_from_vehicle[:, 2, 3], z + xy @ gradient, atol=1e-11)
    np.testing.assert_allclose(np.tan(settled.tilt), np.hypot(*gradient), atol=1e-11)


@given(
    mesh=grounds(half=12.0, grains=(0.1,)), where=spots(most=6, half=9.0), rule=RULES, turn=finite(-4, 4),
    scale=finite(0.01, 100), shift=numbers(3, -1e4, 1e4), small=st.none() | UNDERSIDES,
)  # fmt: skip
def test_poses_move_turn_and_scale_with_the_world(mesh, where, rule, turn, scale, shift, small):
    # Samples on an edge of the ground may fall to its other side, and equal heights to another contact.
    xy, yaw = where[0] + [0.137, 0.291], where[1]
    large = small and Underside(scale * small.box, scale * small.heights)
    here = placed(Terrain(mesh), xy, yaw, footprint=small, rule=rule)
    there_from_here = rigid_matrix(scale * rotation_z(turn), shift)
    moved = Mesh(transform_points(there_from_here, mesh.vertices), mesh.faces, "moved")
    moved_xy = transform_points(there_from_here, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]
    there = settle(Terrain(moved), scale * TANK, moved_xy, yaw + turn, footprint=large, rules=SettleRules(rule=rule))
    np.testing.assert_array_equal(there.rejection, here.rejection)
    expected = there_from_here @ here.world_from_vehicle
    expected[:, :3, :3] /= scale
    np.testing.assert_allclose(there.world_from_vehicle[:, :3, :3], expected[:, :3, :3], atol=1e-9 / min(scale, 1))
    np.testing.assert_allclose(there.world_from_vehicle[:, :3, 3], expected[:, :3, 3], atol=1e-9 * max(scale, 1))
    np.testing.assert_allclose(there.gap, scale * here.gap, atol=1e-9 * max(scale, 1), equal_nan=True)
    np.testing.assert_allclose(there.penetration, scale * here.penetration, atol=1e-9 * max(scale, 1), equal_nan=True)


@given(toward=finite(-4, 4), yaw=finite(-4, 4), degrees=finite(5, 60), steps=st.sampled_from([-8, 8]))
def test_the_slope_gate_equals_the_closed_form(toward, yaw, degrees, steps):
    limit = math.radians(degrees)
    # Eight float64 steps around the limit, for rounding of the tangent, the cross product, and its length.
    angle = limit + steps * np.spacing(limit)
    gradient = math.tan(angle) * np.array([math.cos(toward), math.sin(toward)])
    for rule in ("averaged", "support"):
        settled = placed(Terrain(plane_mesh(gradient, 0.0)), [[0.5, 0.25]], [yaw], rule=rule, max_slope=limit)
        # The rest plane is also checked, and may round to the other side where the ground passes.
        assert (settled.rejection[0] == Rejection.TOO_STEEP) == (steps > 0)


@given(mesh=grounds(relief=1.5), where=spots(least=2, most=16, half=20.0), rule=RULES, footprint=st.none() | UNDERSIDES)
def test_a_candidate_does_not_depend_on_others(mesh, where, rule, footprint):
    terrain, (xy, yaw) = Terrain(mesh), where
    together = placed(terrain, xy, yaw, footprint=footprint, rule=rule)
    for i in (0, len(xy) // 2, -1):
        alone = placed(terrain, xy[[i]], yaw[[i]], footprint=footprint, rule=rule)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[i], err_msg=name)


@given(mesh=grounds(), where=spots(most=10, half=20.0), rule=RULES, n=st.integers(2, 9))
def test_a_flat_underside_gives_the_bits_of_a_plate(mesh, where, rule, n):
    xy, yaw = where
    flat = Underside(PLATE, np.zeros((128, 128)))
    plate, level = (placed(Terrain(mesh), xy, yaw, footprint=f, rule=rule, n=n) for f in (PLATE, flat))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(plate, name), getattr(level, name), err_msg=name)


@given(mesh=grounds(), shape=UNDERSIDES, where=spots(most=8, half=12.0), rule=RULES, n=st.integers(2, 7))
def test_gap_and_penetration_are_those_of_the_posed_underside_and_it_rests_on_the_ground(mesh, shape, where, rule, n):
    terrain, (xy, yaw) = Terrain(mesh), where
    settled = placed(terrain, xy, yaw, footprint=shape, rule=rule, n=n, max_slope=1.4)
    measured, resting = (underside_samples(shape, side).with_finite_height() for side in (9, n))
    assert settled.ok.all()
    for i in np.flatnonzero(settled.ok):
        pose = settled.world_from_vehicle[i]

        def above_ground(xy, pose=pose):
            """Of the vehicle's plane z = 0, straight up: n . (p - origin) = 0."""
            return pose[2, 3] - (xy - pose[:2, 3]) @ pose[:2, 2] / pose[2, 2] - terrain.top_hits(xy).z

        points = transform_points(pose, np.column_stack([measured.xy, measured.height]))
        below = terrain.top_hits(points[:, :2]).z - points[:, 2]
        assert settled.penetration[i] == pytest.approx(max(0.0, below.max()), abs=1e-10)
        gap = above_ground(points[measured.foot, :2]).max()
        assert settled.gap[i] == pytest.approx(max(0.0, gap), abs=1e-10)
        if rule == "support":
            above = above_ground(xy[i] + resting.xy @ rotation_z(yaw[i])[:2, :2].T) + resting.height
            # Three contacts; fewer if one or two right below the center carry all.
            assert above.min() == pytest.approx(0.0, abs=1e-10)


def test_batches_change_nothing():
    mesh = height_field(lambda x, y: 0.8 * np.random.default_rng(5).random(x.shape) + 0.1 * x, cell=1.0)
    xy, yaw = sample_candidates(mesh.bounds, 6000, rng=np.random.default_rng(5), margin=1.0)
    many, few = placed(Terrain(mesh), xy, yaw), placed(Terrain(mesh), xy[-9:], yaw[-9:])
    np.testing.assert_array_equal(many.world_from_vehicle[-9:], few.world_from_vehicle)
    np.testing.assert_array_equal(many.rejection[-9:], few.rejection)
