"""Clearance of oriented boxes from boxes and triangles, by all separating axes of many pairs; touching counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from hulldown.base.indices import rank_batches
from hulldown.base.portable import sin_cos
from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.transforms import BOX_CORNERS, compose_affine, invert_rigid, rotate_vectors, transform_points
from hulldown.scene.cutouts import Solidity
from hulldown.scene.instances import InstancedScene
from hulldown.scene.rays import RayList

ENCLOSURE_REACH_M = 100.0  # a sky dome is farther away
BOX_PAIRS_PER_BLOCK = 1 << 14  # of box and triangle


def _skyward_directions(n: int) -> Float[np.ndarray, "n 3"]:
    """Return up, then directions spread over the upper half sphere by the golden angle, top down (Vogel, 1979)."""
    i = np.arange(n)
    z = 1.0 - i / (n - 0.5)
    sin, cos = sin_cos(i * (math.pi * (3.0 - math.sqrt(5.0))))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * cos, flat * sin, z], axis=1)


SKYWARD_DIRECTIONS = _skyward_directions(48)
MIN_FREE_RAYS = 4  # needed if the first is blocked; below a wide sheet, two level ones are free


def box_pair_touch_mask(
    half_a: Float[np.ndarray, "p 3"], half_b: Float[np.ndarray, "p 3"], a_from_b: Float[np.ndarray, "p 4 4"]
) -> Bool[np.ndarray, " p"]:
    """Return whether two boxes, each about the origin of its own frame, touch (Gottschalk et al., OBBTree, 1996)."""
    rotation, offset = a_from_b[:, :3, :3], a_from_b[:, :3, 3]
    # The axis of nearly parallel edges is mostly rounding error; a margin keeps it from separating the boxes.
    spread = np.abs(rotation) + 1e-12
    apart = (np.abs(offset) > half_a + np.einsum("pij,pj->pi", spread, half_b)).any(axis=1)
    toward = np.einsum("pij,pi->pj", rotation, offset)
    apart |= (np.abs(toward) > half_b + np.einsum("pij,pi->pj", spread, half_a)).any(axis=1)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        distance = np.abs(offset[:, k, None] * rotation[:, j] - offset[:, j, None] * rotation[:, k])
        reach = half_a[:, j, None] * spread[:, k] + half_a[:, k, None] * spread[:, j]
        for edge in range(3):
            u, v = (edge + 1) % 3, (edge + 2) % 3
            reach_b = half_b[:, u] * spread[:, i, v] + half_b[:, v] * spread[:, i, u]
            apart |= distance[:, edge] > reach[:, edge] + reach_b
    return ~apart


def triangle_box_touch_mask(
    corners: Sequence[Sequence[Float[np.ndarray, " p"]]], half: Sequence[Float[np.ndarray, " p"]]
) -> Bool[np.ndarray, " p"]:
    """Return whether each triangle, in the frame of its box about the origin, touches it (Akenine-Moeller, 2001)."""
    touch = np.ones(len(half[0]), dtype=bool)
    for a, b, c, size in zip(*corners, half, strict=True):
        touch &= ~(np.minimum(np.minimum(a, b), c) > size)
        touch &= ~(np.maximum(np.maximum(a, b), c) < -size)
    left = np.flatnonzero(touch)
    corners = [[x[left] for x in corner] for corner in corners]
    half = [size[left] for size in half]
    edges = [[y - x for x, y in zip(corners[e], corners[(e + 1) % 3], strict=True)] for e in range(3)]
    offset, reach = 0.0, 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        normal = edges[0][j] * edges[1][k] - edges[0][k] * edges[1][j]
        offset = offset + normal * corners[0][i]
        reach = reach + np.abs(normal) * half[i]
    apart = np.abs(offset) > reach
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for edge in edges:
            ej, ek = edge[j], edge[k]
            a, b, c = (ej * corner[k] - ek * corner[j] for corner in corners)
            reach = np.abs(ek) * half[j] + np.abs(ej) * half[k]
            apart |= np.minimum(np.minimum(a, b), c) > reach
            apart |= np.maximum(np.maximum(a, b), c) < -reach
    touch[left] = ~apart
    return touch


class Obstacles:
    """A scenery's obstacles, for clearance tests. Immutable.

    `solid`: which instances count; by default all. Grass gives way.
    `extent`: lowest and highest (x, y) of the ground. An instance around all of it, such as a sky dome, lets light in
    unless it's nearer than `ENCLOSURE_REACH_M`; one around a part of it, such as a hollow hill, doesn't. None: all do.
    """

    def __init__(
        self,
        scene: InstancedScene,
        *,
        solid: Bool[np.ndarray, " k"] | None = None,
        extent: Float[np.ndarray, "2 2"] | None = None,
    ) -> None:
        self._scene = scene
        low, high = scene.bounds[:, 0, :2], scene.bounds[:, 1, :2]
        self._around = np.ones(len(scene.bounds), dtype=bool)
        if extent is not None:
            self._around = ((low <= extent[0]) & (high >= extent[1])).all(axis=1)
        self._solid = np.ones(len(scene.bounds), dtype=bool) if solid is None else solid
        self._triangles: dict[int, tuple[BoxTree, Float[np.ndarray, "3 3 f"], Solidity | None]] = {}

    def blocked_box_mask(
        self, half: Float[np.ndarray, "n 3"], world_from_box: Float[np.ndarray, "n 4 4"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether each box touches an opaque part of a triangle, or one instance encloses it on all sides."""
        center = world_from_box[:, :3, 3]
        reach = np.einsum("nij,nj->ni", np.abs(world_from_box[:, :3, :3]), half)
        box, instance = self._scene.overlapping_pairs(center - reach, center + reach)
        box, instance = box[self._solid[instance]], instance[self._solid[instance]]
        touched = np.zeros(len(half), dtype=bool)
        bounds = self._scene.bounds[instance]
        which = self._scene.instance_mesh[instance]
        for number in np.unique(which):
            of_mesh = np.flatnonzero((which == number) & ~touched[box])
            self._mark_boxes_touching_mesh(int(number), half, world_from_box, box[of_mesh], instance[of_mesh], touched)
        within = ((bounds[:, 0] <= center[box]) & (center[box] <= bounds[:, 1])).all(axis=1)
        inside = np.unique(box[within])
        inside = inside[~touched[inside]]
        touched[inside] = self._enclosed_mask(world_from_box[inside])
        return touched

    def skylit_mask(self, point: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether light reaches each world point: the ray upward is free, or `MIN_FREE_RAYS` others."""
        is_open = np.zeros(len(point), dtype=bool)
        free = np.zeros(len(point), dtype=int)
        for begin, end in pairwise((0, 1, 13, len(SKYWARD_DIRECTIONS))):
            left = np.flatnonzero(~is_open)
            origins = np.repeat(point[left], end - begin, axis=0)
            directions = np.tile(SKYWARD_DIRECTIONS[begin:end], (len(left), 1))
            rays = RayList(origins, directions)
            blocked = self._scene.occlusion(rays)
            rows = np.flatnonzero(blocked)
            met = self._scene.first_hits(rays.take(rows))
            blocked[rows] = (met.distance <= ENCLOSURE_REACH_M) | ~self._around[met.instance]
            free[left] += (~blocked).reshape(len(left), end - begin).sum(axis=1)
            is_open |= free >= (1 if begin == 0 else MIN_FREE_RAYS)
        return is_open

    def above_obstacle_mask(self, point: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether the first thing below each point is an obstacle; domes around the ground don't count."""
        met = self._scene.first_hits(RayList(point, np.tile([0.0, 0.0, -1.0], (len(point), 1))))
        near, hit = met.distance <= ENCLOSURE_REACH_M, np.flatnonzero(met.instance >= 0)
        near[hit] |= ~self._around[met.instance[hit]]
        return near

    def _mark_boxes_touching_mesh(
        self,
        number: int,
        half: Float[np.ndarray, "n 3"],
        world_from_box: Float[np.ndarray, "n 4 4"],
        box: np.ndarray,
        instance: np.ndarray,
        touched: Bool[np.ndarray, " n"],
    ) -> None:
        mesh = self._scene.meshes[number]
        if number not in self._triangles:
            corners = mesh.triangles
            tree = BoxTree(np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1))
            solidity = None if mesh.cutouts is None else Solidity(mesh)
            self._triangles[number] = tree, np.ascontiguousarray(corners.transpose(1, 2, 0)), solidity
        tree, triangles, solidity = self._triangles[number]
        mesh_from_box = compose_affine(self._scene.instance_from_world[instance], world_from_box[box])
        corners = transform_points(mesh_from_box, BOX_CORNERS * half[box][:, None])
        pair, face = tree.overlapping_pairs(corners.min(axis=1), corners.max(axis=1))
        box_from_mesh = compose_affine(invert_rigid(world_from_box[box]), self._scene.world_from_instance[instance])
        moves = np.ascontiguousarray(np.moveaxis(box_from_mesh[:, :3], 0, 2))
        sizes = np.ascontiguousarray(half.T)
        order = np.argsort(box[pair], kind="stable")
        # Most boxes that touch anything touch one of the first few triangles.
        for batch in rank_batches(box[pair[order]], first=8, growth=8):
            left = order[batch]
            left = left[~touched[box[pair[left]]]]
            for i in range(0, len(left), BOX_PAIRS_PER_BLOCK):
                which, faces = pair[left[i : i + BOX_PAIRS_PER_BLOCK]], face[left[i : i + BOX_PAIRS_PER_BLOCK]]
                into = moves[:, :, which]
                moved = [[row[0] * x + row[1] * y + row[2] * z + row[3] for row in into] for x, y, z in triangles[:, :, faces]]
                touching = triangle_box_touch_mask(moved, list(sizes[:, box[which]]))
                if solidity is not None:
                    pose = mesh_from_box[which[touching]]
                    sides = pose[:, :3, :3] * half[box[which[touching]]][:, None]
                    touching[touching] = solidity.maybe_solid_mask(faces[touching], pose[:, :3, 3], sides)
                touched[box[which[touching]]] = True

    def _enclosed_mask(self, world_from_box: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
        around = np.full(len(world_from_box), -1)
        left = np.arange(len(world_from_box))
        # Upward first, since most boxes in the open have nothing above them.
        for axis in ([0.0, 0, 1], [1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]):
            directions = rotate_vectors(world_from_box[left, :3, :3], np.array([axis]))[:, 0]
            rays = RayList(world_from_box[left, :3, 3], directions)
            met = self._scene.first_hits(rays, max_distance=ENCLOSURE_REACH_M).instance
            kept = (met >= 0) & self._solid[met] & ((around[left] < 0) | (met == around[left]))
            left = left[kept]
            around[left] = met[kept]
        shut_in = np.zeros(len(world_from_box), dtype=bool)
        shut_in[left] = True
        return shut_in
