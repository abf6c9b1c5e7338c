"""The box of triangles behind a distorting lens, by polygons of very many corners: slow and simple."""

import cv2
import numpy as np
import shapely

from hulldown.camera.cameras import NEAR_M
from hulldown.camera.distortion import max_seen_radius
from hulldown.camera.intrinsics import Intrinsics
from hulldown.tests.oracles.clipping import clipped

LENSES = {
    "barrel": (-0.3, 0.1, 0.0, 0.0, 0.0),
    "folding": (-0.2, 0.0, 0.0, 0.0, 0.0),
    "pincushion": (0.3, 0.2, 0.0, 0.0, 0.05),
    "tangential": (-0.1, 0.02, 0.02, -0.015, 0.0),
    "mustache": (-0.3, 0.25, 0.0, 0.0, -0.02),
    "calibrated": (-0.21, 0.07, 3e-4, -1e-4, 0.0),
}
CORNERS = 10_000  # of a circle, and about as many along an edge
WIDEST = 6.0  # at unit depth: farther from the axis than any corner of an image


def dense_extent(triangles: np.ndarray, intrinsics: Intrinsics, *, frame: bool) -> np.ndarray | None:
    """Lowest u and v, highest u and v, of triangles (f, 3, 3) in the camera's frame; None if nothing is visible."""
    radius = max_seen_radius(intrinsics.distortion)
    radius = min(radius, WIDEST) if frame else radius
    found = []
    for triangle in triangles:
        corners = np.array(clipped(triangle, [(0.0, 0.0, 1.0, -NEAR_M)])).reshape(-1, 3)
        flat = shapely.Polygon(corners[:, :2] / corners[:, 2:])
        if np.isfinite(radius):
            flat = flat.intersection(shapely.Point(0.0, 0.0).buffer(radius, quad_segs=CORNERS // 4))
        if flat.is_empty:
            continue
        dense = shapely.segmentize(flat, np.ptp(shapely.get_coordinates(flat), axis=0).max() / CORNERS)
        seen = shapely.transform(dense, lambda points: opencv(points, intrinsics))
        if frame:
            seen = seen.intersection(shapely.box(0.0, 0.0, intrinsics.width, intrinsics.height))
        found += [] if seen.is_empty else [seen.bounds]
    if not found:
        return None
    low, high = np.split(np.array(found), 2, axis=1)
    return np.concatenate([low.min(axis=0), high.max(axis=0)])


def opencv(points: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Pixels of points at unit depth."""
    ahead, nowhere = np.c_[points, np.ones(len(points))], np.zeros(3)
    return cv2.projectPoints(ahead, nowhere, nowhere, intrinsics.matrix, np.array(intrinsics.distortion))[0][:, 0]
