"""Certified top hits compared with rational arithmetic, on meshes with every hard case."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hulldown.benchmarks.top_hits_cases import cases
from hulldown.geometry.meshes import Mesh
from hulldown.placement.terrain import Terrain
from hulldown.tests.oracles.top_hits import angle, exact_tops

HEIGHT_ULPS = 8  # relative to the largest |z| of the ground, as top_hits promises
NORMAL_ERROR = 1e-12  # radians, also promised
OFFSETS = [(0.0, 0.0), (5e5, 5.4e6), (1e7, -1e7), (0.1, 1 / 3)]
LAYERS = [1e-3, 1e-5, 1e-7, 0.0]


def lattice(nx, ny, x, y, z, diagonals):
    """A grid of quads, each split along one of its diagonals."""
    vertices = np.column_stack([np.repeat(x, ny + 1), np.tile(y, nx + 1), z])
    i = (np.arange(nx)[:, None] * (ny + 1) + np.arange(ny)).ravel()
    a, b, c, d = i, i + ny + 1, i + ny + 2, i + 1
    one = np.stack([a, b, c, a, c, d], axis=1)
    other = np.stack([a, b, d, b, c, d], axis=1)
    return vertices, np.where(diagonals[:, None], one, other).reshape(-1, 3)


def together(*meshes):
    # Not geometry.meshes.merge: the type checker samples with `random`, which Hypothesis forbids.
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + int(o) for m, o in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


@st.composite
def grids(draw):
    """Rough or level ground, on or off a lattice, at map coordinates or not, in meters, millimeters, or kilometers."""
    nx, ny = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = draw(st.sampled_from([1e-3, 0.1, 1.0, 5.0, 1e5]))
    x, y = np.arange(nx + 1) * size, np.arange(ny + 1) * size
    z = draw(st.sampled_from([0.0, 1.0, 100.0])) * rng.uniform(-1, 1, (nx + 1) * (ny + 1))
    vertices, faces = lattice(nx, ny, x, y, z, rng.random(nx * ny) < 0.5)
    if draw(st.booleans()):
        vertices[:, :2] += rng.uniform(-0.3, 0.3, (len(vertices), 2)) * size
    vertices[:, :2] += draw(st.sampled_from(OFFSETS))
    return Mesh(vertices, faces)


@st.composite
def cut_up(draw, meshes):
    """The same ground with holes, shuffled faces of any winding, and some unshared vertices."""
    mesh = draw(meshes)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    faces = mesh.faces[rng.permutation(len(mesh.faces))]
    faces = faces[: draw(st.integers(1, len(faces)))]
    turned = rng.random(len(faces)) < draw(st.sampled_from([0.0, 0.5]))
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    alone = np.flatnonzero(rng.random(len(faces)) < draw(st.sampled_from([0.0, 0.5, 1.0])))
    copies = mesh.vertices[faces[alone]].reshape(-1, 3)
    faces = faces.copy()
    faces[alone] = len(mesh.vertices) + np.arange(len(copies)).reshape(-1, 3)
    return Mesh(np.concatenate([mesh.vertices, copies]), faces)


@st.composite
def layered(draw, meshes):
    """The ground and perhaps a copy slightly above or below."""
    mesh = draw(meshes)
    gap = draw(st.sampled_from(LAYERS)) * draw(st.sampled_from([-1.0, 1.0]))
    return together(mesh, Mesh(mesh.vertices + np.array([0, 0, gap]), mesh.faces))


@st.composite
def cut_twice(draw):
    """A plane, level or sloping, as two sheets of different triangles: equal heights, different corners."""
    nx, ny = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    x, y = np.arange(nx + 1.0), np.arange(ny + 1.0)
    z = draw(st.sampled_from([1 / 3, 0.0])) + draw(st.sampled_from([0.0, 0.5])) * np.repeat(x, ny + 1)
    one = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random(nx * ny) < 0.5
    sheets = [Mesh(*lattice(nx, ny, x, y, np.round(z * 2**20) / 2**20, cut)) for cut in (one, ~one)]
    return together(*sheets)


@st.composite
def soups(draw):
    """Triangles between a few lattice points: zero area, repeated corners, walls, duplicates, every kind of contact."""
    n = draw(st.integers(1, 12))
    scale = draw(st.sampled_from([1.0, 0.1, 1e-3]))
    corners = draw(st.lists(st.tuples(*[st.integers(0, 4)] * 2, st.integers(0, 2)), min_size=3 * n, max_size=3 * n))
    vertices = np.array(corners, dtype=float) * [scale, scale, 1.0]
    vertices[:, :2] += draw(st.sampled_from(OFFSETS))
    if draw(st.booleans()):  # shared vertices
        vertices, index = np.unique(vertices, axis=0, return_inverse=True)
        return Mesh(vertices, index.reshape(-1, 3))
    return Mesh(vertices, np.arange(3 * n).reshape(-1, 3))


@st.composite
def slivers(draw):
    """A fan of strips in any direction, each a million times as long as wide."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    length, n = draw(st.sampled_from([1.0, 1e3])), draw(st.integers(1, 6))
    turn = draw(st.sampled_from([0.0, 0.7, np.pi / 2]))
    across = np.arange(n + 1) * length * 1e-6
    vertices = np.concatenate([np.column_stack([np.full(n + 1, e), across]) for e in (0.0, length)])
    vertices = vertices @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    vertices += draw(st.sampled_from(OFFSETS))
    i = np.arange(n)
    faces = np.concatenate([np.stack([i, n + 1 + i, i + 1], axis=1), np.stack([i + 1, n + 1 + i, n + 2 + i], axis=1)])
    return Mesh(np.column_stack([vertices, rng.uniform(-10, 10, len(vertices))]), faces)


@st.composite
def cliffs(draw):
    """Two terraces with a step between them: of 89.9999 degrees, vertical, or overhanging."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, height = draw(st.integers(1, 4)), 10.0
    foot = draw(st.sampled_from([height * np.tan(np.radians(1e-4)), 0.0, -0.5]))
    x = np.array([-3.0, 0.0, foot, 4.0])
    z = np.repeat([0.0, 0.0, height, height], n + 1) + draw(st.sampled_from([0.0, 0.1])) * rng.random(4 * (n + 1))
    vertices, faces = lattice(3, n, x, np.arange(n + 1.0), z, rng.random(3 * n) < 0.5)
    if draw(st.booleans()):
        vertices[:, [0, 1]] = vertices[:, [1, 0]]
    vertices[:, :2] += draw(st.sampled_from(OFFSETS))
    return Mesh(vertices, faces)


@st.composite
def stacks(draw):
    """Four to seven sheets over each other, rough, of two halves each that are at heights of their own."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, rough, spike = draw(st.integers(2, 4)), draw(st.sampled_from([0.0, 0.1])), draw(st.booleans())
    halves = []
    for _ in range(draw(st.integers(4, 7))):
        heights = rng.choice([0.0, 1e-7, 0.3, 1.0, 2.0, 5.0], size=2)
        heights[1] = draw(st.sampled_from([heights[0], heights[1]]))
        for x, height in zip((np.arange(n + 1.0), n + np.arange(n + 1.0)), heights, strict=True):
            z = height + rough * rng.uniform(-1, 1, (n + 1) ** 2)
            z[rng.integers(len(z))] += 3.0 * (spike and rng.random() < 0.3)
            halves.append(Mesh(*lattice(n, n, x, np.arange(n + 1.0), z, rng.random(n * n) < 0.5)))
    mesh = together(*halves)
    return Mesh(mesh.vertices + np.array([*draw(st.sampled_from(OFFSETS)), 0.0]), mesh.faces)


def hard_meshes():
    ground = cut_up(grids())
    sheets = st.one_of(layered(ground), layered(slivers()), cut_twice())
    return st.one_of(grids(), ground, sheets, soups(), slivers(), cliffs(), stacks())


def points_on(mesh, rng, n):
    """Points on vertices and edges, one ulp off, inside faces, and anywhere."""
    corners = mesh.triangles[rng.integers(len(mesh.faces), size=n)][:, :, :2]
    share = rng.choice([0.0, 0.25, 0.5, 1.0, 0.3], size=(n, 1))
    on_edges = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
    beside = np.nextafter(on_edges, on_edges + rng.choice([-1.0, 0.0, 1.0], size=on_edges.shape))
    weights = rng.dirichlet([1, 1, 1], size=n)
    low, high = mesh.bounds[:, :2]
    anywhere = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), size=(n, 2))
    rim = np.where(rng.random((4, 2)) < 0.5, low, high)
    return np.concatenate([on_edges, beside, np.einsum("nij,ni->nj", corners, weights), anywhere, rim])


def assert_exact(mesh, seed, xy=None):
    xy = points_on(mesh, np.random.default_rng(seed), 12) if xy is None else xy
    hits = Terrain(mesh).top_hits(xy)
    exact = exact_tops(mesh, xy)
    assert hits.face.tolist() == [-1 if top is None else top.face for top in exact]
    assert (np.isnan(hits.z) == ~hits.hit).all()
    assert (np.isnan(hits.normal) == ~hits.hit[:, None]).all()
    ground = np.abs(mesh.vertices[mesh.faces][:, :, 2]).max()
    for z, normal, top in zip(hits.z, hits.normal, exact, strict=True):
        if top is not None:
            assert abs(z - top.z) <= HEIGHT_ULPS * float(np.spacing(ground))
            assert angle(normal, top.normal) <= NORMAL_ERROR


@given(st.lists(hard_meshes(), min_size=1, max_size=3), st.integers(0, 2**32 - 1))
def test_certified_equals_the_exact_rule_on_every_hard_case_and_on_some_together(meshes, seed):
    assert_exact(together(*meshes), seed)


@pytest.mark.parametrize("case", list(cases(60)), ids=lambda case: case[0])
def test_certified_equals_the_exact_rule_on_thousands_of_faces(case):
    assert_exact(case[1], 0, xy=case[2])
