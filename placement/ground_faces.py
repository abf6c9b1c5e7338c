"""Prepared ground faces, counterclockwise, with area, slope, and a bound of float64's error; and hits on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.predicates import MIN_EXACT_PRODUCT, ORIENT_BOUND, ROUNDING_ERROR, orientation_sign

# Guaranteed on a well-conditioned face: heights within this many ulp of the largest |z| on the ground, ...
HEIGHT_ULPS = 8
# ... and normals within this many radians.
NORMAL_ERROR = 1e-12
_FACES_PER_BLOCK = 1 << 16  # intermediate arrays stay in cache
# Areas that lost more than this factor to cancellation have no relative error to speak of.
_MAX_CANCELLATION = 2.0**40
# Heights below this would lose digits to underflow.
_MIN_EXACT_PRODUCT = 1e-120


@dataclass(frozen=True, eq=False, slots=True)
class GroundFaceHits:
    """The ground under each of n points."""

    z: Float[np.ndarray, " n"]  # height in meters; nan where there is no ground
    normal: Float[np.ndarray, "n 3"]  # unit normal, pointing up; nan where there is no ground
    face: Int[np.ndarray, " n"]  # face index; -1 where there is no ground

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """Whether there is ground under each point."""
        return self.face >= 0


@dataclass(frozen=True, eq=False, slots=True)
class GroundFaces:
    """The faces of a mesh with an XY area, in order; arrays by column, which NumPy gathers fastest."""

    x: Float[np.ndarray, " v"]  # x, y, z: coordinates of the mesh's vertices
    y: Float[np.ndarray, " v"]
    z: Float[np.ndarray, " v"]
    corners: Int[np.ndarray, "3 f"]  # vertices of each ground face, counterclockwise seen from above
    mesh_face: Int[np.ndarray, " f"]  # the mesh's number for each ground face
    slope: Complex[np.ndarray, " f"]  # dz/dx + i dz/dy of each face
    # whether `exact_height_fractions` and `upward_normals` are within their guaranteed errors on the face
    well_conditioned: Bool[np.ndarray, " f"]
    # bound of the error of a height on each face, in meters; infinite where there is none
    height_error: Float[np.ndarray, " f"]

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> GroundFaces:
        """Return the ground faces of a mesh."""
        x, y, z = (np.ascontiguousarray(column) for column in mesh.vertices.T)
        low, high = mesh.bounds[:, 2]
        largest = max(-low, high)
        n, error = len(mesh.faces), HEIGHT_ULPS * float(np.spacing(largest))
        corners, turn = np.empty((3, n), dtype=np.int32), np.empty(n, dtype=np.int8)
        slope, well_conditioned, bound = np.empty(n, dtype=np.complex128), np.empty(n, dtype=bool), np.empty(n)
        for begin in range(0, n, _FACES_PER_BLOCK):
            part = slice(begin, begin + _FACES_PER_BLOCK)
            a, b, c = (np.ascontiguousarray(corner) for corner in mesh.faces[part].T)
            turn[part], slope.real[part], slope.imag[part], well_conditioned[part], bound[part] = _face_turns_slopes_and_errors(
                x, y, z, (a, b, c), error
            )
            corners[0, part] = a
            corners[1, part], corners[2, part] = np.where(turn[part] < 0, (c, b), (b, c))
        if largest and largest < _MIN_EXACT_PRODUCT:
            well_conditioned[:], bound[:] = False, np.inf
        kept = np.flatnonzero(turn).astype(np.int32)
        if len(kept) < n:
            corners, slope, well_conditioned = corners[:, kept], slope[kept], well_conditioned[kept]
            bound = bound[kept]
        return cls(x, y, z, corners, kept, slope, well_conditioned, bound)

    def face_boxes(self) -> Float[np.ndarray, "2 3 f"]:
        """Return lowest and highest corner of every face's box."""
        low, high = boxes = np.empty((2, *self.corners.shape))
        for begin in range(0, self.corners.shape[1], _FACES_PER_BLOCK):
            part = slice(begin, begin + _FACES_PER_BLOCK)
            for axis, values in enumerate((self.x, self.y, self.z)):
                a, b, c = (values[corner[part]] for corner in self.corners)
                np.minimum(np.minimum(a, b), c, out=low[axis, part])
                np.maximum(np.maximum(a, b), c, out=high[axis, part])
        return boxes

    def heights(
        self, face: Int[np.ndarray, " n"], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return each face's plane's height at each point, in float64."""
        first = self.corners[0][face]
        return plane_heights(self.slope[face], x - self.x[first], y - self.y[first], self.z[first])

    def height_bounds(
        self, face: Int[np.ndarray, " n"], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return two heights between which each face is at a point in it, despite the rounding of these sums."""
        error = 2.0 * self.height_error[face]
        z = np.where(error < np.inf, self.heights(face, x, y), 0.0)
        return z - error, z + error


def plane_heights(
    slope: Complex[np.ndarray, " n"], dx: Float[np.ndarray, " n"], dy: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return heights of planes with these slopes at offsets from a point where they are `z` high."""
    with np.errstate(over="ignore", invalid="ignore"):  # only on faces that are not well-conditioned
        height = slope.real * dx
        height += slope.imag * dy
        height += z
    return height


def upward_normals(slope: Complex[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Return unit upward normals of planes of these slopes."""
    normal = np.empty((len(slope), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # only on faces that are not well-conditioned
        up = slope.real**2
        up += slope.imag**2
        np.sqrt(np.add(up, 1.0, out=up), out=up)
        np.divide(1.0, up, out=up)
        normal[:, 2] = up
        np.negative(up, out=up)
        np.multiply(slope.real, up, out=normal[:, 0])
        np.multiply(slope.imag, up, out=normal[:, 1])
    return normal


def _face_turns_slopes_and_errors(
    x: Float[np.ndarray, " v"],
    y: Float[np.ndarray, " v"],
    z: Float[np.ndarray, " v"],
    corners: tuple[Int[np.ndarray, " f"], Int[np.ndarray, " f"], Int[np.ndarray, " f"]],
    error: float,
) -> tuple[
    Int[np.ndarray, " f"], Float[np.ndarray, " f"], Float[np.ndarray, " f"], Bool[np.ndarray, " f"], Float[np.ndarray, " f"]
]:
    """Return how each face turns, dz/dx and dz/dy, whether float64 can keep the promises, its heights' error.

    For a face with corner a and differences d₁, d₂ to the others, let W = dx₁dy₂ − dy₁dx₂, p and q the sizes of its
    two products, κ = (p + q)/|W|, α = (|dy₁dz₂| + |dz₁dy₂|)/|W|, β = (|dz₁dx₂| + |dx₁dz₂|)/|W|, X and Y the largest
    |dx| and |dy|, h the largest |z| of the corners. Each difference carries a relative error of at most u, each
    product three of them, so

        |W̃ − W| ≤ 4u(p + q) = 4uκ|W̃|,   |Ñ − N| ≤ 4uα|W̃|   for the numerator N of the slope g = ∂z/∂x,

    up to second order in u, which the constants below cover (where κ ≤ 2⁴⁰, so that uκ < 2⁻¹²; other faces are
    not well-conditioned and have no bound). Dividing,

        |g̃ − g| ≤ u(4α + 4κα + α) ≤ 9uκα,      since |g̃| ≤ α and κ ≥ 1,

    and likewise with β for ∂z/∂y. The height z = az + gx(x − ax) + gy(y − ay) then has an error of at most

        u[(9κ + 3)(αX + βY) + h],

    the 3 from rounding x − ax, the product and the sum, the h from the last addition. The code bounds it by
    u[(10κ + 4)(αX + βY) + 2h]. The normal is along (−gx, −gy, 1), turned by at most 9uκ(α + β)/√(1 + gx² + gy²) and a
    few u.

    A face is well-conditioned if the first bound is within 8 ulp of the ground's largest |z| and the second
    within half of 1e-12 radians. On a face that is not well-conditioned (slivers, steep folds far from the axes)
    heights and normals are computed in integers and rounded once.
    """
    a, b, c = corners
    ax, ay, az, bz, cz = x[a], y[a], z[a], z[b], z[c]
    dx1, dy1, dz1 = x[b] - ax, y[b] - ay, bz - az
    dx2, dy2, dz2 = x[c] - ax, y[c] - ay, cz - az
    products = dx1 * dy2, dy1 * dx2, dy1 * dz2, dz1 * dy2, dz1 * dx2, dx1 * dz2
    area = products[0] - products[1]
    p, q, r, s, t, u = (np.abs(v) for v in products)
    turn = np.sign(area).astype(np.int8)
    unsure = np.flatnonzero(np.abs(area) <= ORIENT_BOUND * (p + q) + MIN_EXACT_PRODUCT)
    if len(unsure):
        a, b, c = a[unsure], b[unsure], c[unsure]
        turn[unsure] = orientation_sign(x[a], y[a], x[b], y[b], x[c], y[c])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.abs(area)
        slope_x, slope_y = (products[3] - products[2]) / area, (products[5] - products[4]) / area
        kappa = (p + q) / size
        alpha, beta = (r + s) / size, (t + u) / size
        reach_x, reach_y = np.maximum(np.abs(dx1), np.abs(dx2)), np.maximum(np.abs(dy1), np.abs(dy2))
        rounded = ROUNDING_ERROR * ((10.0 * kappa + 4.0) * (alpha * reach_x + beta * reach_y))
        highest = np.maximum(np.maximum(np.abs(az), np.abs(bz)), np.abs(cz))
        steepness = np.sqrt(1.0 + slope_x**2 + slope_y**2)
        bound = rounded + 2.0 * ROUNDING_ERROR * highest
        bound[~((kappa <= _MAX_CANCELLATION) & (size > 1e-150) & (bound < np.inf))] = np.inf
        well_conditioned = bound <= error
        well_conditioned &= 10.0 * ROUNDING_ERROR * kappa * (alpha + beta) <= 0.5 * NORMAL_ERROR * steepness
        bound += ROUNDING_ERROR * _MIN_EXACT_PRODUCT  # underflow of a slope's numerator
    return turn, slope_x, slope_y, well_conditioned, bound
