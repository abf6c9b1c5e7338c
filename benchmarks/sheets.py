"""A sheet of triangles over a grid of points, which is bent into ground, boxes and ellipsoids."""

from __future__ import annotations

import numpy as np

from geometry.meshes import Mesh


def sheet(points: np.ndarray) -> Mesh:
    """Two triangles between each four neighbours of a (rows, columns, 3) grid of points."""
    rows, columns = points.shape[:2]
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    return Mesh(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
