"""3D boxes of labels: they contain the vehicle, project onto it, and are checked."""

import copy
import math

import numpy as np
import pytest

from hulldown.annotate.label_list import invalid_label_field_sentences
from hulldown.annotate.labels.box_3d import Box3D, BoxInCamera
from hulldown.annotate.records import Image, Label
from hulldown.dataset.exports.layouts.kitti import kitti_label_line
from hulldown.dataset.row_records import planned_label_records
from hulldown.geometry.transforms import transform_points
from hulldown.tests.builders.planning_assets import plan, small_assets, small_config
from hulldown.tests.builders.shapes import vertices_at


@pytest.fixture(scope="module")
def assets():
    return small_assets()


@pytest.fixture(scope="module")
def rows(assets):
    return list(plan(small_config(), assets))


def points_of(assets, vehicle, row):
    """All vertices of a vehicle in its camera's frame."""
    points = transform_points(vehicle.world_from_vehicle, vertices_at(assets.vehicles[vehicle.vehicle], vehicle.articulation))
    return transform_points(np.linalg.inv(row.world_from_camera), points)


def test_the_box_contains_every_vertex_and_touches_some_on_each_side(assets, rows):
    for row in rows:
        for vehicle, record in zip(row.labeled, planned_label_records(row), strict=True):
            box = Box3D(**record["bbox_3d"])
            inside = (points_of(assets, vehicle, row) - box.center) @ np.array(box.rotation)
            np.testing.assert_allclose(inside.min(axis=0), -np.array(box.size) / 2, rtol=0, atol=1e-7)
            np.testing.assert_allclose(inside.max(axis=0), np.array(box.size) / 2, rtol=0, atol=1e-7)


def test_distance_and_azimuth_are_those_of_the_center(rows):
    for row in rows:
        label = planned_label_records(row)[0]
        assert label["distance"] == pytest.approx(np.linalg.norm(label["bbox_3d"]["center"]), abs=1e-8)
        middle = transform_points(row.world_from_camera, np.array([label["bbox_3d"]["center"]]))[0]
        eye = transform_points(np.linalg.inv(row.target.world_from_vehicle), row.world_from_camera[None, :3, 3])[0]
        eye = eye - transform_points(np.linalg.inv(row.target.world_from_vehicle), middle[None])[0]
        assert label["azimuth_seen"] == pytest.approx(math.atan2(eye[1], eye[0]), abs=1e-8)


def test_kittis_rotation_and_location_are_the_boxs(rows):
    for row in rows:
        label = planned_label_records(row)[0]
        of_image = {"id": 1, "image_id": 1, "category_id": 1}
        numbers = [float(word) for word in kitti_label_line(Label.from_record({**label, **of_image}, {1: "tank"})).split()[1:]]
        rotation, center = np.array(label["bbox_3d"]["rotation"]), np.array(label["bbox_3d"]["center"])
        ground = center - rotation[:, 2] * label["bbox_3d"]["size"][2] / 2
        np.testing.assert_allclose(numbers[10:13], ground, atol=1e-5)
        ahead = np.array([math.cos(numbers[13]), -math.sin(numbers[13])])  # x and z in the camera's frame
        level = rotation[[0, 2], 0] / np.linalg.norm(rotation[[0, 2], 0])
        np.testing.assert_allclose(ahead, level, atol=1e-5)


def turned(box):
    box["rotation"][0] = [-each for each in box["rotation"][0]]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda label: label.update(distance=label["distance"] + 1e-3), "distance is"),
        (lambda label: label["bbox_3d"].pop("size"), "bbox_3d is"),
        (lambda label: label.update(bbox_3d=[1, 2]), "bbox_3d is"),
        (lambda label: label["bbox_3d"].update(center=[0, 1e300, 1]), "bbox_3d is"),
        (lambda label: label["bbox_3d"].update(center="far"), "bbox_3d is"),
        (lambda label: label["bbox_3d"]["size"].__setitem__(1, 0.0), "has the size"),
        (lambda label: turned(label["bbox_3d"]), "rotation that is none"),
        (lambda label: label["bbox_3d"]["rotation"][1].__setitem__(0, 2.0), "rotation that is none"),
    ],
)
def test_an_invalid_box_is_found(rows, change, problem):
    label = copy.deepcopy(planned_label_records(rows[0])[0])
    label |= {"id": 1, "image_id": 1, "category_id": 1}
    image = Image.from_record({"id": 1, "file_name": "1.png", "width": 32, "height": 24}, ())

    def problems():
        found = Label.from_record(label, {})
        return list(invalid_label_field_sentences(label)) or list(found.read(BoxInCamera).problems(found, image, None))

    assert problems() == []
    change(label)
    (found,) = problems()
    assert problem in found
