import numpy as np
import pytest

from hulldown.geometry.instances import InstancedScene
from hulldown.geometry.meshes import Mesh, merge
from hulldown.geometry.rays import RayCaster
from hulldown.geometry.transforms import apply
from hulldown.tests.shapes import box

CUBE = box((-1, -1, 0), (1, 1, 2), "cube")


def soup(rng, faces, name="soup"):
    """Loose triangles about the unit ball."""
    corners = rng.normal(0, 0.5, (faces, 1, 3)) + rng.normal(0, 0.2, (faces, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3), name)


def at(*position, stretch=(1.0, 1.0, 1.0)):
    pose = np.diag([*stretch, 1.0])
    pose[:3, 3] = position
    return pose


def merged(meshes, instance_mesh, poses):
    return merge(
        [Mesh(apply(p, meshes[m].vertices), meshes[m].faces) for m, p in zip(instance_mesh, poses, strict=True)]
    )


@pytest.mark.parametrize("stretch", [(-1, 1, 1), (5, 0.2, 1), (-0.01, 1, -300)])
def test_distances_are_meters_of_the_world_in_mirrored_and_stretched_copies(stretch):
    scene = InstancedScene([CUBE], [0], [at(0, 0, 0, stretch=stretch)])
    center = np.array([0.1, 0.1, np.sign(stretch[2])]) * np.abs(stretch)
    side = np.eye(3)[0] * 1000
    hits = scene.cast([center + side], [-side])
    np.testing.assert_allclose(hits.distance, [1000 + center[0] - abs(stretch[0])], rtol=1e-7)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_copy_squashed_flat_still_stops_rays(axis):
    stretch = np.where(np.arange(3) == axis, 0.0, 1.0)
    scene = InstancedScene([CUBE], [0, 0], [at(0, 0, 0, stretch=stretch), at(50, 0, 0)])
    origin = np.array([0.3, 0.2, 0.4]) + 5 * np.eye(3)[axis]
    hits = scene.cast([origin], [-np.eye(3)[axis]])
    assert hits.instance.tolist() == [0]
    np.testing.assert_allclose(hits.distance, origin[axis], atol=1e-5)


def test_a_scene_of_nothing_is_never_hit():
    for meshes in ([], [CUBE]):
        scene = InstancedScene(meshes, [], np.zeros((0, 4, 4)))
        assert scene.bounds.shape == (0, 2, 3)
        assert not scene.cast([[0, 0, 0]], [[0, 0, 1]]).hit.any()
        assert not scene.occluded([[0, 0, 0]], [[0, 0, 1]]).any()


def test_a_short_ray_beside_a_pebble_in_a_wide_scene_meets_it():
    # Boxes are widened by the scene's extent before Embree sorts out idle rays: here to a hundred times the pebble.
    scene = InstancedScene([CUBE], [0] * 20, [at(x, 0, 0, stretch=(0.01,) * 3) for x in np.linspace(0, 1e5, 20)])
    origin, down = [[0.0, 0.0, 0.03]], [[0.0, 0.0, -1.0]]
    assert scene.occluded(origin, down, max_distance=0.02).all()
    assert scene.cast(origin, down, max_distance=0.02).instance.tolist() == [0]


def test_no_rays_are_legal():
    scene = InstancedScene([CUBE], [0], [np.eye(4)])
    assert scene.cast(np.zeros((0, 3)), np.zeros((0, 3))).distance.shape == (0,)
    assert scene.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize("offset", [0.0, 5.4e6])
def test_a_thousand_copies_answer_as_the_merged_mesh_does(offset):
    rng = np.random.default_rng(5)
    meshes = [soup(rng, 60), soup(rng, 5), CUBE]
    poses = np.tile(np.eye(4), (1000, 1, 1))
    poses[:, :3, :3] = rng.normal(0, 1, (1000, 3, 3))
    poses[:, :3, 3] = rng.uniform(-60, 60, (1000, 3)) * [1, 1, 0.05] + offset
    which = rng.integers(0, 3, 1000)
    flat, source = merged(meshes, which, poses)
    caster, scene = RayCaster(flat), InstancedScene(meshes, which, poses)
    origins = rng.uniform(-70, 70, (20_000, 3)) * [1, 1, 0.1] + offset
    directions = rng.normal(size=(20_000, 3)) * [1, 1, 0.1]
    ours, theirs = scene.cast(origins, directions), caster.cast(origins, directions)
    # A ray along an edge may fall to either side in float32; one in ten thousand is far above what was seen.
    same = (ours.instance == np.where(theirs.hit, source[theirs.face], -1)) & (ours.hit == theirs.hit)
    assert (~same).sum() <= 2
    both = same & ours.hit
    assert 0.3 < both.mean() < 1
    # float32 about a scene of 200 m: 24 bits leave 1.2e-5 m, and grazing hits magnify it.
    np.testing.assert_allclose(ours.distance[both], theirs.distance[both], atol=2e-3)
    assert (scene.occluded(origins, directions) != theirs.hit).sum() <= 2
    limit = rng.uniform(0, 30, 20_000)
    assert (scene.occluded(origins, directions, max_distance=limit) != (theirs.distance <= limit)).sum() <= 2
    np.testing.assert_array_equal(
        scene.cast(origins, directions, max_distance=limit).hit, scene.occluded(origins, directions, max_distance=limit)
    )


@pytest.mark.parametrize(
    ("which", "poses", "message"),
    [
        ([1], [np.eye(4)], "instance_mesh: expected indices below 1, got 1 to 1"),
        ([-1], [np.eye(4)], "instance_mesh: expected indices below 1"),
        ([0, 0], [np.eye(4)], r"instance_mesh: expected shape \(1,\), got \(2,\)"),
        ([0], [2 * np.eye(4)], r"world_from_instance: expected last rows \(0, 0, 0, 1\)"),
        ([0], [np.full((4, 4), np.nan)], "world_from_instance: expected finite numbers"),
    ],
)
def test_a_wrong_scene_names_the_argument(which, poses, message):
    with pytest.raises(ValueError, match=message):
        InstancedScene([CUBE], which, poses)


def test_a_direction_of_zero_is_refused():
    scene = InstancedScene([CUBE], [0], [np.eye(4)])
    with pytest.raises(ValueError, match="directions: expected lengths above zero, got a zero at index 1"):
        scene.cast(np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]])
