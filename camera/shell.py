"""Camera poses on a spherical shell around a target, and their sampling (paper 2.1.6)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.portable import arcsin, arctan2, hypot, sin, sin_cos
from hulldown.base.uniform import UniformNumbers
from hulldown.geometry.transforms import rigid_matrix


def camera_pose(
    center: ArrayLike, distance: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike
) -> Float[np.ndarray, "... 4 4"]:
    """Pose of a level camera on the shell that looks at the center.

    Straight above and straight below need no up vector: the image's right is always (-sin azimuth, cos azimuth, 0),
    so the pose is a continuous function of both angles, poles included.

    `center`: world point looked at; it projects to the image's center at depth `distance`.
    `distance`: meters, positive.
    `azimuth`: radians counterclockwise from +x, from the center to the camera.
    `elevation`: radians above the horizontal plane through the center, from -pi/2 to pi/2.
    """
    c = checked_array(center, "center", ("...", 3))
    d = checked_array(distance, "distance", ("...",))
    if (d <= 0.0).any():
        raise ValueError(f"distance: expected positive meters, got {float(d.min())}")
    outward, rotation = outward_and_camera_axes(azimuth, elevation)
    return rigid_matrix(rotation, c + d[..., None] * outward)


def outward_and_camera_axes(
    azimuth: ArrayLike, elevation: ArrayLike
) -> tuple[Float[np.ndarray, "... 3"], Float[np.ndarray, "... 3 3"]]:
    """Return unit direction from the center to the camera, and the camera's axes (right, down, forward) as columns."""
    a = checked_array(azimuth, "azimuth", ("...",))
    e = checked_array(elevation, "elevation", ("...",))
    if (np.abs(e) > math.pi / 2).any():
        raise ValueError(f"elevation: expected radians from -pi/2 to pi/2, got {float(e.flat[np.abs(e).argmax()])}")
    a, e = np.broadcast_arrays(a, e)
    (sa, ca), (se, ce) = sin_cos(a), sin_cos(e)
    outward = np.stack([ce * ca, ce * sa, se], -1)
    right = np.stack([-sa, ca, np.zeros_like(a)], -1)
    down = np.stack([se * ca, se * sa, -ce], -1)
    return outward, np.stack([right, down, -outward], -1)


def shell_coordinates(
    offset: Float[np.ndarray, "... 3"],
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return distance, azimuth, and elevation of points about the center, in meters and radians."""
    x, y, z = np.moveaxis(offset, -1, 0)
    across = hypot(x, y)
    return hypot(across, z), arctan2(y, x), arctan2(z, across)


def sample_azimuths(n: int, *, rng: UniformNumbers) -> Float[np.ndarray, " n"]:
    """Sample `n` azimuths, uniform in 0 to 2 pi."""
    return rng.uniform(0.0, 2.0 * math.pi, n)


def sample_elevations(
    n: int, bounds: tuple[float, float], *, rng: UniformNumbers, uniform_in: Literal["angle", "sphere"] = "angle"
) -> Float[np.ndarray, " n"]:
    """Sample `n` elevations within bounds.

    `bounds`: lowest and highest elevation in radians, within -pi/2 to pi/2.
    `uniform_in`: ``"angle"``, as in the paper: uniform in elevation. The rings of equal elevation shrink toward the
    pole, so cameras crowd there: 80 to 90 degrees gets 11 % of the draws of 0 to 90 degrees but is 1.5 % of the dome.
    ``"sphere"``: uniform on the shell's area, which is uniform in sin(elevation) (Archimedes).
    """
    low, high = bounds
    if not -math.pi / 2 <= low <= high <= math.pi / 2:
        raise ValueError(f"bounds: expected -pi/2 <= low <= high <= pi/2, got {bounds}")
    if uniform_in == "angle":
        return rng.uniform(low, high, n)
    if uniform_in == "sphere":
        # arcsin may round past the bounds by an ulp.
        least, greatest = sin([low, high]).tolist()
        return np.clip(arcsin(rng.uniform(least, greatest, n)), low, high)
    raise ValueError(f"uniform_in: expected 'angle' or 'sphere', got {uniform_in!r}")
