"""Properties of labels, and figures in bins of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from hulldown.dataset.attributes import seen_from
from hulldown.dataset.images import LabeledImages
from hulldown.tests.detections import dataset, loaded, matched, random_case, results
from hulldown.training.evaluation.bins import fields, figures_of, measured_contrast, worst
from hulldown.training.evaluation.labels import labels_of
from hulldown.training.evaluation.predictions import predictions_of


def posed(axis, degrees, at=(0.0, 0.0, 0.0)):
    """A pose turned about an axis."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), at
    return pose.tolist()


def camera_at(*place):
    return posed("z", 0.0, place)


AWAY, OFF = {"world_from_camera": camera_at(103, 200, 31)}, {"world_from_vehicle": posed("z", 30, (100, 196, 19))}
STORED = {"world_from_vehicle": posed("z", 0), "distance": 300.0, "slope_deg": 12.0, "contrast": 0.15}
VALUES = [
    *(("azimuth_seen", {"world_from_camera": camera_at(*camera)}, {"world_from_vehicle": posed("z", yaw)}, side)
      for yaw, camera, side in (
        (0, (50, 0, 10), "front"), (0, (-50, 0, 10), "rear"), (0, (0, 50, 10), "side"), (0, (0, -50, 10), "side"),
        (90, (0, 50, 10), "front"), (180, (50, 1, 10), "rear"), (0, (50, 49, 10), "front"), (0, (49, 50, 10), "side"),
      )),
    *(("weather", {"weather": weather}, {}, name) for weather, name in (
        (None, "clear"), ({"visibility_m": 300}, "fog, under 500 m"), ({"visibility_m": 900.0}, "fog, 500 m to 2 km"),
        ({"visibility_m": 5000}, "fog, over 2 km"), ({"kind": "rain"}, "rain"),
        ({"kind": "rain", "visibility_m": 900.0}, "rain, 500 m to 2 km"), ("snow", "snow"),
    )),
    *(("slope", {}, {"world_from_vehicle": posed("y", degrees)}, name)
      for degrees, name in ((0, "under 5°"), (12, "10 to 15°"), (26, "25° and more"))),
    *(("visible_fraction", {}, {"visible_fraction": share}, name)
      for share, name in ((0.1, "under 25 %"), (0.9, "90 to 100 %"), (1.0, "100 %"), (1, "100 %"))),
    ("distance", AWAY, OFF, "under 25 m"), ("elevation", AWAY, OFF, "45° and more"),
    *((field, {"world_from_camera": camera_at(13, 0, 0)}, STORED, name)
      for field, name in (("distance", "200 to 400 m"), ("slope", "10 to 15°"), ("contrast", "0.1 to 0.2"))),
]  # fmt: skip


@pytest.mark.parametrize(("field", "image", "label", "name"), VALUES)
def test_every_value_has_its_bin_and_stored_ones_come_first(field, image, label, name):
    coco = dataset([(1, 1, (0, 0, 30, 30), label)])
    coco["images"][0] |= image
    labels, predictions = loaded(coco, [])
    assert {one.name: one.bins[one.of_label[0]] for one in fields(labels, predictions)}[field] == name


def test_distance_elevation_and_side_are_those_of_the_camera_from_the_target():
    vehicle, camera = (np.array([one], dtype=float) for one in (OFF["world_from_vehicle"], AWAY["world_from_camera"]))
    distance, elevation, azimuth = seen_from(vehicle[:, :3, 3], vehicle, camera)
    assert distance[0] == pytest.approx(13)
    assert elevation[0] == pytest.approx(math.degrees(math.asin(12 / 13)))
    assert azimuth[0] == pytest.approx(math.degrees(math.atan2(4, 3)) - 30)


def test_other_formats_of_poses_are_left_out():
    boxes = [
        (1, 1, (0, 0, 9, 9), {"world_from_vehicle": pose})
        for pose in (posed("z", 0), [1, 2, 3], "here", None, [["a"] * 4] * 4)
    ]
    coco = dataset([*boxes, (1, 1, (0, 0, 9, 9), {"iscrowd": 1, "visible_fraction": 0.5})])
    coco["images"][0]["world_from_camera"] = camera_at(60, 0, 0)
    by_name = {field.name: field for field in fields(*loaded(coco, []))}
    assert by_name["distance"].of_label.tolist() == [0, -1, -1, -1, -1, -1]
    assert by_name["distance"].bins == ("50 to 100 m",)
    assert "visible_fraction" not in by_name  # known of a crowd alone


def test_the_rarest_of_many_names_share_a_bin():
    boxes = [(1, 1, (0, 0, 9, 9), {"vehicle": f"v{k:02}"}) for k in range(40) for _ in range(1 + (k < 30))]
    field = next(field for field in fields(*loaded(dataset(boxes), [])) if field.name == "vehicle")
    assert field.bins[-2:] == ("v29", "10 others")
    assert np.bincount(field.of_label).tolist() == [2] * 30 + [10]


def binned(coco, found):
    seen = matched(coco, found).above(0.3)
    return [figures_of(field, seen) for field in fields(seen.labels, seen.predictions)], seen


@pytest.mark.parametrize("seed", range(5))
def test_bins_add_up_to_the_whole(seed):
    coco, found = random_case(seed, crowds=0.2)
    for k, image in enumerate(coco["images"]):
        image["scenery"] = "ab"[k % 2]
    figures, seen = binned(coco, found)
    assert {one.field.name for one in figures} == {"class", "box_size", "scenery"}
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


def test_the_worst_bins_are_described_once_per_field():
    boxes = [(1 + k, 1, (60, 60, 10, 10)) for k in range(30)]
    boxes += [(1 + k, 2, (200, 60, 40, 40)) for k in range(30)]
    found = [(*box, 0.9) for box in boxes[:3] + boxes[30:57]]
    coco = dataset(boxes, images=30)
    figures, _ = binned(coco, results(found))
    told = worst(figures)
    assert len(told) == 2
    assert any(line.startswith("class tank: 3 of 30 found, recall 0.10 (0.03 to 0.2") for line in told)
    few = boxes[:9] + boxes[30:39]
    figures, _ = binned(dataset(few, images=30), results([(*box, 0.9) for box in few[9:]]))
    assert worst(figures) == []


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


def rectangle(x, y, w, h):
    return {"segmentation": [[x, y, x + w, y, x + w, y + h, x, y + h]]}


@pytest.fixture
def scene(tmp_path):
    """Gray 100 with a target of 151 and one of 74; a label without a mask; a missing second picture."""
    boxes = [(100, 100, 60, 40), (300, 200, 60, 40)]
    records = [(1, 1, box, rectangle(*box)) for box in boxes] + [
        (1, 1, (0, 0, 9, 9)),
        (2, 1, boxes[0], rectangle(*boxes[0])),
    ]
    pixels = np.full((480, 640, 3), 100, dtype=np.uint8)
    for (x, y, w, h), level in zip(boxes, (151, 74), strict=True):
        pixels[y : y + h, x : x + w] = level
    (tmp_path / "images").mkdir()
    Image.fromarray(pixels).save(tmp_path / "images" / "1.png")
    return labels_of(LabeledImages.of(dataset(records, images=2)), path=tmp_path)


def test_contrast_is_the_difference_from_the_surroundings_of_a_target_unless_stored(scene):
    assert measured_contrast(scene) == pytest.approx([51 / 255, 26 / 255, np.nan, np.nan], abs=0.005, nan_ok=True)
    scene = replace(scene, annotations=[scene.annotations[0].changed(contrast=0.9), *scene.annotations[1:]])
    predictions = predictions_of([], scene, path=scene.path, name="none")
    contrast = next(field for field in fields(scene, predictions) if field.name == "contrast")
    assert contrast.bins == ("0.1 to 0.2", "0.4 and more")
    assert contrast.of_label.tolist() == [1, 0, -1, -1]
