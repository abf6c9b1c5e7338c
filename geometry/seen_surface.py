"""What can be seen of a mesh: without faces that draw nothing, and cut-out faces to the edges of their texels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from hulldown.geometry.alpha import HIDES, AlphaMap, Cut, Cutouts
from hulldown.geometry.meshes import Mesh

FLAT = 2.0  # float32 units in the last place, up to whose height a triangle has no area for Cycles
FINE = 8  # steps per texel at which a texture is looked up
LEAST, MOST = 16, 512  # steps along a face's sides
LOOKUPS = 1 << 23  # in all faces of a mesh
MANY = 2000  # faces of a mesh that are clipped, the largest; the others count as a whole
TILES = 8  # along a face's sides, at most: what is seen in each becomes one convex piece
TILE = 32  # steps along a tile's side, at least
CHUNK = 1 << 16  # faces measured together
HALVINGS = 12  # of a step, to find where a texture's edge crosses it


def faces_with_area(mesh: Mesh) -> Int[np.ndarray, " k"]:
    """Return the ascending faces that have an area as Cycles sees them, in float32."""
    finest = FLAT * float(np.spacing(np.float32(np.abs(mesh.bounds).max())))
    drawn = np.empty(len(mesh.faces), dtype=bool)
    for start in range(0, len(drawn), CHUNK):
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces[start : start + CHUNK]], 1, 0)
        normal = np.cross(b - a, c - a)
        longest = np.max([((q - p) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
        drawn[start : start + CHUNK] = (normal * normal).sum(axis=1) > finest * finest * longest
    return np.flatnonzero(drawn)


def seen_surface(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " f"]] | None:
    """Return what hides of a mesh (`HIDES`), without cut-outs, and the face of the mesh that each face is part of.

    A cut-out face becomes up to `TILES` x `TILES` / 2 convex pieces. A piece reaches to the edge of what hides in its
    tile, within an eighth of a texel, or a 512th of the face where that is more. Of more than `MANY` cut-out faces, the
    smaller ones stay whole. Holes inside a piece stay closed:
    they matter only to a box that is cut off inside that piece, by less than the tile's size.

    Returns
    -------
    None if nothing hides.
    """
    cutouts = mesh.cutouts
    if cutouts is None:
        return mesh, np.arange(len(mesh.faces))
    cuts = cutouts.cuts()
    mixed = np.flatnonzero(cuts == Cut.MIXED)
    if len(mixed) > MANY:
        a, b, c = np.moveaxis(mesh.triangles[cutouts.face[mixed]], 1, 0)
        area = (np.cross(b - a, c - a) ** 2).sum(axis=1)
        mixed = np.sort(mixed[np.argsort(-area, kind="stable")[:MANY]])
    whole = np.ones(len(mesh.faces), dtype=bool)
    whole[cutouts.face[cuts == Cut.CLEAR]] = False
    whole[cutouts.face[mixed]] = False
    faces, origin, vertices = [mesh.faces[whole]], [np.flatnonzero(whole)], [mesh.vertices]
    count = len(mesh.vertices)
    for k, steps in zip(mixed.tolist(), _steps(cutouts, mixed).tolist(), strict=True):
        corners = mesh.vertices[mesh.faces[cutouts.face[k]]]
        for ring in _pieces(cutouts.maps[cutouts.face_map[k]], cutouts.uv[k].astype(np.float64), steps):
            vertices.append(_weights(ring) @ corners)
            fan = np.arange(1, len(ring) - 1)
            faces.append(count + np.stack([np.zeros_like(fan), fan, fan + 1], axis=1))
            origin.append(np.full(len(fan), cutouts.face[k]))
            count += len(ring)
    triangles = np.concatenate(faces)
    if not len(triangles):
        return None
    seen = Mesh(np.concatenate(vertices), triangles, mesh.name)
    return seen.of_faces(np.arange(len(triangles))), np.concatenate(origin)


def _steps(cutouts: Cutouts, mixed: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Steps along the sides of each mixed face, so that lookups stay within `LOOKUPS`."""
    sizes = np.array([alpha.texels.shape[::-1] for alpha in cutouts.maps])[cutouts.face_map[mixed]]
    texels = (np.ptp(cutouts.uv[mixed], axis=1) * sizes).max(axis=1)
    steps = np.clip(np.ceil(FINE * texels), LEAST, MOST)
    few = np.sqrt(min(1.0, 2.0 * LOOKUPS / max((steps * steps).sum(), 1.0)))
    return np.maximum(steps * few, 2).astype(np.int64)


def _pieces(alpha: AlphaMap, uv: Float[np.ndarray, "3 2"], steps: int) -> list[Float[np.ndarray, "k 2"]]:
    """Return rings around what hides in each tile of a face, as weights of its first and second corner."""

    def hides(at: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        return alpha.opacity(_weights(at) @ uv) >= HIDES

    i, j = np.mgrid[: steps + 1, : steps + 1].reshape(2, -1)
    inside = i + j <= steps
    grid = np.stack([i, j], axis=1)
    hiding = np.zeros(len(grid), dtype=bool)
    hiding[inside] = hides(grid[inside] / steps)
    number = np.arange(len(grid)).reshape(steps + 1, steps + 1)
    edges = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[1:, :-1], number[:-1, 1:])]
    one, other = (np.concatenate([ends[side].ravel() for ends in edges]) for side in (0, 1))
    crossed = inside[one] & inside[other] & (hiding[one] != hiding[other])
    one, other = one[crossed], other[crossed]
    one, other = np.where(hiding[one], one, other), np.where(hiding[one], other, one)
    low, high = grid[one] / steps, grid[other] / steps  # hides at low, not at high
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        there = hides(middle)[:, None]
        low, high = np.where(there, middle, low), np.where(there, high, middle)
    points = np.concatenate([grid[hiding] / steps, low])
    tiles = min(TILES, max(1, steps // TILE))
    ends = np.linspace(0, steps, tiles + 1).round() / steps
    pieces = []
    for a in range(tiles):
        column = points[(points[:, 0] >= ends[a]) & (points[:, 0] <= ends[a + 1])]
        for b in range(tiles - a):
            tile = column[(column[:, 1] >= ends[b]) & (column[:, 1] <= ends[b + 1])]
            if len(tile) > 2:
                try:
                    pieces.append(tile[ConvexHull(tile).vertices])
                except QhullError:  # all on one line: no area
                    continue
    return pieces


def _weights(at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([at, 1.0 - at.sum(axis=1)])
