import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge
from hulldown.placement.exact import ExactGround
from hulldown.placement.ground import Ground
from hulldown.placement.sheet_map import UNKNOWN, SheetMap
from hulldown.placement.terrain import Terrain
from hulldown.placement.top_sheet import TopSheet
from hulldown.tests.oracles.top_hits import exact_tops
from hulldown.tests.shapes import sheet, surface

METHODS = ["certified", "refined", "float32"]


def hills(n, *, seed=0):
    """n x n quads of 1 m, jittered and rough."""
    rng = np.random.default_rng(seed)
    x = np.arange(n + 1.0)
    level = surface(x, x, rng.uniform(-1, 1, (n + 1, n + 1)))
    return Mesh(
        level.vertices + np.pad(rng.uniform(-0.3, 0.3, ((n + 1) ** 2, 2)), ((0, 0), (0, 1))), level.faces, "hills"
    )


@pytest.mark.parametrize("method", METHODS)
def test_points_at_the_limits_of_float64_miss_without_a_warning(method):
    far = np.array([[1e308, -1e308], [-1e308, 1e308], [5e-324, -1e308], [1.7e308, 1.7e308]])
    hits = Terrain(hills(5)).top_hits(np.concatenate([np.tile(far, (2000, 1)), [[2.5, 2.5]]]), method=method)
    assert hits.hit.tolist() == [False] * 8000 + [True]


def counts(mesh, xy):
    """The certified number of sheets at each point."""
    return sheet_map(mesh, Ground.of(mesh)).count(*np.array(xy, dtype=float).T.copy())


def sheet_map(mesh, ground):
    low, high = ground.boxes()
    bounds = np.stack([low[:2].min(axis=1), high[:2].max(axis=1)])
    return SheetMap(mesh.vertices, ground.corners, bounds, ExactGround(ground, low, high).count)


def test_clean_ground_is_certified_as_one_sheet_and_holes_as_empty():
    ground = hills(20)
    kept = np.abs(ground.triangles[:, :, :2] - 10).max(axis=(1, 2)) > 4
    holed = Mesh(ground.vertices, ground.faces[kept])
    xy = np.random.default_rng(0).uniform(1, 19, (2000, 2))
    assert (counts(ground, xy) == 1).all()
    assert (counts(holed, xy[np.abs(xy - 10).max(axis=1) > 6]) == 1).all()
    at = [[10, 10], [0, 10], [-9, 10], [40, 1e9]]  # in the hole, on the border, and outside
    assert counts(holed, at).tolist() == [0, UNKNOWN, 0, 0]


def test_sheets_over_each_other_are_counted():
    ground = hills(20)
    lower = Mesh(ground.vertices - [0, 0, 0.01], ground.faces[:, ::-1])
    xy = np.random.default_rng(0).uniform(1, 19, (2000, 2))
    assert (counts(merge([lower, ground, ground])[0], xy) == 3).all()
    both, alone = (Terrain(mesh).top_hits(xy) for mesh in (merge([lower, ground])[0], ground))
    assert np.array_equal(both.face, alone.face + len(ground.faces))


def test_the_top_of_many_sheets_is_certain_from_its_height_alone():
    ground = hills(60)
    layers = [Mesh(ground.vertices * [1, 1, 0.2] - [0, 0, 1.0 * i], ground.faces) for i in range(20)]
    mesh, alone = merge(layers)[0], Terrain(layers[0])
    xy = np.random.default_rng(0).uniform(1, 59, (2000, 2))
    hits = Terrain(mesh).top_hits(xy)
    assert np.array_equal(hits.face, alone.top_hits(xy).face)
    x, y = xy.T.copy()
    top = top_sheet(mesh, lambda x, y: (0j * x, z := alone.top_hits(np.column_stack([x, y])).z, z - 1.0))
    assert top.has(x, y, hits.z).mean() > 0.9
    assert not top.has(x, y, hits.z - 1.0).any()


U, Y = np.linspace(0, 10, 21), np.linspace(0, 10, 41)


def level(z, u=U, y=Y):
    return surface(u, y, np.full((len(u), len(y)), z))


STEP = np.insert(U, 11, 5.05)
RISES = {  # and from where on
    "by a ramp": (5.05, surface(STEP, Y, np.tile(np.where(STEP > 5, 12.0, 5.0)[:, None], len(Y)))),
    "at edges that meet seen from above": (5.0, level(5.0, U[:11]), level(12.0, U[10:])),
    "as two large faces": (6.7, surface(U[::20], Y[::40], np.array([[-50.0, -50.0], [40.0, 40.0]]))),
}


@pytest.mark.parametrize(("start", "risen"), [(a, b) for a, *b in RISES.values()], ids=RISES)
def test_a_sheet_that_rises_above_the_top_is_seen_in_cells_that_were_judged_beside_it(start, risen):
    layers = [level(10.0), level(1.0), level(2.0), *risen]
    tilt = np.array([[1, 0, -9], [0.2, 1, 0], [0, 0, 1]])  # edges across cells, and a slope
    mesh = merge([Mesh(m.vertices @ tilt, m.faces) for m in layers])[0]

    def guess(x, y):
        return 0j * x + (-9 + 1.8j), 10.0 - 9 * (x - 0.2 * y), 5.0 - 9 * (x - 0.2 * y)

    u, y = np.random.default_rng(0).uniform([0, 0], [10, 10], (20_000, 2)).T
    passes = top_sheet(mesh, guess).has(u + 0.2 * y, y, 10.0 - 9 * u)
    assert not passes[u > start].any()
    assert len(risen[0].faces) == 2 or passes[(u > 1) & (u < 4)].mean() > 0.5  # a large face's corners are far up


def top_sheet(mesh, guess):
    ground = Ground.of(mesh)
    return TopSheet(sheet_map(mesh, ground), ground, ground.boxes(), 1e-12, guess)


def test_a_long_border_across_many_cells_is_marked_along_its_length():
    large = sheet((0, 0), (1000, 1000))  # its diagonal is no border; a strip placed across it has two
    strip = Mesh(np.array([[100.0, 0, 1], [103.0, 0, 1], [900.0, 1000, 1]]), np.array([[0, 1, 2]]))
    xy = np.column_stack([np.linspace(101, 899, 300), np.linspace(0.1, 999, 300)])
    assert not (counts(merge([large, hills(40), strip])[0], xy) == 1).any()


def test_threads_and_batches_change_nothing():
    terrain = Terrain(hills(30))
    xy = np.random.default_rng(1).uniform(-1, 31, (200_005, 2))  # several blocks
    one, three, few = terrain.top_hits(xy), terrain.top_hits(xy, threads=3), terrain.top_hits(xy[:9])
    for field in ("z", "normal", "face"):
        np.testing.assert_array_equal(getattr(one, field), getattr(three, field))
        np.testing.assert_array_equal(getattr(one, field)[:9], getattr(few, field))


@pytest.mark.parametrize("method", METHODS)
def test_the_methods_agree_where_float32_is_enough(method):
    land = hills(30)
    mesh = Mesh(land.vertices, np.concatenate([land.faces[::2], land.faces[1::2, ::-1]]))
    xy = np.random.default_rng(2).uniform(-9, 39, (5000, 2))
    certified, other = Terrain(mesh).top_hits(xy), Terrain(mesh).top_hits(xy, method=method)
    assert (certified.face == other.face).mean() > 0.999
    assert np.isnan(other.z[~other.hit]).all()
    assert np.isnan(other.normal[~other.hit]).all()
    same = other.hit & (certified.face == other.face)
    np.testing.assert_allclose(other.z[same], certified.z[same], atol=1e-5)
    np.testing.assert_allclose(other.normal[same], certified.normal[same], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(other.normal[same], axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_the_plane_is_hit_everywhere(method):
    plane = Terrain(2.5)
    hits = plane.top_hits([[0, 0], [1e9, -1e9]], method=method)
    assert hits.face.tolist() == [0, 0]
    assert hits.z.tolist() == [2.5, 2.5]
    assert hits.normal.tolist() == [[0, 0, 1]] * 2
    np.testing.assert_array_equal(plane.bounds, [[-np.inf, -np.inf, 2.5], [np.inf, np.inf, 2.5]])


def test_unused_vertices_can_be_anywhere():
    mesh = sheet((0, 0), (10, 10), 1.0)
    stray = Mesh(np.vstack([mesh.vertices, [1e300, -1e300, 1e300]]), mesh.faces)
    assert Terrain(stray).top_hits([[5, 5]]).z.tolist() == [1.0]


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-30, 1e29])
def test_ground_of_any_size_works(scale):
    mesh = hills(3)
    mesh = Mesh(mesh.vertices * scale, mesh.faces)
    xy = np.random.default_rng(3).uniform(-1, 4, (40, 2)) * scale
    exact = exact_tops(mesh, xy)
    assert Terrain(mesh).top_hits(xy).face.tolist() == [-1 if t is None else t.face for t in exact]
