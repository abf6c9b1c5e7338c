import math

import numpy as np

from hulldown.geometry.transforms import (
    compose,
    facing,
    invert_affine,
    invert_rigid,
    rigid,
    rotate,
    rotation_about,
    rotation_z,
    tilt_to,
)
from hulldown.tests.shapes import random_rotations


def some_ups():
    up = np.random.default_rng(1).normal([0, 0, 1], size=(50, 3))
    up[:, 2] = np.abs(up[:, 2])
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(rotation_z(math.pi / 2), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-16)
    np.testing.assert_allclose(rotation_about([0.0, 0.0, 1.0], 0.3), rotation_z(0.3), atol=1e-16)


def test_a_tiny_turn_keeps_its_digits():
    turn = rotation_about([1.0, 0.0, 0.0], 1e-9)
    np.testing.assert_allclose(turn[1, 2], -1e-9, rtol=1e-15)
    assert turn[1, 1] == 1.0


def test_inverses_of_rigid_transforms():
    rng = np.random.default_rng(2)
    pose = rigid(random_rotations(rng, 20), rng.uniform(-1e6, 1e6, (20, 3)))
    np.testing.assert_allclose((invert_rigid(pose) @ pose)[:, :3, :3], np.tile(np.eye(3), (20, 1, 1)), atol=1e-14)
    np.testing.assert_allclose((invert_rigid(pose) @ pose)[:, :3, 3], 0, atol=1e-8)


def test_the_smallest_tilt_turns_about_a_level_axis():
    up = some_ups()
    tilt = tilt_to(up)
    np.testing.assert_allclose(tilt[:, :, 2], up, atol=1e-15)
    np.testing.assert_allclose(tilt @ np.swapaxes(tilt, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    level = np.stack([-up[:, 1], up[:, 0], np.zeros(50)], axis=1)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", tilt, level), level, atol=1e-14)


def test_facing_keeps_the_heading_where_the_smallest_tilt_does_not():
    up, yaw = some_ups(), np.linspace(-3.1, 3.1, 50)
    turn = facing(yaw, up)
    np.testing.assert_array_equal(turn[:, :, 2], up)
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(turn), 1, atol=1e-14)
    np.testing.assert_allclose(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), yaw, atol=1e-13)
    smallest = tilt_to(up) @ rotation_z(yaw)
    drift = np.arctan2(smallest[:, 1, 0], smallest[:, 0, 0]) - yaw
    assert np.abs(np.angle(np.exp(1j * drift))).max() > 0.1


def test_products_written_out_equal_matrix_products():
    rng = np.random.default_rng(5)
    c_from_b, b_from_a = np.tile(np.eye(4), (2, 7, 1, 1))
    c_from_b[:, :3], b_from_a[:, :3] = rng.normal(size=(2, 7, 3, 4))
    assert np.allclose(compose(c_from_b, b_from_a), c_from_b @ b_from_a, rtol=0, atol=1e-14)
    assert np.allclose(invert_affine(b_from_a) @ b_from_a, np.eye(4), rtol=0, atol=1e-12)
    vectors = rng.normal(size=(7, 5, 3))
    turned = np.einsum("nij,nkj->nki", b_from_a[:, :3, :3], vectors)
    assert np.allclose(rotate(b_from_a[:, :3, :3], vectors), turned, rtol=0, atol=1e-14)
