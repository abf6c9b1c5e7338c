import math

import numpy as np
import pytest

from hulldown.annotate.boxes import VehicleBoxes
from hulldown.annotate.masks import decode, extent, vehicle_mask
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR, Camera
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.rays import RayCaster
from hulldown.geometry.transforms import rigid
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleTarget
from hulldown.tests.shapes import CORNERS, FACES, vehicle_of

CUBE = 2.0 * CORNERS - 1.0
# Looks along +y of the world with z up; fov_x of 90 degrees makes f_px half the width.
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
CAMERA = Camera(Intrinsics(200, 100, math.pi / 2), rigid(AXES, [0.0, -5.0, 0.0]))
SHAPE = vehicle_of(Mesh(CUBE, FACES), name="cube")
HERE = PosedVehicle(VehicleTarget(SHAPE), np.eye(4)[None], {})


def square(x: int, y: int, w: int, h: int) -> np.ndarray:
    mask = np.zeros((100, 200), dtype=bool)
    mask[y : y + h, x : x + w] = True
    return mask


def test_only_the_box_is_rendered_and_nothing_is_lost():
    box = VehicleBoxes(SHAPE).box(np.eye(4), CAMERA)
    assert np.array_equal(vehicle_mask(HERE, CAMERA, xywh=box), vehicle_mask(HERE, CAMERA))
    assert np.array_equal(vehicle_mask(HERE, CAMERA, xywh=[80.0, 30.0, 10.0, 10.0]), square(80, 30, 10, 10))
    # A pixel belongs to the box that contains its center.
    assert np.array_equal(vehicle_mask(HERE, CAMERA, xywh=[80.6, 30.4, 9.8, 10.0]), square(81, 30, 9, 10))


def test_objects_in_front_hide_and_objects_behind_do_not():
    wall = CUBE * [1.0, 0.1, 1.0] + [1.0, -3.0, 0.0]
    assert np.array_equal(vehicle_mask(HERE, CAMERA, world=Scene(RayCaster(Mesh(wall, FACES)))), square(75, 25, 25, 50))
    behind = RayCaster(Mesh(wall + np.array([0.0, 9.0, 0.0]), FACES))
    assert np.array_equal(vehicle_mask(HERE, CAMERA, world=Scene(behind)), square(75, 25, 50, 50))


def test_nothing_before_the_near_plane_is_visible():
    close = Camera(CAMERA.intrinsics, rigid(AXES, [0.0, -1.0 - NEAR / 2.0, 0.0]))
    # The near face is cut away, so the walls behind it fill the image.
    assert vehicle_mask(HERE, close).all()
    away = Camera(CAMERA.intrinsics, rigid(AXES, [0.0, 1.0 - NEAR / 2.0, 0.0]))
    assert not vehicle_mask(HERE, away).any()


def test_the_mask_is_empty_outside_the_image():
    assert not vehicle_mask(PosedVehicle(HERE.target, rigid(np.eye(3), [99.0, 0.0, 0.0])[None], {}), CAMERA).any()
    assert not vehicle_mask(HERE, CAMERA, xywh=[10.2, 10.2, 0.2, 0.2]).any()


def test_uncompressed_run_lengths_and_polygons_are_read():
    assert np.array_equal(decode({"size": [2, 3], "counts": [2, 2, 2]}, 3, 2), [[0, 1, 0], [0, 1, 0]])
    assert np.array_equal(decode([[1, 0, 3, 0, 3, 2, 1, 2]], 4, 3), [[0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0]])


def test_damaged_run_lengths_do_no_harm():
    """pycocotools writes beyond its memory with some of these, and crashes then or later."""
    rng = np.random.default_rng(0)
    refused = 0
    for text in rng.integers(40, 120, (2000, 24), dtype=np.uint8):
        record = {"size": [13, 17], "counts": bytes(text[: rng.integers(1, 25)]).decode("ascii")}
        try:
            assert decode(record, 17, 13).shape == (13, 17)
        except ValueError:
            refused += 1
    assert refused > 1900


LENGTHS = [None, 5, {}, "zzz", "", "o", "0 0", "\u00e9", "oooooooo0", "1", [-1], [99], [3], ["a"], [[None]], [10**30]]


@pytest.mark.parametrize(
    "segmentation",
    [
        *(5, "x", [1], [], [[1, 2, 3, 4]], {"size": [3, 4]}),
        *({"size": size, "counts": "0"} for size in (3, [4, 3])),
        *([[wrong] * 6] for wrong in ("a", None, 1e9)),
        *({"size": [3, 4], "counts": counts} for counts in LENGTHS),
    ],
)
def test_invalid_segmentations_are_refused(segmentation):
    with pytest.raises(ValueError, match="segmentation: expected"):
        decode(segmentation, 4, 3)


def test_a_mask_of_40_000_million_pixels_needs_no_memory():
    n = 200_000
    pixels, box = extent({"size": [n, n], "counts": [5 * n + 7, 3, n * n - 5 * n - 10]}, n, n)
    assert (pixels, box.tolist()) == (3, [5.0, 7.0, 1.0, 3.0])
    with pytest.raises(ValueError, match="pixels at most"):
        extent([[0, 0, 5, 0, 5, 5]], n, n)
