"""Oriented boxes, corners of 3D boxes, and amodal masks: what they are, their checks, and exports."""

import shutil

import cv2
import numpy as np
import pytest
from PIL import Image, ImageDraw

from hulldown.annotate.masks import encode_mask
from hulldown.annotate.rectangles import rectangle_corners, smallest_mask_rectangle
from hulldown.base.errors import DatasetError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.row_records import Segmenter, recorded_image_fields
from hulldown.geometry.transforms import transform_points
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.detections import dataset as dataset_of
from hulldown.tests.builders.detections import loaded
from hulldown.tests.builders.editing import edit, write_dataset
from hulldown.tests.builders.planning_assets import plan, small_assets, small_config
from hulldown.tests.dataset.test_layouts import package
from hulldown.training.evaluation.evaluate import Evaluation, Threshold


def random_mask(rng, kind):
    """Specks, a polygon, or whole columns plus one pixel; sometimes nothing."""
    h, w = rng.integers(1, 60, 2).tolist()
    if kind == 0:
        return rng.random((h, w)) < rng.random() ** 3
    picture = Image.new("1", (w, h))
    corners = rng.uniform(0, [w, h], (5, 2)) if kind == 1 else [[w // 3, 0], [w // 2, 0], [w // 2, h], [w // 3, h]]
    ImageDraw.Draw(picture).polygon(np.ravel(corners).tolist(), fill=1)
    picture.putpixel(rng.integers([w, h]).tolist(), 1)
    return np.array(picture)


def test_the_rectangle_is_the_smallest_around_the_mask():
    rng = np.random.default_rng(0)
    for i in range(1000):
        mask = random_mask(rng, i % 3)
        found = smallest_mask_rectangle(encode_mask(mask), mask.shape[1], mask.shape[0])
        if not mask.any():
            assert found is None
            continue
        y, x = np.nonzero(mask)
        corners = np.concatenate([np.stack([x + a, y + b], axis=1) for a in (0, 1) for b in (0, 1)])
        _, sides, _ = cv2.minAreaRect(corners.astype(np.float32))
        assert found[2] * found[3] == pytest.approx(np.prod(sides), rel=1e-5)
        assert found[2] >= found[3]
        assert -np.pi / 2 <= found[4] < np.pi / 2
        along = np.array([np.cos(found[4]), np.sin(found[4])])
        for axis, size in ((along, found[2]), (np.array([-along[1], along[0]]), found[3])):
            assert np.abs((corners - found[:2]) @ axis).max() <= size / 2 + 1e-9


@pytest.fixture(scope="module")
def planned():
    assets = small_assets()
    return assets, list(plan(small_config(budget={"images_per_class": 4}), assets))


@pytest.fixture(scope="module")
def dataset(planned, tmp_path_factory):
    """The planned rows with their labels and gray pictures."""
    assets, rows = planned
    folder = tmp_path_factory.mktemp("oriented")
    segmenter = Segmenter(assets.vehicles, assets.sceneries)
    with CocoDataset.open(folder, categories=["main battle tank", "truck"]) as dataset:
        for row in rows:
            image = {"file_name": row.file_name, **recorded_image_fields(row)}
            (folder / row.file_name).parent.mkdir(exist_ok=True)
            Image.new("RGB", (row.width, row.height), "gray").save(folder / row.file_name)
            dataset.append(image, segmenter.label_records_with_masks(row))
    return folder


def test_the_corners_are_those_of_the_posed_box_the_ground_first(planned, dataset):
    images = {image.id: image for image in read_usable_dataset(dataset).images}
    for image_id, row in enumerate(planned[1], start=1):
        if image_id not in images or not images[image_id].labels or row.hides_target:
            continue
        low, high = row.target.bounds
        around = [[high[0], high[1]], [high[0], low[1]], [low[0], low[1]], [low[0], high[1]]]
        corners = [[*corner, z] for z in (low[2], high[2]) for corner in around]
        wanted = row.camera.project(transform_points(row.target.world_from_vehicle, np.array(corners))).pixels
        label = images[image_id].labels[0]
        np.testing.assert_allclose(label.record["bbox_3d_corners"], wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda label: label["bbox_3d_corners"][6].__setitem__(1, 0.0), "aren't the corners"),
        (lambda label: label["bbox_3d_corners"].__setitem__(0, None), "aren't the corners"),
        (lambda label: label["bbox_3d_corners"].pop(), "bbox_3d_corners is"),
        (lambda label: label.update(segmentation_amodal={"size": [1, 1], "counts": [1]}), "segmentation_amodal: "),
        (lambda label: label.update(segmentation_amodal=[1]), "segmentation_amodal is"),
        (lambda label: label["segmentation_amodal"].update(counts=[everything(label)]), "lacks pixels of its mask"),
        (lambda label: label["segmentation_amodal"].update(counts=[0, everything(label)]), "its amodal mask covers"),
    ],
)
def test_verify_finds_wrong_corners_and_amodal_masks(dataset, tmp_path, change, problem):
    shutil.copy(dataset / "annotations.json", tmp_path)
    assert not any(
        "amodal mask" in found.problem or "corners" in found.problem for found in verify_dataset(tmp_path, fast=True)
    )
    edit(tmp_path, lambda coco: change(coco["annotations"][0]))
    assert any(problem in found.problem for found in verify_dataset(tmp_path, fast=True))


def everything(label):
    """Number of pixels of a label's image."""
    height, width = label["segmentation"]["size"]
    return height * width


@pytest.mark.parametrize("by", [[0.0, 0, 0, 0, 0], [9.0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0.7], [0, 0, 0, -1e9, 0]])
def test_verify_finds_a_rectangle_that_does_not_fit_its_mask(dataset, tmp_path, by):
    shutil.copy(dataset / "annotations.json", tmp_path)

    def move(coco):
        label = coco["annotations"][0]
        label["obb"] = [a + b for a, b in zip(label["obb"], by, strict=True)]

    edit(tmp_path, move)
    problems = [finding for finding in verify_dataset(tmp_path, fast=True) if "obb" in finding.problem]
    assert len(problems) == any(by)


def test_supervision_reads_the_corners(dataset, tmp_path):
    wanted = {}
    for image in read_usable_dataset(dataset).images:
        full = [(one.category, rectangle_corners(one.record["obb"])) for one in image.labels if not one.crowd]
        wanted[image.file_name.rpartition("/")[2][:-4]] = full
    export_dataset(dataset, tmp_path / "yolo", layout="yolo-obb", fractions=(1.0, 0.0, 0.0))
    folders = (str(tmp_path / "yolo" / kind / "train") for kind in ("images", "labels"))
    data = package("supervision").DetectionDataset.from_yolo(*folders, str(tmp_path / "yolo/data.yaml"), is_obb=True)
    assert len(data) == len(wanted)
    for path, _, detections in data:
        full = wanted[path[-12:-4]]
        assert [data.classes[k] for k in detections.class_id] == [name for name, _ in full]
        for found, (_, corners) in zip(detections.data.get("xyxyxyxy", []), full, strict=True):
            np.testing.assert_allclose(found, corners, rtol=0, atol=1e-3)


def test_a_label_without_a_mask_has_the_corners_of_its_box(tmp_path):
    image, label = {"file_name": "1.png", "width": 10, "height": 10}, {"image_id": 1, "bbox": [1, 1, 5, 4]}
    write_dataset(tmp_path / "photographs", [image], [label], names=("truck",))
    export_dataset(tmp_path / "photographs", tmp_path / "out", layout="yolo-obb", fractions=(1.0, 0.0, 0.0))
    numbers = [float(n) for n in (tmp_path / "out/labels/train/1.txt").read_text().split()]
    assert numbers == [0, 0.1, 0.1, 0.6, 0.1, 0.6, 0.5, 0.1, 0.5]


def oriented_case(seed):
    """Turned boxes close to each other, some crowds, as labels and as detections."""
    rng = np.random.default_rng(seed)

    def box():
        return [*rng.uniform(20, 60, 2).tolist(), *rng.uniform(4, 40, 2).tolist(), rng.uniform(-4, 4)]

    boxes = [(i, int(rng.integers(1, 3)), box()) for i in range(1, 6) for _ in range(rng.integers(5))]
    near = [(i, c, np.array(one) + rng.normal(0, [2, 2, 2, 2, 0.1])) for i, c, one in boxes]
    near += [(i, int(rng.integers(1, 3)), np.array(box())) for i in range(1, 6) for _ in range(2)]
    found = [
        {"image_id": i, "category_id": c, "obb": [*one[:2].tolist(), *np.abs(one[2:4]).tolist(), float(one[4])]}
        for i, c, one in near
    ]
    marked = [{"obb": one, "area": one[2] * one[3], "iscrowd": int(rng.random() < 0.2 * (seed % 2))} for *_, one in boxes]
    labels = [(i, c, mask_box_of(one), more) for (i, c, one), more in zip(boxes, marked, strict=True)]
    return dataset_of(labels, images=5), [{**one, "score": float(rng.random())} for one in found]


def mask_box_of(rectangle):
    corners = rectangle_corners(rectangle)
    return [*corners.min(axis=0).tolist(), *np.ptp(corners, axis=0).tolist()]


@pytest.mark.parametrize("seed", range(20))
def test_average_precision_of_oriented_boxes_equals_hotcocos(seed):
    hotcoco = package("hotcoco")
    coco, found = oriented_case(seed)
    labels, predictions = loaded(coco, found)
    summary = Evaluation(labels, predictions, threshold=Threshold(0.5, "given")).summary
    truth = hotcoco.COCO(
        {**coco, "annotations": [{"area": one["obb"][2] * one["obb"][3], **one} for one in coco["annotations"]]}
    )
    reference = hotcoco.COCOeval(truth, truth.load_res(found), "obb")
    reference.run()
    wanted = np.where(np.array(reference.stats) < 0, np.nan, reference.stats)
    np.testing.assert_allclose(list(summary.values()), wanted, rtol=0, atol=1e-9)


def test_detections_with_and_without_an_oriented_box_are_refused():
    coco, found = oriented_case(0)
    found[3] = {**found[3], "bbox": [1.0, 2.0, 3.0, 4.0], "obb": None}
    with pytest.raises(DatasetError, match="detection 3: has no obb, which others have"):
        loaded(coco, found)
