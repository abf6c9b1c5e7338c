"""Extremes of projected triangles after exact clipping against the near plane and the image's edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hulldown.camera.intrinsics import Intrinsics, Lenses
from hulldown.camera.projection import NEAR

# Which planes a point is outside of, or lies on, as bits.
NEAR_BIT, LEFT_BIT, RIGHT_BIT, TOP_BIT, BOTTOM_BIT = 1, 2, 4, 8, 16


@dataclass(frozen=True, slots=True)
class Frustum:
    """What a camera sees, as half-spaces of its own frame that are linear in (x, y, z).

    Parameters
    ----------
    f_px, width, height
        Of the camera's intrinsics.
    frame
        Whether the image's edges are among the half-spaces, or the near plane alone.
    """

    f_px: float
    width: float
    height: float
    frame: bool

    @classmethod
    def of(cls, intrinsics: Intrinsics, *, frame: bool) -> Frustum:
        """The frustum of a camera with these intrinsics."""
        return cls(intrinsics.f_px, float(intrinsics.width), float(intrinsics.height), frame)

    @classmethod
    def of_each(cls, lens: Lenses, row: int, *, frame: bool) -> Frustum:
        """The frustum of one of several cameras."""
        width, height = lens.size[row].tolist()
        return cls(float(lens.f[row]), width, height, frame)

    @property
    def bits(self) -> tuple[int, ...]:
        """The planes of this frustum, in the order of `planes`."""
        return (NEAR_BIT, LEFT_BIT, RIGHT_BIT, TOP_BIT, BOTTOM_BIT) if self.frame else (NEAR_BIT,)

    @property
    def planes(self) -> Float[np.ndarray, "k 4"]:
        """Rows (a, b, c, d) with a x + b y + c z + d >= 0 inside."""
        f, half_width, half_height = self.f_px, self.width / 2.0, self.height / 2.0
        near = [0.0, 0.0, 1.0, -NEAR]
        if not self.frame:
            return np.array([near])
        return np.array(
            [
                near,
                [f, 0.0, half_width, 0.0],
                [-f, 0.0, half_width, 0.0],
                [0.0, f, half_height, 0.0],
                [0.0, -f, half_height, 0.0],
            ]
        )

    def distance(self, bit: int, points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
        """Signed distance of points to one plane, scaled; not negative inside."""
        x, y, z = points
        if bit == NEAR_BIT:
            return z - NEAR
        if bit == LEFT_BIT:
            return self.f_px * x + self.width / 2.0 * z
        if bit == RIGHT_BIT:
            return self.width / 2.0 * z - self.f_px * x
        if bit == TOP_BIT:
            return self.f_px * y + self.height / 2.0 * z
        return self.height / 2.0 * z - self.f_px * y

    def outside(self, points: Float[np.ndarray, "3 *n"]) -> UInt8[np.ndarray, "*n"]:
        """For each point the bits of the planes that it is outside of."""
        code = np.zeros(points.shape[1:], dtype=np.uint8)
        for bit in self.bits:
            code |= (self.distance(bit, points) < 0.0).astype(np.uint8) * np.uint8(bit)
        return code

    def project(self, points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "2 *n"]:
        """Continuous pixels of points inside the frustum; rounding does not take them out of the image."""
        x, y, z = points
        u = x / z * self.f_px + self.width / 2.0
        v = y / z * self.f_px + self.height / 2.0
        if self.frame:
            np.clip(u, 0.0, self.width, out=u)
            np.clip(v, 0.0, self.height, out=v)
        return np.stack([u, v])


def extremes_of_points(pixels: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "4"]:
    """Lowest u, lowest v, highest u, highest v; an empty box (inf, inf, -inf, -inf) of no points."""
    u, v = pixels
    if not u.size:
        return np.array([np.inf, np.inf, -np.inf, -np.inf])
    return np.array([u.min(), v.min(), u.max(), v.max()])


def extremes_of_mesh(points: Float[np.ndarray, "3 v"], faces: np.ndarray, frustum: Frustum) -> Float[np.ndarray, "4"]:
    """Extremes in pixels of an indexed mesh in the camera's frame, clipped; empty if nothing is left.

    Most triangles are wholly inside or wholly outside; the few that straddle a plane are clipped.
    """
    outside = frustum.outside(points)
    a, b, c = outside[faces[:, 0]], outside[faces[:, 1]], outside[faces[:, 2]]
    touched = (a | b | c) != 0
    inside = faces[~touched]
    seen = np.zeros(points.shape[1], dtype=bool)
    seen[inside.ravel()] = True
    straddling = faces[touched & ((a & b & c) == 0)]
    whole = extremes_of_points(frustum.project(points[:, seen]))
    return union(whole, extremes_of_clipped(points[:, straddling], frustum))


def extremes_of_triangles(triangles: Float[np.ndarray, "3 f 3"], frustum: Frustum) -> Float[np.ndarray, "4"]:
    """The same for loose triangles (coordinate, face, corner)."""
    outside = frustum.outside(triangles)
    either = np.bitwise_or.reduce(outside, axis=1)
    whole = extremes_of_points(frustum.project(triangles[:, either == 0]))
    straddling = (either != 0) & (np.bitwise_and.reduce(outside, axis=1) == 0)
    return union(whole, extremes_of_clipped(triangles[:, straddling], frustum))


def extremes_of_clipped(triangles: Float[np.ndarray, "3 f 3"], frustum: Frustum) -> Float[np.ndarray, "4"]:
    """Extremes of triangles, every one of them clipped against every plane.

    References
    ----------
    Sutherland, Hodgman, Reentrant polygon clipping, CACM 17(1), 1974: here on all polygons at once, their corners in
    one flat list.
    """
    count = triangles.shape[1]
    points = triangles.reshape(3, -1)
    polygon = np.repeat(np.arange(count), 3)
    on = np.zeros(len(polygon), dtype=np.uint8)
    for bit in frustum.bits:
        if not len(polygon):
            break
        distance = frustum.distance(bit, points)
        inside = distance >= 0.0
        if inside.all():
            continue
        following = _next_corner(polygon)
        crossing = inside != inside[following]
        share = distance[crossing] / (distance[crossing] - distance[following[crossing]])
        start, end = points[:, crossing], points[:, following[crossing]]
        # Each corner may be kept, and be followed by the point where its edge crosses the plane.
        kept = np.zeros((len(polygon), 2), dtype=bool)
        kept[:, 0], kept[:, 1] = inside, crossing
        clipped = np.empty((3, len(polygon), 2))
        clipped[:, :, 0] = points
        clipped[:, crossing, 1] = start + share * (end - start)
        flags = np.empty((len(polygon), 2), dtype=np.uint8)
        flags[:, 0] = on
        flags[:, 1] = (on & on[following]) | np.uint8(bit)
        points, on = clipped[:, kept], flags[kept]
        polygon = np.repeat(polygon, kept.sum(axis=1))
    pixels = frustum.project(points)
    u, v = pixels
    # A corner cut by an edge of the image lies on it, whatever rounding says.
    u[on & LEFT_BIT != 0] = 0.0
    u[on & RIGHT_BIT != 0] = frustum.width
    v[on & TOP_BIT != 0] = 0.0
    v[on & BOTTOM_BIT != 0] = frustum.height
    return extremes_of_points(pixels)


def union(a: Float[np.ndarray, "4"], b: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """The smallest box around two; either may be empty."""
    return np.concatenate([np.minimum(a[:2], b[:2]), np.maximum(a[2:], b[2:])])


def _next_corner(polygon: np.ndarray) -> np.ndarray:
    """For each corner in a flat list of polygons the index of the next corner of the same polygon."""
    following = np.arange(1, len(polygon) + 1)
    last: Bool[np.ndarray, " n"] = np.append(polygon[1:] != polygon[:-1], True)
    following[last] = np.append(0, np.flatnonzero(last)[:-1] + 1)
    return following
