"""Rigid and affine transforms as 4x4 float64 matrices named `b_from_a`: they take coordinates of a to b.

Every function works on stacks, with any leading axes. Rotations follow the right-hand rule. Products are sums that are
written out: a matrix product of BLAS rounds differently on another processor, or with another number of rows.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.portable import sin_cos

# (8, 3) corners of a box from its center, in halves of its size; z changes from one to the next.
BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def transform_points(b_from_a: ArrayLike, points_a: ArrayLike) -> Float[np.ndarray, "... n 3"]:
    """Return points of frame a in frame b."""
    matrix = checked_array(b_from_a, "b_from_a", ("...", 4, 4))
    points = checked_array(points_a, "points_a", ("...", "n", 3), finite=False)
    moved = rotate_vectors(matrix[..., :3, :3], points)
    moved += matrix[..., None, :3, 3]
    return moved


def rotate_vectors(
    b_from_a: Float[np.ndarray, "... 3 3"], vectors_a: Float[np.ndarray, "... n 3"]
) -> Float[np.ndarray, "... n 3"]:
    """Vectors of frame a in frame b: `vectors_a @ b_from_a.T`, for inner loops, without checks."""
    lead = np.broadcast_shapes(b_from_a.shape[:-2], vectors_a.shape[:-2])
    turned = np.empty((*lead, *vectors_a.shape[-2:]))
    x, y, z = (vectors_a[..., i] for i in range(3))
    for i in range(3):
        row = b_from_a[..., i, 0, None] * x
        row = row + b_from_a[..., i, 1, None] * y
        row += b_from_a[..., i, 2, None] * z
        turned[..., i] = row
    return turned


def matrix_product(a: Float[np.ndarray, "*#n 3 3"], b: Float[np.ndarray, "*#n 3 k"]) -> Float[np.ndarray, "*n 3 k"]:
    """Return `a @ b` as explicit sums, without checks; leading axes broadcast."""
    return a[..., :, 0:1] * b[..., 0:1, :] + a[..., :, 1:2] * b[..., 1:2, :] + a[..., :, 2:3] * b[..., 2:3, :]


def compose_affine(
    c_from_b: Float[np.ndarray, "... r 4"], b_from_a: Float[np.ndarray, "... r 4"]
) -> Float[np.ndarray, "... r 4"]:
    """`c_from_a` of affine transforms (r = 4) or their first three rows, without checks; leading axes broadcast."""
    composed = np.empty(np.broadcast_shapes(c_from_b.shape, b_from_a.shape))
    top = composed[..., :3, :]
    np.multiply(c_from_b[..., :3, 0:1], b_from_a[..., 0:1, :], out=top)
    for i in (1, 2):
        top += c_from_b[..., :3, i : i + 1] * b_from_a[..., i : i + 1, :]
    top[..., 3] += c_from_b[..., :3, 3]
    composed[..., 3:, :] = [0.0, 0.0, 0.0, 1.0]
    return composed


def invert_rigid(b_from_a: ArrayLike) -> Float[np.ndarray, "... 4 4"]:
    """`a_from_b` for rigid transforms (rotation and translation only), exact up to rounding without a solve."""
    matrix = checked_array(b_from_a, "b_from_a", ("...", 4, 4))
    inverse = np.zeros_like(matrix)
    rotation = np.swapaxes(matrix[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation
    x, y, z = (matrix[..., i, 3, None] for i in range(3))
    inverse[..., :3, 3] = -(x * rotation[..., 0] + y * rotation[..., 1] + z * rotation[..., 2])
    inverse[..., 3, 3] = 1.0
    return inverse


def invert_affine(b_from_a: Float[np.ndarray, "... 4 4"]) -> Float[np.ndarray, "... 4 4"]:
    """`a_from_b` of affine transforms that flatten nothing, by cofactors, without checks."""
    x, y, z = (b_from_a[..., :3, i] for i in range(3))
    yz = np.cross(y, z)
    volume = x[..., 0] * yz[..., 0] + x[..., 1] * yz[..., 1] + x[..., 2] * yz[..., 2]
    inverse = np.zeros_like(b_from_a)
    inverse[..., :3, :3] = np.stack([yz, np.cross(z, x), np.cross(x, y)], -2) / volume[..., None, None]
    inverse[..., :3, 3] = -rotate_vectors(inverse[..., :3, :3], b_from_a[..., None, :3, 3])[..., 0, :]
    inverse[..., 3, 3] = 1.0
    return inverse


def rigid_matrix(rotation: ArrayLike, translation: ArrayLike) -> Float[np.ndarray, "... 4 4"]:
    """Return the 4x4 matrix of a (..., 3, 3) rotation followed by a (..., 3) translation; leading axes broadcast."""
    r = checked_array(rotation, "rotation", ("...", 3, 3))
    t = checked_array(translation, "translation", ("...", 3))
    lead = np.broadcast_shapes(r.shape[:-2], t.shape[:-1])
    matrix = np.zeros((*lead, 4, 4))
    matrix[..., :3, :3] = r
    matrix[..., :3, 3] = t
    matrix[..., 3, 3] = 1.0
    return matrix


def axis_rotation(axis: ArrayLike, angle: ArrayLike) -> Float[np.ndarray, "... 3 3"]:
    """Rotation by `angle` radians (...) about the unit `axis` (..., 3) through the origin, by Rodrigues' formula."""
    k = checked_array(axis, "axis", ("...", 3))
    theta = checked_array(angle, "angle", ("...",))[..., None, None]
    zero = np.zeros(k.shape[:-1])
    cross = np.stack(
        [
            np.stack([zero, -k[..., 2], k[..., 1]], -1),
            np.stack([k[..., 2], zero, -k[..., 0]], -1),
            np.stack([-k[..., 1], k[..., 0], zero], -1),
        ],
        -2,
    )
    # Sine and 1 - cosine from half the angle: of small angles 1 - cos would lose half the digits.
    half, half_cosine = sin_cos(theta / 2)
    # `rotate_vectors` multiplies by the transposed matrix, which of `-cross` is `cross`.
    return np.eye(3) + 2.0 * (half * half_cosine) * cross + 2.0 * (half * half) * rotate_vectors(-cross, cross)


def rotation_z(angle: ArrayLike) -> Float[np.ndarray, "... 3 3"]:
    """Rotation by `angle` radians (...) about +z, counterclockwise seen from above."""
    theta = checked_array(angle, "angle", ("...",))
    (s, c), zero, one = sin_cos(theta), np.zeros_like(theta), np.ones_like(theta)
    return np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], -2)


def tilt_rotation(normal: ArrayLike) -> Float[np.ndarray, "... 3 3"]:
    """Return the smallest rotation that takes +z to the unit `normal` (..., 3), which must not point to -z.

    Moeller, Hughes, Efficiently building a matrix to rotate one vector to another, JGT 4(4), 1999.
    """
    n = checked_array(normal, "normal", ("...", 3))
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    if (z <= -1.0 + 1e-12).any():
        raise ValueError("normal: expected a direction away from -z, where the smallest rotation is not unique")
    h = 1.0 / (1.0 + z)
    return np.stack(
        [
            np.stack([1.0 - x * x * h, -x * y * h, x], -1),
            np.stack([-x * y * h, 1.0 - y * y * h, y], -1),
            np.stack([-x, -y, 1.0 - (x * x + y * y) * h], -1),
        ],
        -2,
    )


def yaw_and_up_rotation(yaw: ArrayLike, up: ArrayLike) -> Float[np.ndarray, "... 3 3"]:
    """Return the rotation whose z axis is `up` and whose x axis, seen from above, points along `yaw` from +x.

    This is the tilt that keeps the heading: the vertical plane that holds the x axis does not turn, whatever `up` is.
    (The smallest tilt after the turn lets the heading drift by up to about a quarter of the square of the tilt: 4
    degrees at a tilt of 30.)
    """
    theta = checked_array(yaw, "yaw", ("...",))
    z_axis = checked_array(up, "up", ("...", 3))
    if (z_axis[..., 2] <= 0).any():
        raise ValueError("up: expected directions with z > 0, where every heading has one direction across them")
    s, c = sin_cos(theta)
    nx, ny, nz = z_axis[..., 0], z_axis[..., 1], z_axis[..., 2]
    x_axis = np.stack([c * nz, s * nz, -(c * nx + s * ny)], -1)
    x_axis /= np.sqrt((x_axis**2).sum(-1, keepdims=True))
    z_axis = np.broadcast_to(z_axis, x_axis.shape)
    return np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], -1)
