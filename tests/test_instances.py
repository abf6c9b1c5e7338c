import numpy as np
import pytest

from hulldown.geometry.instances import InstancedScene
from hulldown.tests.shapes import box

CUBE = box((-1, -1, 0), (1, 1, 2), "cube")


def at(*position, stretch=(1.0, 1.0, 1.0)):
    pose = np.diag([*stretch, 1.0])
    pose[:3, 3] = position
    return pose


def test_empty_scenes_and_zero_rays_are_legal():
    for meshes in ([], [CUBE]):
        scene = InstancedScene(meshes, [], np.zeros((0, 4, 4)))
        assert scene.bounds.shape == (0, 2, 3)
        assert not scene.cast([[0, 0, 0]], [[0, 0, 1]]).hit.any()
        assert not scene.occluded([[0, 0, 0]], [[0, 0, 1]]).any()
    scene = InstancedScene([CUBE], [0], [np.eye(4)])
    assert scene.cast(np.zeros((0, 3)), np.zeros((0, 3))).distance.shape == (0,)
    assert scene.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_a_short_ray_near_a_pebble_in_a_wide_scene_hits_it():
    # Boxes are widened by the scene's extent before Embree skips idle rays: here to a hundred times the pebble.
    scene = InstancedScene([CUBE], [0] * 20, [at(x, 0, 0, stretch=(0.01,) * 3) for x in np.linspace(0, 1e5, 20)])
    origin, down = [[0.0, 0.0, 0.03]], [[0.0, 0.0, -1.0]]
    assert scene.occluded(origin, down, max_distance=0.02).all()
    assert scene.cast(origin, down, max_distance=0.02).instance.tolist() == [0]


@pytest.mark.parametrize(
    ("which", "poses", "message"),
    [
        ([1], [np.eye(4)], "instance_mesh: expected indices below 1, got 1 to 1"),
        ([-1], [np.eye(4)], "instance_mesh: expected indices below 1"),
        ([0, 0], [np.eye(4)], r"instance_mesh: expected shape \(1,\), got \(2,\)"),
        ([0], [2 * np.eye(4)], r"world_from_instance: expected last rows \(0, 0, 0, 1\)"),
    ],
)
def test_a_wrong_scene_names_the_argument(which, poses, message):
    with pytest.raises(ValueError, match=message):
        InstancedScene([CUBE], which, poses)
