import numpy as np
from scipy.spatial.transform import Rotation

from hulldown.geometry.transforms import (
    axis_rotation,
    compose_affine,
    invert_affine,
    invert_rigid,
    rigid_matrix,
    rotate_vectors,
    rotation_z,
    tilt_rotation,
    yaw_and_up_rotation,
)
from hulldown.tests.builders.shapes import random_rotations

N = 50
UP = np.random.default_rng(1).normal([0, 0, 1], size=(N, 3))
UP[:, 2] = np.abs(UP[:, 2])
UP /= np.linalg.norm(UP, axis=1, keepdims=True)


def assert_rotations(matrices):
    np.testing.assert_allclose(matrices @ np.swapaxes(matrices, 1, 2), np.tile(np.eye(3), (N, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-14)


def test_rotations_equal_those_of_scipy():
    angle = np.linspace(-7, 7, N)
    expected = Rotation.from_rotvec(angle[:, None] * UP).as_matrix()
    np.testing.assert_allclose(axis_rotation(UP, angle), expected, atol=1e-14)
    np.testing.assert_allclose(rotation_z(angle), Rotation.from_euler("z", angle[:, None]).as_matrix(), atol=1e-14)
    # A tiny turn keeps its digits.
    turn = axis_rotation([0.6, 0.0, 0.8], 1e-9)
    np.testing.assert_allclose(turn[[1, 0], [2, 2]], [-0.6e-9, 0.48 * 0.5e-18], rtol=1e-12)


def test_the_smallest_tilt_turns_about_a_level_axis_and_facing_keeps_the_heading():
    yaw = np.linspace(-3.1, 3.1, N)
    tilt, turn = tilt_rotation(UP), yaw_and_up_rotation(yaw, UP)
    assert_rotations(tilt)
    np.testing.assert_allclose(tilt[:, :, 2], UP, atol=1e-15)
    level = np.stack([-UP[:, 1], UP[:, 0], np.zeros(N)], axis=1)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", tilt, level), level, atol=1e-14)
    assert_rotations(turn)
    np.testing.assert_array_equal(turn[:, :, 2], UP)
    np.testing.assert_allclose(np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), yaw, atol=1e-13)


def test_products_and_inverses_written_out_equal_those_of_matrices():
    rng = np.random.default_rng(5)
    c_from_b, b_from_a = np.tile(np.eye(4), (2, 7, 1, 1))
    c_from_b[:, :3], b_from_a[:, :3] = rng.normal(size=(2, 7, 3, 4))
    assert np.allclose(compose_affine(c_from_b, b_from_a), c_from_b @ b_from_a, rtol=0, atol=1e-14)
    assert np.allclose(invert_affine(b_from_a) @ b_from_a, np.eye(4), rtol=0, atol=1e-12)
    pose = rigid_matrix(random_rotations(rng, 20), rng.uniform(-1e6, 1e6, (20, 3)))
    back = invert_rigid(pose) @ pose
    np.testing.assert_allclose(back[:, :3, :3], np.tile(np.eye(3), (20, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(back[:, :3, 3], 0, atol=1e-8)
    vectors = rng.normal(size=(7, 5, 3))
    turned = np.einsum("nij,nkj->nki", b_from_a[:, :3, :3], vectors)
    assert np.allclose(rotate_vectors(b_from_a[:, :3, :3], vectors), turned, rtol=0, atol=1e-14)
