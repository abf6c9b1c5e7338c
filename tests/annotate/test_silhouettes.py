import math

import numpy as np

from hulldown.annotate.boxes import VehicleBoxes
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rigid_matrix
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.ray_caster import RayCaster
from hulldown.tests.builders.shapes import CORNERS, FACES, vehicle_of

CUBE = 2.0 * CORNERS - 1.0
# Looks along +y of the world with z up; fov_x of 90 degrees makes f_px half the width.
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
CAMERA = Cameras(Intrinsics(200, 100, math.pi / 2), rigid_matrix(AXES, [0.0, -5.0, 0.0]))
SHAPE = vehicle_of(Mesh(CUBE, FACES), name="cube")
HERE = PosedVehicle(VehicleCaster(SHAPE), np.eye(4)[None], {})


def visible(vehicle: PosedVehicle, camera: Cameras, **options) -> np.ndarray:
    return whole_and_visible_masks(vehicle, camera, **options)[1]


def square(x: int, y: int, w: int, h: int) -> np.ndarray:
    mask = np.zeros((100, 200), dtype=bool)
    mask[y : y + h, x : x + w] = True
    return mask


def test_only_the_box_is_rendered_and_nothing_is_lost():
    box = VehicleBoxes(SHAPE).box(np.eye(4), CAMERA)
    assert np.array_equal(visible(HERE, CAMERA, xywh=box), visible(HERE, CAMERA))
    assert np.array_equal(visible(HERE, CAMERA, xywh=[80.0, 30.0, 10.0, 10.0]), square(80, 30, 10, 10))
    # A pixel belongs to the box that contains its center.
    assert np.array_equal(visible(HERE, CAMERA, xywh=[80.6, 30.4, 9.8, 10.0]), square(81, 30, 9, 10))


def test_objects_in_front_hide_and_objects_behind_do_not():
    wall = CUBE * [1.0, 0.1, 1.0] + [1.0, -3.0, 0.0]
    assert np.array_equal(visible(HERE, CAMERA, world=Scene(RayCaster(Mesh(wall, FACES)))), square(75, 25, 25, 50))
    behind = RayCaster(Mesh(wall + np.array([0.0, 9.0, 0.0]), FACES))
    assert np.array_equal(visible(HERE, CAMERA, world=Scene(behind)), square(75, 25, 50, 50))


def test_nothing_before_the_near_plane_is_visible():
    close = Cameras(CAMERA.lenses, rigid_matrix(AXES, [0.0, -1.0 - NEAR_M / 2.0, 0.0]))
    # The near face is cut away, so the walls behind it fill the image.
    assert visible(HERE, close).all()
    away = Cameras(CAMERA.lenses, rigid_matrix(AXES, [0.0, 1.0 - NEAR_M / 2.0, 0.0]))
    assert not visible(HERE, away).any()


def test_the_mask_is_empty_outside_the_image():
    assert not visible(PosedVehicle(HERE.caster, rigid_matrix(np.eye(3), [99.0, 0.0, 0.0])[None], {}), CAMERA).any()
    assert not visible(HERE, CAMERA, xywh=[10.2, 10.2, 0.2, 0.2]).any()
