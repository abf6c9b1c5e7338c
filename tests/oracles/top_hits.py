"""The rule of the top hit in rational arithmetic, face by face: slow, short, and without code of the product."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hulldown.geometry.meshes import Mesh


@dataclass(frozen=True)
class Top:
    """The exact top hit at a point: lowest face index among the highest, height, upward normal of any length."""

    face: int
    z: Fraction
    normal: tuple[Fraction, Fraction, Fraction]


def exact_tops(mesh: Mesh, xy: np.ndarray) -> list[Top | None]:
    """The exact top hit of each point, None for a miss."""
    corners = mesh.triangles
    low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
    tops = []
    for point in xy:
        p = [Fraction(float(v)) for v in point]
        best = None
        for f in np.flatnonzero(((low <= point) & (point <= high)).all(axis=1)):
            top = on_face(int(f), corners[f], p)
            if top and (best is None or top.z > best.z):
                best = top
        tops.append(best)
    return tops


def on_face(face: int, corners: np.ndarray, p: list[Fraction]) -> Top | None:
    """The exact hit on a face; None outside it or if it has no XY area."""
    a, b, c = ([Fraction(float(v)) for v in corner] for corner in corners)
    u, v = [b[i] - a[i] for i in range(3)], [c[i] - a[i] for i in range(3)]
    n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    if n[2] == 0:
        return None
    x, y = p[0] - a[0], p[1] - a[1]
    # p = a + s u + t v in XY, by Cramer's rule
    s, t = (x * v[1] - y * v[0]) / n[2], (u[0] * y - u[1] * x) / n[2]
    if s < 0 or t < 0 or s + t > 1:
        return None
    return Top(face, a[2] + s * u[2] + t * v[2], n if n[2] > 0 else (-n[0], -n[1], -n[2]))


def angle(normal: np.ndarray, exact: tuple[Fraction, Fraction, Fraction]) -> float:
    """Angle in radians between a unit normal and an exact one, precise for small angles."""
    largest = max(abs(v) for v in exact)
    n = np.array([float(v / largest) for v in exact])
    n /= np.linalg.norm(n)
    # Chords keep digits that a cosine loses.
    return float(2 * np.arcsin(min(1.0, 0.5 * np.linalg.norm(normal - n))))
