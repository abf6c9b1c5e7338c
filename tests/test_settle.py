import math

import numpy as np
import pytest

from geometry.meshes import Mesh
from placement.settle import settle
from placement.terrain import Terrain
from placement.verdict import Verdict

TANK = np.array([7.0, 3.5, 2.5])
RULES = ["averaged", "least_squares", "support"]


def height_field(height, half=20.0, cell=0.5):
    """A regular mesh of z = height(x, y) on a square."""
    x = np.linspace(-half, half, round(2 * half / cell) + 1)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    vertices = np.concatenate([grid, height(grid[..., 0], grid[..., 1])[..., None] + 0 * grid[..., :1]], axis=-1)
    i = np.arange(len(x) ** 2).reshape(len(x), len(x))
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return Mesh(vertices.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), "field")


def slope(angle, half=20.0):
    """Two triangles that rise along +x."""
    z = half * math.tan(angle)
    corners = [[-half, -half, -z], [half, -half, z], [half, half, z], [-half, half, -z]]
    return Terrain(Mesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]), "slope"))


@pytest.mark.parametrize("rule", RULES)
def test_on_a_slope_the_vehicle_lies_flat_on_it(rule):
    angle = math.radians(20)
    yaw = np.linspace(-3, 3, 7)
    settled = settle(slope(angle), TANK, np.tile([1.0, 2.0], (7, 1)), yaw, rule=rule)
    assert settled.ok.all()
    up = settled.world_from_vehicle[:, :3, 2]
    np.testing.assert_allclose(up, np.tile([-math.sin(angle), 0, math.cos(angle)], (7, 1)), atol=1e-14)
    np.testing.assert_allclose(settled.world_from_vehicle[:, :3, 3], [[1.0, 2.0, math.tan(angle)]] * 7, atol=1e-14)
    forward = settled.world_from_vehicle[:, :3, 0]
    np.testing.assert_allclose(np.arctan2(forward[:, 1], forward[:, 0]), yaw, atol=1e-14)
    np.testing.assert_allclose([settled.slope, settled.tilt], np.full((2, 7), angle), atol=1e-14)
    assert settled.gap.max() < 1e-13
    assert settled.penetration.max() < 1e-13
    assert (settled.share == 1).all()


def test_on_the_fallback_plane_it_stands_level():
    settled = settle(Terrain.flat(1.5), TANK, [[1e5, -3.0]], [0.0])
    assert settled.ok.all()
    level = [[1, 0, 0, 1e5], [0, 1, 0, -3], [0, 0, 1, 1.5], [0, 0, 0, 1]]
    np.testing.assert_array_equal(settled.world_from_vehicle[0], level)


def test_each_refusal_has_its_reason_and_leaves_what_was_not_reached_nan():
    ground = height_field(lambda x, y: np.where(x > 0, 4.0 * x, 0.0))
    xy = [[-10.0, 0.0], [10.0, 0.0], [100.0, 0.0], [-19.9, 0.0], [-0.2, 0.0]]
    settled = settle(Terrain(ground), TANK, xy, np.zeros(5))
    assert settled.verdict.tolist() == [
        Verdict.OK, Verdict.TOO_STEEP, Verdict.OFF_GROUND, Verdict.OVERHANG, Verdict.MEAN_TOO_STEEP,
    ]  # fmt: skip
    known = np.isfinite(settled.world_from_vehicle).all(axis=(1, 2))
    assert known.tolist() == [True, False, False, False, True]
    assert np.isfinite(settled.slope).tolist() == [True, True, False, True, True]
    assert np.isfinite(settled.gap).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize("rule", RULES)
def test_no_candidates_are_legal(rule):
    settled = settle(slope(0.1), TANK, np.zeros((0, 2)), np.zeros(0), rule=rule)
    assert settled.world_from_vehicle.shape == (0, 4, 4)
    assert settled.ok.shape == (0,)
