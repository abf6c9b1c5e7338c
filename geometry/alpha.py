"""Opacity of surfaces with alpha textures: lookups as in Cycles, and bounds for whole faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

HIT_OPACITY = 0.5  # a point of at least this opacity is a hit, for masks and nearest hits
OPACITY_TOLERANCE = 1e-3  # faces this close to opaque or clear need no lookups
LOOKUP_ROUNDING_TEXELS = 1e-3  # rounding may move a lookup this far beyond a face's edge
TEXEL_GRADES = np.linspace(0.0, 1.0, 16 * 255 + 1, dtype=np.float32)  # texel values at which curves are sampled


class Extension(IntEnum):
    """How an image continues beyond its edges."""

    REPEAT = 0
    EXTEND = 1
    CLIP = 2


class Cut(IntEnum):
    """Whether a texture makes a whole face opaque, clear, or mixed."""

    OPAQUE = 0
    CLEAR = 1
    MIXED = 2


@dataclass(frozen=True, eq=False, slots=True)
class AlphaMap:
    """The opacity of a material over texture coordinates."""

    # values from 0 to 1: uint8 in 255ths, or float32. The first row is the lowest. Maps may share one array.
    texels: np.ndarray
    extension: Extension = Extension.REPEAT  # how the image continues beyond its edges
    smooth: bool = True  # whether values between texels are interpolated; the nearest counts if not
    # monotone: the opacity, from 0 to 1, at interpolated values of `TEXEL_GRADES`; None: the values themselves
    curve: Float32[np.ndarray, " g"] | None = None

    def __post_init__(self) -> None:
        if self.texels.ndim != 2 or not self.texels.size or self.texels.dtype not in (np.uint8, np.float32):
            found = f"{self.texels.dtype} {self.texels.shape}"
            raise ValueError(f"texels: expected uint8 or float32 of shape (h, w), got {found}")

    def opacity(self, uv: Float[np.ndarray, "n 2"]) -> Float32[np.ndarray, " n"]:
        """Opacity from 0 to 1 at texture coordinates, (0, 0) at the lower left corner of the image."""
        at = np.asarray(uv, dtype=np.float64) * self.texels.shape[::-1]
        if not self.smooth:
            column, row = np.floor(at).T
            return self.apply_curve(self._texel_values(column, row))
        at = at - 0.5
        low = np.floor(at)
        column, row = low.T
        u, v = (at - low).astype(np.float32).T
        lower = self._texel_values(column, row) * (1 - u) + self._texel_values(column + 1, row) * u
        upper = self._texel_values(column, row + 1) * (1 - u) + self._texel_values(column + 1, row + 1) * u
        return self.apply_curve(lower * (1 - v) + upper * v)

    def _texel_values(self, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
        height, width = self.texels.shape
        if self.extension == Extension.REPEAT:
            column, row = np.mod(column, width), np.mod(row, height)
        else:
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            column, row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
        found = self.texels.ravel().take((row * width + column).astype(np.intp))
        values = _unit_values(found)
        if self.extension == Extension.CLIP:
            values = np.where(inside, values, np.float32(0.0))
        return values

    def apply_curve(self, values: Float32[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
        """Opacity at interpolated values of texels."""
        if self.curve is None:
            return np.clip(values, np.float32(0.0), np.float32(1.0))
        return np.interp(values, TEXEL_GRADES, self.curve).astype(np.float32)

    def texel_opacity(self) -> Float32[np.ndarray, "h w"]:
        """Opacity at the middle of every texel."""
        return self.apply_curve(_unit_values(self.texels))


def shrink_alpha_texels(alpha: AlphaMap, longest: int) -> UInt8[np.ndarray, "h w"]:
    """Return the texels of a smaller map, `longest` at most: curve before mean, to keep as much surface opaque."""
    opacity = alpha.texel_opacity().astype(np.float64)
    height, width = opacity.shape
    for axis in (0, 1):
        wanted = max(1, round(opacity.shape[axis] * longest / max(height, width)))
        sums = np.insert(np.cumsum(opacity, axis=axis), 0, 0.0, axis=axis)
        ends = np.linspace(0.0, opacity.shape[axis], wanted + 1)
        at = np.minimum(ends.astype(int), opacity.shape[axis] - 1)
        part = np.expand_dims(ends - at, 1 - axis)
        reached = np.take(sums, at, axis) + part * np.take(opacity, at, axis)
        opacity = np.diff(reached, axis=axis) * wanted / opacity.shape[axis]
    return np.rint(opacity * 255.0).astype(np.uint8)


def _unit_values(texels: np.ndarray) -> Float32[np.ndarray, "..."]:
    return texels * np.float32(1.0 / 255.0) if texels.dtype == np.uint8 else texels


class TexelCounts:
    """Count marked texels in any rectangle of a texture, exactly, by summed areas.

    An interpolated value lies between those of its four texels, and curves are monotone; so where all texels of a
    stretch are above a threshold, all that is looked up there is.

    Crow, Summed-area tables for texture mapping, SIGGRAPH 1984.
    """

    def __init__(self, alpha: AlphaMap, marks: Callable[[np.ndarray], Bool[np.ndarray, "..."]]) -> None:
        self._alpha, marked = alpha, marks(alpha.texel_opacity())
        self._outside = marks(alpha.apply_curve(np.zeros(1, dtype=np.float32)))[0]
        height, width = marked.shape
        self._sums = np.zeros((height + 1, width + 1), dtype=np.int64)
        self._sums[1:, 1:] = np.cumsum(np.cumsum(marked, axis=0, dtype=np.int64), axis=1)

    def count(
        self, low: Float[np.ndarray, "m 2"], high: Float[np.ndarray, "m 2"]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Count marked and all texels that lookups from `low` to `high` may take; coordinates as for `opacity`."""
        height, width = self._alpha.texels.shape
        size = np.array([width, height], dtype=np.float64)
        room = 0.5 + LOOKUP_ROUNDING_TEXELS if self._alpha.smooth else LOOKUP_ROUNDING_TEXELS
        first = np.floor(low * size - room)
        end = np.floor(high * size + room) + 1
        total = (end - first).prod(axis=1)
        if self._alpha.extension == Extension.REPEAT:
            return self._count_marked_in_window(first, end), total
        kept_first, kept_end = np.clip(first, 0, size), np.clip(end, 0, size)
        if self._alpha.extension == Extension.EXTEND:
            kept_first, kept_end = np.minimum(kept_first, size - 1), np.maximum(kept_end, 1)
            return self._count_marked_in_window(kept_first, kept_end), (kept_end - kept_first).prod(axis=1)
        beyond = total - (kept_end - kept_first).prod(axis=1)
        return self._count_marked_in_window(kept_first, kept_end) + beyond * self._outside, total

    def _count_marked_in_window(
        self, first: Float[np.ndarray, "m 2"], end: Float[np.ndarray, "m 2"]
    ) -> Float[np.ndarray, " m"]:
        a, b, c, d = first[:, 0], first[:, 1], end[:, 0], end[:, 1]
        return (
            self._count_marked_below_corner(c, d)
            - self._count_marked_below_corner(a, d)
            - self._count_marked_below_corner(c, b)
            + self._count_marked_below_corner(a, b)
        )

    def _count_marked_below_corner(
        self, column: Float[np.ndarray, " m"], row: Float[np.ndarray, " m"]
    ) -> Float[np.ndarray, " m"]:
        """Return marked texels left of a column and below a row of the plane that the image repeats over."""
        height, width = self._alpha.texels.shape
        times_x, left_x = np.divmod(column, width)
        times_y, left_y = np.divmod(row, height)
        x, y = left_x.astype(np.intp), left_y.astype(np.intp)
        sums = self._sums
        across = times_x * sums[y, width] + times_y * sums[height, x]
        return across + times_x * times_y * sums[height, width] + sums[y, x]


@dataclass(frozen=True, eq=False, slots=True)
class Cutouts:
    """Which textures cut which faces of a mesh out."""

    face: Int[np.ndarray, " m"]  # ascending indices of the mesh's faces; all others are opaque
    uv: Float32[np.ndarray, "m 3 2"]  # texture coordinates of their corners
    face_map: Int[np.ndarray, " m"]  # for each the index into `maps`
    maps: tuple[AlphaMap, ...]

    def take_faces(self, faces: Int[np.ndarray, " k"]) -> Cutouts | None:
        """Return the cut-outs of a mesh of these ascending faces alone; None if none of them is cut out."""
        place = np.searchsorted(faces, self.face)
        kept = place < len(faces)
        kept[kept] = faces[place[kept]] == self.face[kept]
        if not kept.any():
            return None
        return Cutouts(place[kept], self.uv[kept], self.face_map[kept], self.maps)

    def face_cuts(self) -> UInt8[np.ndarray, " m"]:
        """Return a `Cut` for each face: what its texture makes of it."""
        cuts = np.full(len(self.face), Cut.MIXED, dtype=np.uint8)
        low, high = self.uv.min(axis=1).astype(np.float64), self.uv.max(axis=1).astype(np.float64)
        for number, alpha in enumerate(self.maps):
            map_faces = np.flatnonzero(self.face_map == number)
            if not len(map_faces):
                continue
            for cut, marks in (
                (Cut.OPAQUE, lambda opacity: opacity >= 1.0 - OPACITY_TOLERANCE),
                (Cut.CLEAR, lambda opacity: opacity <= OPACITY_TOLERANCE),
            ):
                marked, total = TexelCounts(alpha, marks).count(low[map_faces], high[map_faces])
                cuts[map_faces[marked == total]] = cut
        return cuts


def merged_cutouts(cutouts: Sequence[Cutouts | None], face_counts: Sequence[int]) -> Cutouts | None:
    """Return the cut-outs of meshes put one after the other; None if there are none."""
    maps: dict[tuple[object, ...], int] = {}
    every: list[AlphaMap] = []
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for cut, first in zip(cutouts, np.cumsum([0, *face_counts[:-1]]), strict=True):
        if cut is None:
            continue
        keys = [(id(alpha.texels), alpha.extension, alpha.smooth, id(alpha.curve)) for alpha in cut.maps]
        for key, alpha in zip(keys, cut.maps, strict=True):
            if key not in maps:
                maps[key] = len(every)
                every.append(alpha)
        number = np.array([maps[key] for key in keys])
        found.append((cut.face + first, cut.uv, number[cut.face_map]))
    if not found:
        return None
    face, uv, face_map = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Cutouts(face, uv, face_map, tuple(every))
