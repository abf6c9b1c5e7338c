import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.placement.exact import ExactGround
from hulldown.placement.ground_faces import GroundFaces
from hulldown.placement.sheet_map import UNKNOWN_COUNT, SheetMap
from hulldown.placement.terrain import Terrain
from hulldown.tests.builders.shapes import sheet, surface
from hulldown.tests.oracles.top_hits import exact_tops


def hills(n, *, seed=0):
    """n x n quads of 1 m, jittered and rough."""
    rng = np.random.default_rng(seed)
    x = np.arange(n + 1.0)
    level = surface(x, x, rng.uniform(-1, 1, (n + 1, n + 1)))
    return Mesh(level.vertices + np.pad(rng.uniform(-0.3, 0.3, ((n + 1) ** 2, 2)), ((0, 0), (0, 1))), level.faces, "hills")


def test_points_at_the_limits_of_float64_miss_without_a_warning():
    far = np.array([[1e308, -1e308], [-1e308, 1e308], [5e-324, -1e308], [1.7e308, 1.7e308]])
    hits = Terrain(hills(5)).top_hits(np.concatenate([np.tile(far, (2000, 1)), [[2.5, 2.5]]]))
    assert hits.hit.tolist() == [False] * 8000 + [True]


def counts(mesh, xy):
    """The certified number of sheets at each point."""
    ground = GroundFaces.from_mesh(mesh)
    low, high = ground.face_boxes()
    bounds = np.stack([low[:2].min(axis=1), high[:2].max(axis=1)])
    sheets = SheetMap(mesh.vertices, ground.corners, bounds, ExactGround(ground, low, high).count)
    return sheets.count(*np.array(xy, dtype=float).T.copy())


def test_clean_ground_is_certified_as_one_sheet_and_holes_as_empty():
    ground = hills(20)
    kept = np.abs(ground.triangles[:, :, :2] - 10).max(axis=(1, 2)) > 4
    holed = Mesh(ground.vertices, ground.faces[kept])
    xy = np.random.default_rng(0).uniform(1, 19, (2000, 2))
    assert (counts(ground, xy) == 1).all()
    assert (counts(holed, xy[np.abs(xy - 10).max(axis=1) > 6]) == 1).all()
    at = [[10, 10], [0, 10], [-9, 10], [40, 1e9]]  # in the hole, on the border, and outside
    assert counts(holed, at).tolist() == [0, UNKNOWN_COUNT, 0, 0]


def test_sheets_over_each_other_are_counted():
    ground = hills(20)
    lower = Mesh(ground.vertices - [0, 0, 0.01], ground.faces[:, ::-1])
    xy = np.random.default_rng(0).uniform(1, 19, (2000, 2))
    assert (counts(merge_meshes_with_sources([lower, ground, ground])[0], xy) == 3).all()
    both, alone = (Terrain(mesh).top_hits(xy) for mesh in (merge_meshes_with_sources([lower, ground])[0], ground))
    assert np.array_equal(both.face, alone.face + len(ground.faces))


@pytest.mark.parametrize("sheets", [4, 20])
def test_the_top_of_many_sheets_is_that_of_the_highest_alone(sheets):
    ground = hills(20)
    layers = [Mesh(ground.vertices * [1, 1, 0.2] - [0, 0, 1.0 * i], ground.faces) for i in range(sheets)]
    xy = np.random.default_rng(0).uniform(1, 19, (2000, 2))
    assert np.array_equal(Terrain(merge_meshes_with_sources(layers)[0]).top_hits(xy).face, Terrain(ground).top_hits(xy).face)


def test_a_long_border_across_many_cells_is_marked_along_its_length():
    large = sheet((0, 0), (1000, 1000))  # its diagonal is no border; a strip placed across it has two
    strip = Mesh(np.array([[100.0, 0, 1], [103.0, 0, 1], [900.0, 1000, 1]]), np.array([[0, 1, 2]]))
    xy = np.column_stack([np.linspace(101, 899, 300), np.linspace(0.1, 999, 300)])
    assert not (counts(merge_meshes_with_sources([large, hills(40), strip])[0], xy) == 1).any()


def test_batches_change_nothing():
    terrain = Terrain(hills(30))
    xy = np.random.default_rng(1).uniform(-1, 31, (200_005, 2))  # several blocks
    many, few = terrain.top_hits(xy), terrain.top_hits(xy[:9])
    for field in ("z", "normal", "face"):
        np.testing.assert_array_equal(getattr(many, field)[:9], getattr(few, field))


def test_the_plane_is_hit_everywhere():
    plane = Terrain(2.5)
    hits = plane.top_hits([[0, 0], [1e9, -1e9]])
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
