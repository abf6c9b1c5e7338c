import numpy as np

from hulldown.scene.instances import InstancedScene
from hulldown.scene.rays import RayList
from hulldown.tests.builders.shapes import box

CUBE = box((-1, -1, 0), (1, 1, 2), "cube")


def at(*position, stretch=(1.0, 1.0, 1.0)):
    pose = np.diag([*stretch, 1.0])
    pose[:3, 3] = position
    return pose


def test_a_short_ray_near_a_pebble_in_a_wide_scene_hits_it():
    # Boxes are widened by the scene's extent before Embree skips idle rays: here to a hundred times the pebble.
    scene = InstancedScene([CUBE], [0] * 20, [at(x, 0, 0, stretch=(0.01,) * 3) for x in np.linspace(0, 1e5, 20)])
    ray = RayList([[0.0, 0.0, 0.03]], [[0.0, 0.0, -1.0]])
    assert scene.occlusion(ray, max_distance=0.02).all()
    assert scene.first_hits(ray, max_distance=0.02).instance.tolist() == [0]
