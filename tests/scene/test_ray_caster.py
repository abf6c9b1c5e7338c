import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.scene.ray_caster import RAYS_PER_BLOCK, RayCaster, coherent_index_blocks
from hulldown.tests.builders.shapes import sheet

# A floor of 2 m by 2 m and, 1 m above a quarter of it, a roof.
HOUSE, _ = merge_meshes_with_sources([sheet((-1, -1), (1, 1)), sheet((0, 0), (1, 1), 1.0)], name="house")
DOWN = [0.0, 0.0, -1.0]


def test_the_first_face_is_hit_at_a_distance_in_meters_for_directions_of_any_length():
    hits = RayCaster(HOUSE).cast([[0.75, 0.25, 3], [-0.25, -0.5, 3], [5, 5, 3]], [DOWN, [0, 0, -7], DOWN])
    assert hits.face.tolist() == [2, 0, -1]
    np.testing.assert_allclose(hits.distance, [2, 3, np.inf], rtol=1e-6)
    assert hits.hit.tolist() == [True, True, False]


@pytest.mark.parametrize("offset", [[5e5, 5.4e6, 0], [1e7, -1e7, 1e7]])
def test_map_coordinates_keep_all_digits(offset):
    rng = np.random.default_rng(1)
    origins, directions = rng.uniform(-3, 3, (2000, 3)), rng.normal(size=(2000, 3))
    near = RayCaster(HOUSE).cast(origins, directions)
    far = RayCaster(Mesh(HOUSE.vertices + offset, HOUSE.faces)).cast(origins + offset, directions)
    assert (near.face != far.face).mean() < 1e-3
    same = near.hit & (near.face == far.face)
    np.testing.assert_allclose(far.distance[same], near.distance[same], rtol=0, atol=1e-5)


def test_a_distant_origin_keeps_all_digits():
    rng = np.random.default_rng(2)
    targets = np.column_stack([rng.uniform(-1, 1, (1000, 2)), np.zeros(1000)])
    directions = np.array([1.0, 2.0, -2.0]) / 3
    hits = RayCaster(HOUSE).cast(targets - 1e6 * directions, np.tile(directions, (1000, 1)))
    open_ = hits.hit & (hits.face < 2)
    assert open_.sum() > 500
    np.testing.assert_allclose(hits.distance[open_], 1e6, rtol=0, atol=1e-5)


def test_batches_change_nothing():
    rng = np.random.default_rng(3)
    n = 200_005  # several blocks
    origins, directions = rng.uniform(-3, 3, (n, 3)), rng.normal(size=(n, 3))
    caster = RayCaster(HOUSE)
    many, occluded = caster.cast(origins, directions), caster.occluded(origins, directions)
    for some in (50, 0):
        few = caster.cast(origins[:some], directions[:some])
        np.testing.assert_array_equal(few.face, many.face[:some])
        np.testing.assert_array_equal(few.distance, many.distance[:some])
        np.testing.assert_array_equal(caster.occluded(origins[:some], directions[:some]), occluded[:some])


def test_five_thousand_casters_coexist():
    floors = [Mesh(HOUSE.vertices + np.array([0, 0, height]), HOUSE.faces) for height in range(5000)]
    casters = [RayCaster(floor) for floor in floors]  # with a separate device each, the process crashed at about 1,000
    met = np.array([caster.top_face(np.array([-0.25]), np.array([-0.5]))[0] for caster in casters])
    assert (met == 0).all()


@pytest.mark.parametrize("n", [0, 1, 5000, 3 * RAYS_PER_BLOCK])
def test_blocks_contain_every_point_once_and_neighbors_together(n):
    points = np.random.default_rng(4).uniform(0, 100, (n, 2))
    order = np.concatenate(list(coherent_index_blocks(points)))
    assert np.sort(order).tolist() == list(range(n))
    if n > 4096:
        step = np.abs(np.diff(points[order], axis=0)).sum(axis=1)
        assert np.median(step) < 3.0  # random points are 67 apart
