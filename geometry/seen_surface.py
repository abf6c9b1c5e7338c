"""What can be seen of a mesh: without faces that draw nothing, and cut-out faces to the edges of their texels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.indices import group_and_rank
from hulldown.geometry.alpha import HIT_OPACITY, AlphaMap, Cut, Cutouts
from hulldown.geometry.hulls import hull_corners_and_groups
from hulldown.geometry.meshes import Mesh

MAX_FLAT_HEIGHT_ULPS = 2.0  # a float32 triangle of this height has no area for Cycles
MAX_FLAT_SHARE = 1e-5  # of the mesh's extent: in map coordinates, triangles can be as small as such units
LOOKUPS_PER_TEXEL = 8  # along a face
MIN_SIDE_STEPS, MAX_SIDE_STEPS = 16, 512
MAX_TEXEL_LOOKUPS = 1 << 23  # in all faces of a mesh
MAX_SIDE_TILES = 8  # along a face's sides; what is seen in each tile becomes one convex piece
MIN_TILE_STEPS = 32  # along a tile's side
FACES_PER_BLOCK = 1 << 16
LATTICE_POINTS_PER_BLOCK = 1 << 18
EDGE_HALVINGS = 12  # of a step, to find where a texture's edge crosses it


def faces_with_area(mesh: Mesh) -> Int[np.ndarray, " k"]:
    """Return the ascending faces that have an area as Cycles sees them, in float32."""
    low, high = mesh.bounds
    finest = MAX_FLAT_HEIGHT_ULPS * float(np.spacing(np.float32(np.abs(mesh.bounds).max())))
    finest = min(finest, MAX_FLAT_SHARE * float((high - low).max()))
    drawn = np.empty(len(mesh.faces), dtype=bool)
    for start in range(0, len(drawn), FACES_PER_BLOCK):
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces[start : start + FACES_PER_BLOCK]], 1, 0)
        normal = np.cross(b - a, c - a)
        longest = np.max([((q - p) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
        drawn[start : start + FACES_PER_BLOCK] = (normal * normal).sum(axis=1) > finest * finest * longest
    return np.flatnonzero(drawn)


def seen_mesh_and_source_faces(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " f"]] | None:
    """Return what hides of a mesh (`HIT_OPACITY`), without cut-outs, and the mesh's face that each face is part of.

    A cut-out face becomes up to `MAX_SIDE_TILES` squared / 2 convex pieces. A piece reaches to the edge in its
    tile, within an eighth of a texel, or a 512th of the face where that is more. Holes inside a piece stay closed:
    they matter only to a box that is cut off inside that piece, by less than the tile's size.
    """
    cutouts = mesh.cutouts
    if cutouts is None:
        return mesh, np.arange(len(mesh.faces))
    cuts = cutouts.face_cuts()
    mixed = np.flatnonzero(cuts == Cut.MIXED)
    whole = np.ones(len(mesh.faces), dtype=bool)
    whole[cutouts.face[cuts == Cut.CLEAR]] = False
    whole[cutouts.face[mixed]] = False
    faces, origin, vertices = [mesh.faces[whole]], [np.flatnonzero(whole)], [mesh.vertices]
    count = len(mesh.vertices)
    for steps, some in _steps_and_face_blocks(cutouts, mixed):
        corners = mesh.vertices[mesh.faces[cutouts.face[some]]]
        alpha = cutouts.maps[cutouts.face_map[some[0]]]
        ring, face = _opaque_ring_points(alpha, cutouts.uv[some].astype(np.float64), steps)
        if not len(ring):
            continue
        vertices.append((_corner_weights(ring)[:, None] @ corners[face // MAX_SIDE_TILES**2])[:, 0])
        size = np.unique(face, return_counts=True)[1]
        piece, number = group_and_rank(size - 2)
        first = count + (np.cumsum(size) - size)[piece]
        faces.append(np.stack([first, first + number + 1, first + number + 2], axis=1))
        origin.append(cutouts.face[some[face[first - count] // MAX_SIDE_TILES**2]])
        count += len(ring)
    triangles = np.concatenate(faces)
    if not len(triangles):
        return None
    seen = Mesh(np.concatenate(vertices), triangles, mesh.name)
    return seen.take_mesh_faces(np.arange(len(triangles))), np.concatenate(origin)


def _steps_and_face_blocks(cutouts: Cutouts, mixed: Int[np.ndarray, " m"]) -> Iterator[tuple[int, Int[np.ndarray, " k"]]]:
    """Yield numbers of steps along sides, and mixed faces of one map with so many steps that fit into memory."""
    steps = _side_step_counts(cutouts, mixed)
    order = np.lexsort((steps, cutouts.face_map[mixed]))
    kinds = np.stack([cutouts.face_map[mixed], steps])[:, order]
    for same in np.split(order, np.flatnonzero(np.diff(kinds, axis=1).any(axis=0)) + 1):
        if len(same):
            most = max(1, LATTICE_POINTS_PER_BLOCK // int(steps[same[0]] + 1) ** 2)
            yield from ((int(steps[same[0]]), mixed[same[i : i + most]]) for i in range(0, len(same), most))


def _side_step_counts(cutouts: Cutouts, mixed: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Return steps along the sides of each mixed face, so that lookups stay within `MAX_TEXEL_LOOKUPS`."""
    sizes = np.array([alpha.texels.shape[::-1] for alpha in cutouts.maps])[cutouts.face_map[mixed]]
    texels = (np.ptp(cutouts.uv[mixed], axis=1) * sizes).max(axis=1)
    steps = np.clip(np.ceil(LOOKUPS_PER_TEXEL * texels), MIN_SIDE_STEPS, MAX_SIDE_STEPS)
    few = np.sqrt(min(1.0, 2.0 * MAX_TEXEL_LOOKUPS / max((steps * steps).sum(), 1.0)))
    return np.maximum(steps * few, 2).astype(np.int64)


def _opaque_ring_points(
    alpha: AlphaMap, uv: Float[np.ndarray, "m 3 2"], steps: int
) -> tuple[Float[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """Return rings around what hides in each tile of faces, as weights of first and second corners.

    The second array has the ring of each point, ascending: a tile's number plus `MAX_SIDE_TILES` squared for each face.
    """

    def hides(face: Int[np.ndarray, " n"], at: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        return alpha.opacity((_corner_weights(at)[:, None] @ uv[face])[:, 0]) >= HIT_OPACITY

    i, j = np.mgrid[: steps + 1, : steps + 1].reshape(2, -1)
    inside = i + j <= steps
    grid = np.stack([i, j], axis=1)
    hiding = np.zeros((len(uv), len(grid)), dtype=bool)
    lattice = _corner_weights(grid[inside] / steps) @ uv
    hiding[:, inside] = (alpha.opacity(lattice.reshape(-1, 2)) >= HIT_OPACITY).reshape(len(uv), -1)
    tiles = min(MAX_SIDE_TILES, max(1, steps // MIN_TILE_STEPS))
    one, other, line = _lattice_edge_ends_and_lines(steps)
    face, edge = np.nonzero(hiding[:, one] != hiding[:, other])
    whole, point = np.nonzero(hiding)
    if tiles == 1:  # no corner of a hull lies between others on a line of the lattice
        first, last = _line_end_masks(face, line[edge])
        outer = np.where(hiding[face, other[edge]], first, last)
        face, edge = face[outer], edge[outer]
        outer = np.logical_or(*_line_end_masks(whole, i[point]))
        whole, point = whole[outer], point[outer]
    one, other = one[edge], other[edge]
    one, other = np.where(hiding[face, one], one, other), np.where(hiding[face, one], other, one)
    low, high = grid[one] / steps, grid[other] / steps  # hides at low, not at high
    for _ in range(EDGE_HALVINGS):
        middle = (low + high) / 2.0
        there = hides(face, middle)[:, None]
        low, high = np.where(there, middle, low), np.where(there, high, middle)
    points, face = np.concatenate([grid[point] / steps, low]), np.concatenate([whole, face])
    ends = np.linspace(0, steps, tiles + 1).round() / steps
    in_tiles, ring = [], []
    for a, b in np.argwhere(np.add.outer(np.arange(tiles), np.arange(tiles)) < tiles).tolist():
        low, high = ends[[a, b]], ends[[a + 1, b + 1]]
        here = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        in_tiles.append(points[here])
        ring.append(face[here] * MAX_SIDE_TILES**2 + a * MAX_SIDE_TILES + b)
    return hull_corners_and_groups(np.concatenate(in_tiles), np.concatenate(ring))


def _lattice_edge_ends_and_lines(steps: int) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
    """Return both ends (numbers in the square) and the line of each edge of a face's lattice, along each line."""
    q, k = np.tril_indices(steps)
    r = steps - 1 - q
    ends = [((k, r), (k + 1, r)), ((r, k), (r, k + 1)), ((q + 1 - k, k), (q - k, k + 1))]
    one, other = (np.concatenate([i * (steps + 1) + j for i, j in side]) for side in zip(*ends, strict=True))
    return one, other, np.concatenate([q, q + steps, q + 2 * steps])


def _line_end_masks(
    face: Int[np.ndarray, " n"], line: Int[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    changes = (np.diff(face) != 0) | (np.diff(line) != 0)
    return np.append(True, changes)[: len(face)], np.append(changes, True)[: len(face)]


def _corner_weights(at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([at, 1.0 - at.sum(axis=1)])
