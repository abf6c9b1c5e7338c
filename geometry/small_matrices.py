"""Products of small matrices as explicit sums, so a row's bits don't depend on the number of rows.

A matrix product may round differently with the number of rows beside one, and what is planned or annotated must not
depend on other rows. On many small matrices it is quicker, too. No checks: for inner loops.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hulldown.geometry.portable import sin_cos


def product(a: Float[np.ndarray, "*#n 3 3"], b: Float[np.ndarray, "*#n 3 k"]) -> Float[np.ndarray, "*n 3 k"]:
    """`a @ b`; leading axes broadcast."""
    return a[..., :, 0:1] * b[..., 0:1, :] + a[..., :, 1:2] * b[..., 1:2, :] + a[..., :, 2:3] * b[..., 2:3, :]


def compose(
    c_from_b: Float[np.ndarray, "*#n 3 4"], b_from_a: Float[np.ndarray, "*#n 3 4"]
) -> Float[np.ndarray, "*n 3 4"]:
    """`c_from_a` of affine transforms without their last row (0, 0, 0, 1); leading axes broadcast."""
    composed = product(c_from_b[..., :3], b_from_a)
    composed[..., 3] += c_from_b[..., 3]
    return composed


def turn(axis: Float[np.ndarray, "3"], angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """`geometry.transforms.rotation_about` for one axis and many angles."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    theta = angle[:, None, None]
    half, half_cosine = sin_cos(theta / 2.0)
    return np.eye(3) + 2.0 * (half * half_cosine) * cross + 2.0 * (half * half) * product(cross, cross)
