"""Properties of labels, and figures in bins of them."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hulldown.dataset.attributes import viewing_distance_and_angles
from hulldown.tests.builders.detections import dataset, loaded, matched, random_case, results
from hulldown.training.evaluation.bins import binned_fields, figures_by_bin


def posed(axis, degrees, at=(0.0, 0.0, 0.0)):
    """A pose turned about an axis."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), at
    return pose.tolist()


def camera_at(*place):
    return posed("z", 0.0, place)


AWAY, OFF = {"world_from_camera": camera_at(103, 200, 31)}, {"world_from_vehicle": posed("z", 30, (100, 196, 19))}
STORED = {"world_from_vehicle": posed("z", 0), "distance": 300.0}
VALUES = [
    *(("visible_fraction", {}, {"visible_fraction": share}, name)
      for share, name in ((0.1, "under 25 %"), (0.9, "90 to 100 %"), (1.0, "100 %"), (1, "100 %"))),
    ("distance", AWAY, OFF, "under 25 m"),
    ("distance", {"world_from_camera": camera_at(13, 0, 0)}, STORED, "200 to 400 m"),
]  # fmt: skip


@pytest.mark.parametrize(("field", "image", "label", "name"), VALUES)
def test_every_value_has_its_bin_and_stored_ones_come_first(field, image, label, name):
    coco = dataset([(1, 1, (0, 0, 30, 30), label)])
    coco["images"][0] |= image
    labels, predictions = loaded(coco, [])
    assert {one.name: one.bins[one.of_label[0]] for one in binned_fields(labels, predictions)}[field] == name


def test_distance_elevation_and_side_are_those_of_the_camera_from_the_target():
    vehicle, camera = (np.array([one], dtype=float) for one in (OFF["world_from_vehicle"], AWAY["world_from_camera"]))
    distance, elevation, azimuth = viewing_distance_and_angles(vehicle[:, :3, 3], vehicle, camera)
    assert distance[0] == pytest.approx(13)
    assert elevation[0] == pytest.approx(math.degrees(math.asin(12 / 13)))
    assert azimuth[0] == pytest.approx(math.degrees(math.atan2(4, 3)) - 30)


def test_other_formats_of_poses_are_left_out():
    boxes = [
        (1, 1, (0, 0, 9, 9), {"world_from_vehicle": pose}) for pose in (posed("z", 0), [1, 2, 3], "here", None, [["a"] * 4] * 4)
    ]
    coco = dataset([*boxes, (1, 1, (0, 0, 9, 9), {"iscrowd": 1, "visible_fraction": 0.5})])
    coco["images"][0]["world_from_camera"] = camera_at(60, 0, 0)
    by_name = {field.name: field for field in binned_fields(*loaded(coco, []))}
    assert by_name["distance"].of_label.tolist() == [0, -1, -1, -1, -1, -1]
    assert by_name["distance"].bins == ("50 to 100 m",)
    assert "visible_fraction" not in by_name  # known of a crowd alone


def binned(coco, found):
    seen = matched(coco, found).with_threshold(0.3)
    return [figures_by_bin(field, seen) for field in binned_fields(seen.labels, seen.predictions)], seen


@pytest.mark.parametrize("seed", range(5))
def test_bins_add_up_to_the_whole(seed):
    coco, found = random_case(seed, crowds=0.2)
    figures, seen = binned(coco, found)
    assert {one.field.name for one in figures} == {"class", "box_size"}
    for one in figures:
        assert one.found.sum() == seen.found.sum()
        assert (one.labels - one.found).sum() == seen.missed.sum()
        assert one.detections.sum() == (seen.true | seen.false).sum()
        assert np.nansum(one.precision * one.detections) == pytest.approx(seen.true.sum())


def test_figures_of_bins_by_hand():
    boxes = [(1, 1, (0, 0, 10, 10)), (1, 1, (100, 0, 100, 100)), (1, 1, (300, 0, 100, 100))]
    found = [(1, 1, (100, 0, 100, 80), 0.9), (1, 1, (500, 0, 10, 10), 0.9)]
    size = next(one for one in binned(dataset(boxes), results(found))[0] if one.field.name == "box_size")
    assert size.field.bins == ("under 16 px", "64 to 96 px", "96 to 192 px")
    assert size.labels.tolist() == [1, 0, 2]
    assert size.recall.tolist()[::2] == [0, 0.5]
    assert size.precision.tolist()[:2] == [0, 1]
    assert size.mean_iou[2] == pytest.approx(0.8)
    assert np.isnan(size.recall_interval).all()  # one position


def test_images_of_one_position_widen_the_interval_of_a_bin():
    boxes = [(1 + k, 1, (60, 60, 10, 10)) for k in range(40)]
    coco = dataset(boxes, images=40)
    widths = []
    for shots in (1, 4):
        for k, image in enumerate(coco["images"]):
            image |= {"scenery": "hills", "position": k // shots}
        figures, _ = binned(coco, results([(*box, 0.9) for box in boxes[:20]]))
        widths.append(float(np.ptp(figures[0].recall_interval[0])))
    assert widths[1] > 1.7 * widths[0]
