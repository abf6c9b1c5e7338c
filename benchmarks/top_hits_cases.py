"""Hard cases of the top hit, and each method's error from the answer by rational arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction

import numpy as np

from hulldown.benchmarks.top_hits_peers import hills, raw_embreex
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.placement.ground_faces import GroundFaceHits
from hulldown.placement.terrain import Terrain
from hulldown.tests.oracles.top_hits import Top, angle, exact_tops, on_face

Case = tuple[str, Mesh, np.ndarray]


def cases(n: int) -> Iterator[Case]:
    """Name, mesh and `n` points of every hard case."""
    rng = np.random.default_rng(2)
    ground = hills(8_000)
    low, high = ground.bounds[:, :2]
    anywhere = rng.uniform(low, high, (n, 2))
    yield "terrain, random points", ground, anywhere
    for name, offset in (("map coordinates (5e5, 5.4e6)", [5e5, 5.4e6, 0]), ("offset 1e7", [1e7, 1e7, 0])):
        yield name, _moved(ground, offset), anywhere + np.array(offset[:2])
    corners = ground.triangles[rng.integers(len(ground.faces), size=n)][:, :, :2]
    share = rng.choice([0.0, 0.25, 0.5, 0.75], size=(n, 1))
    on_edges = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
    yield "on edges and vertices", ground, on_edges
    yield "one ulp beside them", ground, np.nextafter(on_edges, on_edges + rng.choice([-1.0, 1.0], size=on_edges.shape))
    foot = 10 * np.tan(np.radians(1e-4))
    yield "cliff of 89.9999 degrees", *_cliff(rng, n, foot, [0, 0, 0])
    yield "the same at map coordinates", *_cliff(rng, n, foot, [5e5, 5.4e6, 0])
    yield "upright wall", *_cliff(rng, n, 0.0, [0, 0, 0])
    lines = np.repeat(rng.uniform(low, high, (200, 1, 2)), 3, axis=1) + rng.uniform(-20, 20, (200, 1, 2)) * np.array(
        [[[0.0], [0.5], [1.0]]]
    )
    upright = np.concatenate([lines, np.full((200, 3, 1), 30.0)], axis=2).reshape(-1, 3)
    over = Mesh(upright, np.arange(600).reshape(-1, 3))
    at = lines[rng.integers(200, size=n), rng.integers(3, size=n)]
    yield "zero-area faces above the ground", merge_meshes_with_sources([over, ground])[0], at
    for gap in (1e-3, 1e-5, 1e-7):
        yield f"two sheets {gap:g} m apart", merge_meshes_with_sources([ground, _moved(ground, [0, 0, gap])])[0], anywhere
    yield "the same sheet twice", merge_meshes_with_sources([ground, ground])[0], anywhere
    yield "slivers of 1 to 1e6", *_slivers(rng, n)
    yield "100 km triangles beside a patch of 1 mm", *_patch(rng, n)
    yield "hole edges, one ulp beside", *_holes(ground, rng, n)
    yield "outer border, one ulp beside", *_border(rng, n)


def errors(mesh: Mesh, xy: np.ndarray, blender: Callable[[Mesh], Callable] | None) -> dict[str, dict[str, float]]:
    """For each method: rates of misses, false hits and wrong surfaces, and the largest errors of height and normal."""
    exact = exact_tops(mesh, xy)
    answers = {"float32 in world coordinates": _in_world_coordinates(mesh, xy)}
    if blender is not None:
        answers["Blender scene.ray_cast"] = _from_blender(blender(mesh)(xy))
    answers["hulldown"] = Terrain(mesh).top_hits(xy)
    return {name: _compare_hits(exact, hits, mesh, xy) for name, hits in answers.items()}


def _compare_hits(exact: list[Top | None], hits: GroundFaceHits, mesh: Mesh, xy: np.ndarray) -> dict[str, float]:
    missed = false = wrong = 0
    height = turned = 0.0
    for i, top in enumerate(exact):
        face = int(hits.face[i])
        if top is None or face < 0:
            missed += top is not None and face < 0
            false += top is None and face >= 0
            continue
        own = on_face(face, mesh.vertices[mesh.faces[face]], [Fraction(float(v)) for v in xy[i]])
        right = own is not None and own.z == top.z  # any of several equally high faces
        wrong += not right
        if not np.isfinite([hits.z[i], *hits.normal[i]]).all():  # a face that has no area in float32
            height, turned = np.inf, np.pi
            continue
        height = max(height, abs(float(Fraction(float(hits.z[i])) - top.z)))
        turned = max(turned, angle(hits.normal[i], (own if right else top).normal))
    n = len(exact)
    rates = {"missed": missed / n, "false": false / n, "wrong": wrong / n}
    return {**rates, "height": height, "normal_deg": float(np.degrees(turned))}


def _in_world_coordinates(mesh: Mesh, xy: np.ndarray) -> GroundFaceHits:
    """Return Embree's hits in the mesh's own coordinates: face, and height and normal in float32."""
    face = raw_embreex(mesh)(xy)
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float32)[mesh.faces[face]], 1, 0)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = xy.astype(np.float32) - a[:, :2]
        z = a[:, 2] - (p * normal[:, :2]).sum(axis=1) / normal[:, 2]
        normal *= (np.where(normal[:, 2] < 0, -1, 1) / np.linalg.norm(normal, axis=1))[:, None]
    return GroundFaceHits(z.astype(np.float64), normal.astype(np.float64), face)


def _from_blender(found: list) -> GroundFaceHits:
    hit = np.array([f[0] for f in found])
    normal = np.array([f[2] for f in found], dtype=np.float64)
    normal *= np.where(normal[:, 2] < 0, -1.0, 1.0)[:, None]
    z = np.array([f[1][2] for f in found], dtype=np.float64)
    return GroundFaceHits(z, normal, np.where(hit, [f[3] for f in found], -1))


def _moved(mesh: Mesh, offset: list[float]) -> Mesh:
    return Mesh(mesh.vertices + np.array(offset, dtype=float), mesh.faces)


def _strip(x: np.ndarray, z: np.ndarray, y: np.ndarray) -> Mesh:
    """A ribbon: a profile (x, z) drawn along y."""
    n = len(y)
    vertices = np.column_stack([np.repeat(x, n), np.tile(y, len(x)), np.repeat(z, n)])
    i = (np.arange(len(x) - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return Mesh(vertices, np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)]))


def _cliff(rng: np.random.Generator, n: int, foot: float, offset: list[float]) -> tuple[Mesh, np.ndarray]:
    mesh = _moved(_strip(np.array([-5.0, 0.0, foot, 5.0]), np.array([0.0, 0.0, 10.0, 10.0]), np.arange(11.0)), offset)
    near = rng.uniform(-0.5, 1.5, n) * max(foot, 1e-7)
    return mesh, np.column_stack([near, rng.uniform(0, 10, n)]) + np.array(offset[:2])


def _slivers(rng: np.random.Generator, n: int) -> tuple[Mesh, np.ndarray]:
    mesh = _strip(np.array([0.0, 1000.0]), np.array([0.0, 10.0]), np.arange(101) * 1e-3)
    vertices = mesh.vertices.copy()
    vertices[:, 2] += rng.uniform(-1e-3, 1e-3, len(vertices))
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    vertices[:, :2] = vertices[:, :2] @ turn
    weights = rng.dirichlet([1, 1, 1], size=n)
    corners = vertices[mesh.faces[rng.integers(len(mesh.faces), size=n)]][:, :, :2]
    return Mesh(vertices, mesh.faces), np.einsum("nij,ni->nj", corners, weights)


def _patch(rng: np.random.Generator, n: int) -> tuple[Mesh, np.ndarray]:
    large = _strip(np.arange(3) * 1e5, np.array([0.0, 100.0, 0.0]), np.arange(3) * 1e5)
    steps = np.arange(21) * 1e-3
    small = _strip(30e3 + steps, 40.0 + 1e-3 * rng.random(21), 41e3 + steps)
    return merge_meshes_with_sources([large, small])[0], rng.uniform([30e3, 41e3], [30e3 + 0.02, 41e3 + 0.02], (n, 2))


def _holes(ground: Mesh, rng: np.random.Generator, n: int) -> tuple[Mesh, np.ndarray]:
    gone = rng.random(len(ground.faces)) < 0.05
    corners = ground.triangles[gone][:, :, :2]
    corners = corners[rng.integers(len(corners), size=n)]
    on_edge = corners[:, 0] + rng.random((n, 1)) * (corners[:, 1] - corners[:, 0])
    beside = np.nextafter(on_edge, on_edge + rng.choice([-1.0, 1.0], size=on_edge.shape))
    return Mesh(ground.vertices, ground.faces[~gone]), beside


def _border(rng: np.random.Generator, n: int) -> tuple[Mesh, np.ndarray]:
    mesh = hills(2_000)
    low, high = mesh.bounds[:, :2]
    xy = rng.uniform(low, high, (n, 2))
    rows, axis = np.arange(n), rng.integers(2, size=n)
    at = np.where(rng.random(n) < 0.5, low[axis], high[axis])
    xy[rows, axis] = np.where(rng.random(n) < 1 / 3, at, np.nextafter(at, at + rng.choice([-1.0, 1.0], size=n)))
    return mesh, xy
