"""Solid shapes as vertices and polygons: the bricks that the demo vehicles are built of. No Blender here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from hulldown.geometry.transforms import axis_rotation

Number = float | int
Point = Sequence[Number]  # (x, y, z)
Outline = Sequence[tuple[Number, Number]]  # corners of a plane polygon, in order


@dataclass(frozen=True, eq=False, slots=True)
class Shape:
    """Polygons over shared vertices, faces counter-clockwise seen from outside."""

    vertices: Float[np.ndarray, "v 3"]
    faces: tuple[tuple[int, ...], ...]

    def __add__(self, other: Shape) -> Shape:
        return join_shapes([self, other])

    def moved(self, x: Number = 0.0, y: Number = 0.0, z: Number = 0.0) -> Shape:
        """Return the shape shifted."""
        return Shape(self.vertices + np.array([x, y, z], float), self.faces)

    def turned(self, axis: str, degrees: Number, about: Point = (0.0, 0.0, 0.0)) -> Shape:
        """Return the shape turned about an axis ("x", "y" or "z") through a point."""
        rotation = axis_rotation(np.eye(3)["xyz".index(axis)], np.radians(degrees))
        center = np.asarray(about, float)
        return Shape((self.vertices - center) @ rotation.T + center, self.faces)

    def scaled(self, x: Number, y: Number, z: Number) -> Shape:
        """Return the shape stretched about the origin; a mirror image keeps its faces outward."""
        faces = self.faces if x * y * z > 0 else tuple(face[::-1] for face in self.faces)
        return Shape(self.vertices * np.array([x, y, z], float), faces)

    def with_mirror_image(self) -> Shape:
        """Return the shape and its mirror image on the other side of the vehicle."""
        return self + self.scaled(1.0, -1.0, 1.0)


def join_shapes(shapes: Iterable[Shape]) -> Shape:
    """Return all shapes in one."""
    parts = list(shapes)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [tuple(i + int(k) for i in face) for k, part in zip(starts, parts, strict=False) for face in part.faces]
    return Shape(np.concatenate([part.vertices for part in parts]), tuple(faces))


def loft_rings(rings: ArrayLike, *, hollow: bool = False) -> Shape:
    """Rings of equally many corners joined by quads, closed by the first and the last ring, or to each other."""
    corners = np.array(rings, float)
    n, m = corners.shape[:2]
    faces: list[tuple[int, ...]] = [] if hollow else [tuple(range(m))[::-1], tuple(range((n - 1) * m, n * m))]
    for k in range(n if hollow else n - 1):
        for i in range(m):
            j, above = (i + 1) % m, (k + 1) % n
            faces.append((k * m + i, k * m + j, above * m + j, above * m + i))
    return _with_faces_outward(Shape(corners.reshape(-1, 3), tuple(faces)))


def make_corner_box(low: Point, high: Point) -> Shape:
    """Return a box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return stack_outlines([(z0, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), (z1, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)])])


def make_standing_box(size: Point, at: Point) -> Shape:
    """Return a box of a size standing on the point `at`, the middle of its underside."""
    (sx, sy, sz), (x, y, z) = size, at
    return make_corner_box((x - sx / 2, y - sy / 2, z), (x + sx / 2, y + sy / 2, z + sz))


def stack_outlines(levels: Sequence[tuple[Number, Outline]]) -> Shape:
    """Return a solid whose horizontal outline (x, y) at each height z is given."""
    return loft_rings([[(x, y, z) for x, y in outline] for z, outline in levels])


def extrude_along_y(outline: Outline, y0: Number, y1: Number) -> Shape:
    """Return a side profile (x, z) drawn out from y0 to y1."""
    return loft_rings([[(x, y, z) for x, z in outline] for y in (y0, y1)])


def extrude_about_middle(outline: Outline, half_width: float) -> Shape:
    """Return a side profile (x, z) drawn out to both sides of the middle."""
    return extrude_along_y(outline, -half_width, half_width)


def revolve_about_y(profile: Outline, *, sides: int = 20, hollow: bool = False) -> Shape:
    """Turn a profile (radius, y) about the y axis: solid between its ends, or a ring round its closed outline."""
    angles = np.arange(sides) * 2 * np.pi / sides
    return loft_rings([[(r * np.cos(a), y, r * np.sin(a)) for a in angles] for r, y in profile], hollow=hollow)


def make_cylinder(start: Point, end: Point, radius: float, end_radius: float | None = None, *, sides: int = 12) -> Shape:
    """Return a cylinder, or a cone where the end radius differs, between two points."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = (b - a) / np.linalg.norm(b - a)
    u = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angles = (np.arange(sides)[:, None] + 0.5) * 2 * np.pi / sides
    circle = np.cos(angles) * u + np.sin(angles) * np.cross(along, u)
    return loft_rings([a + radius * circle, b + (radius if end_radius is None else end_radius) * circle])


def revolve_about_x(stations: Sequence[tuple[float, float]], *, sides: int = 14, z: float = 0.0) -> Shape:
    """Return a round body along +x through stations (x, radius): a barrel, a missile."""
    return revolve_about_y([(r, x) for x, r in stations], sides=sides).turned("z", -90).moved(z=z)


def make_bent_bar(points: Sequence[Point], radius: float, *, sides: int = 6) -> Shape:
    """Return a bent bar through points: a rail, a hoop, a handle."""
    return join_shapes(make_cylinder(a, b, radius, sides=sides) for a, b in pairwise(points))


def tarpaulin_hoop_points(x: float, half: float, z0: float, z1: float) -> list[tuple[float, float, float]]:
    """Return a tarpaulin hoop's points across the vehicle at x: upright sides, a rounded roof."""
    bow = [(half, z0), (half, z1 - 0.42), (half * 0.93, z1 - 0.2), (half * 0.72, z1 - 0.06), (half * 0.35, z1)]
    return [(x, y, z) for y, z in bow] + [(x, -y, z) for y, z in reversed(bow)]


def thicken_surface(rows: ArrayLike, *, thickness: float) -> Shape:
    """Return a sheet through rows of points, as a thin solid: each strip is drawn inward (down) by the thickness."""
    outer = np.array(rows, float)
    center = outer.mean(axis=(0, 1))
    lift = (outer - center) * [0.0, 1.0, 1.0]
    inner = outer - thickness * lift / np.linalg.norm(lift, axis=-1, keepdims=True)
    n, m = outer.shape[:2]
    points = np.concatenate([outer.reshape(-1, 3), inner.reshape(-1, 3)])
    faces = []
    for k in range(n - 1):
        for i in range(m - 1):
            a, b, c, d = k * m + i, k * m + i + 1, (k + 1) * m + i + 1, (k + 1) * m + i
            faces += [(a, b, c, d), (d + n * m, c + n * m, b + n * m, a + n * m)]
    return _with_faces_outward(Shape(points, tuple(faces)))


def make_ellipsoid(size: Point, at: Point, *, sides: int = 16, rings: int = 8, floor: float = -1.0) -> Shape:
    """Return an ellipsoid of half axes `size`, cut off below `floor` (-1 keeps all of it)."""
    heights = np.sin(np.linspace(np.arcsin(max(floor, -0.995)), np.arcsin(0.995), rings))
    angles = np.arange(sides) * 2 * np.pi / sides
    unit = [[(np.sqrt(1 - h * h) * np.cos(a), np.sqrt(1 - h * h) * np.sin(a), h) for a in angles] for h in heights]
    return loft_rings(unit).scaled(*size).moved(*at)


def make_track(circles: Sequence[tuple[float, float, float]], y: float, width: float, *, pitch: float, sag: float) -> Shape:
    """Lay a track of single links round circles (x, z, radius) of wheels, hanging by `sag` between the upper ones."""
    angles = np.linspace(0, 2 * np.pi, 73)[:-1]
    rim = np.concatenate([np.stack([x + r * np.cos(angles), z + r * np.sin(angles)], -1) for x, z, r in circles])
    loop = rim[ConvexHull(rim).vertices]  # counter-clockwise: forward along the ground, back along the top
    loop = np.concatenate([loop, loop[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
    links = round(length[-1] / pitch)
    at = np.linspace(0, length[-1], links + 1)[:-1]
    x, z = np.interp(at, length, loop[:, 0]), np.interp(at, length, loop[:, 1])
    ends = np.array([(cx, cz + cr) for cx, cz, cr in circles])
    ends = ends[np.argsort(ends[:, 0])][[0, -1]]
    t = np.clip((x - ends[0, 0]) / (ends[1, 0] - ends[0, 0]), 0, 1)
    z = z - np.where(z > loop[:, 1].mean(), sag * np.sin(np.pi * t) * np.abs(np.sin(3 * np.pi * t)), 0.0)
    thick, half = 0.075, pitch * 0.46
    shapes = []
    for i in range(links):
        j = (i + 1) % links
        lean = np.degrees(np.arctan2(z[j] - z[i], x[j] - x[i]))
        link = extrude_along_y([(-half, 0), (half, 0), (half * 0.8, -thick), (-half * 0.8, -thick)], -width / 2, width / 2)
        shapes.append(link.turned("y", -lean).moved((x[i] + x[j]) / 2, y, (z[i] + z[j]) / 2))
    return join_shapes(shapes)


def _with_faces_outward(shape: Shape) -> Shape:
    points = shape.vertices - shape.vertices.mean(axis=0)
    volume = 0.0
    for face in shape.faces:
        for j in range(1, len(face) - 1):
            volume += np.linalg.det(points[[face[0], face[j], face[j + 1]]])
    return shape if volume >= 0 else Shape(shape.vertices, tuple(face[::-1] for face in shape.faces))
