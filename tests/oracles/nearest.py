"""First hits of rays among many triangles, by float64 arithmetic on each: no tree, no box, no frames."""

import numpy as np


def nearest_triangle(
    origin: np.ndarray, along: np.ndarray, triangles: np.ndarray, *, after: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Distance and index of the first triangle along each ray, from one origin or one a ray; inf and -1 for a miss."""
    nearest, index = np.full(len(along), np.inf), np.full(len(along), -1)
    for k, (a, b, c) in enumerate(triangles):
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a - origin) @ normal) / (along @ normal)
        at = origin + np.where(np.isfinite(t), t, 0)[:, None] * along
        inside = np.all([np.cross(q - p, at - p) @ normal >= 0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
        closer = inside & (t > after) & (t < nearest)
        nearest[closer], index[closer] = t[closer], k
    return nearest, index
