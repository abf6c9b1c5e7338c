"""Ground faces made ready: counter-clockwise, none without area, each with its slope and how far float64 serves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from geometry.meshes import Mesh
from geometry.predicates import EPS, ORIENT_BOUND, TINY, orient

# What a tame face promises: heights within this many ulp of the largest |z| on the ground, ...
HEIGHT_ULPS = 8
# ... and normals within this many radians.
NORMAL_ERROR = 1e-12
_CHUNK = 1 << 16  # faces prepared together, so that intermediate arrays stay in cache
# Heights below this would lose digits to underflow.
_SMALLEST = 1e-120


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """The faces of a mesh that have an XY area, in their order.

    Parameters
    ----------
    x, y, z
        (v,) coordinates of the mesh's vertices.
    faces
        (f, 3) vertices of each ground face, counter-clockwise seen from above.
    mesh_face
        (f,) the mesh's number for each ground face.
    slope
        (f, 2) dz/dx and dz/dy of each face.
    tame
        (f,) whether `heights` and `normals_from_slopes` keep their promises on the face.
    height_error
        The largest error of a height on a tame face, in metres.
    """

    x: Float[np.ndarray, " v"]
    y: Float[np.ndarray, " v"]
    z: Float[np.ndarray, " v"]
    faces: Int[np.ndarray, "f 3"]
    mesh_face: Int[np.ndarray, " f"]
    slope: Float[np.ndarray, "f 2"]
    tame: Bool[np.ndarray, " f"]
    height_error: float

    @classmethod
    def of(cls, mesh: Mesh) -> Ground:
        """The ground of a mesh."""
        x, y, z = mesh.vertices.T.copy()
        largest = float(np.abs(z[mesh.faces].reshape(-1)).max()) if len(mesh.faces) else 0.0
        error = HEIGHT_ULPS * float(np.spacing(largest))
        faces = np.empty_like(mesh.faces)
        turn = np.empty(len(faces), dtype=np.int8)
        slope = np.empty((len(faces), 2))
        tame = np.empty(len(faces), dtype=bool)
        for begin in range(0, len(faces), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            turn[part], slope[part], tame[part] = _prepare(x, y, z, mesh.faces[part], error)
            faces[part] = mesh.faces[part]
            faces[part, 1:] = np.where((turn[part] < 0)[:, None], mesh.faces[part, :0:-1], mesh.faces[part, 1:])
        if largest and largest < _SMALLEST:
            tame[:] = False
        kept = np.flatnonzero(turn).astype(np.int32)
        if len(kept) < len(faces):
            faces, slope, tame = faces[kept], slope[kept], tame[kept]
        return cls(x, y, z, faces, kept, slope, tame, error)

    def heights(
        self,
        x: Float[np.ndarray, " n"],
        y: Float[np.ndarray, " n"],
        face: Int[np.ndarray, " n"],
        first: Int[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Height in float64 of each face's plane at each point, given each face's first vertex."""
        rise = self.slope.take(face, axis=0)
        with np.errstate(over="ignore", invalid="ignore"):  # only on faces that are not tame
            z = (x - self.x.take(first)) * rise[:, 0]
            z += (y - self.y.take(first)) * rise[:, 1]
            z += self.z.take(first)
        return z


def normals_from_slopes(slope: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Unit upward normals of planes with these slopes."""
    normal = np.empty((len(slope), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # only on faces that are not tame
        up = 1.0 / np.sqrt(1.0 + slope[:, 0] ** 2 + slope[:, 1] ** 2)
        np.multiply(slope, -up[:, None], out=normal[:, :2])
    normal[:, 2] = up
    return normal


def _prepare(
    x: Float[np.ndarray, " v"],
    y: Float[np.ndarray, " v"],
    z: Float[np.ndarray, " v"],
    faces: Int[np.ndarray, "f 3"],
    error: float,
) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, "f 2"], Bool[np.ndarray, " f"]]:
    """Which way each face turns, its slope, and whether a bound on what was rounded stays within the promises.

    docs/top-hits.md derives the bound; letters there and here are the same.
    """
    a, b, c = faces.T
    ax, ay, az = x[a], y[a], z[a]
    dx1, dy1, dz1 = x[b] - ax, y[b] - ay, z[b] - az
    dx2, dy2, dz2 = x[c] - ax, y[c] - ay, z[c] - az
    products = dx1 * dy2, dy1 * dx2, dy1 * dz2, dz1 * dy2, dz1 * dx2, dx1 * dz2
    area = products[0] - products[1]
    p, q, r, s, t, u = (np.abs(v) for v in products)
    turn = np.sign(area).astype(np.int8)
    unsure = np.flatnonzero(np.abs(area) <= ORIENT_BOUND * (p + q) + TINY)
    if len(unsure):
        a, b, c = faces[unsure].T
        turn[unsure] = orient(x[a], y[a], x[b], y[b], x[c], y[c])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.abs(area)
        slope = np.stack([products[3] - products[2], products[5] - products[4]], axis=1)
        slope /= area[:, None]
        kappa = (p + q) / size
        alpha, beta = (r + s) / size, (t + u) / size
        reach_x, reach_y = np.maximum(np.abs(dx1), np.abs(dx2)), np.maximum(np.abs(dy1), np.abs(dy2))
        rounded = EPS * ((10.0 * kappa + 4.0) * (alpha * reach_x + beta * reach_y))
        highest = np.maximum(np.maximum(np.abs(az), np.abs(z[faces[:, 1]])), np.abs(z[faces[:, 2]]))
        steepness = np.sqrt(1.0 + slope[:, 0] ** 2 + slope[:, 1] ** 2)
        tame = rounded + 2.0 * EPS * highest <= error
        tame &= 10.0 * EPS * kappa * (alpha + beta) <= 0.5 * NORMAL_ERROR * steepness
        tame &= size > 1e-150
    return turn, slope, tame
