import hashlib
import re
from functools import partial

import numpy as np
import pytest
from PIL import Image

from hulldown.annotate.masks import decode_mask, encode_mask
from hulldown.annotate.rectangles import smallest_mask_rectangle
from hulldown.base.errors import ConfigError, DatasetError
from hulldown.cli import main
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.join import join_datasets
from hulldown.dataset.record_checks import Finding
from hulldown.dataset.verification import check_pictures
from hulldown.reading.confinement.watch import GIB_BYTES
from hulldown.render.cycles_masks import MaskReport
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import append, edit
from hulldown.tests.builders.plan_lines import IMAGE, POSE, VEHICLE, row, write_lines
from hulldown.tests.builders.render_plans import CUBES, make_row, write_plan

MASK = np.zeros((24, 32), dtype=bool)
MASK[4:10, 5:15] = True
# Keys of rows that records don't have.
UNRECORDED = {*("slope_deg", "gap", "penetration", "tries", "label", "bounds"), *("role", "planned", "rejected", "left_out")}
# The camera is 1.25 m below the center; its azimuth is that of the image's lower edge, the vehicle's left.
IN_SPACE = {
    "distance": 1.25,
    "azimuth_seen": 1.570796327,
    "bbox_3d": {"center": [0.0, 0.0, 1.25], "size": [6.0, 3.0, 2.5], "rotation": np.eye(3).tolist()},
    # Of the lower side, in which the camera is; and of the upper one, 2.5 m ahead.
    "bbox_3d_corners": [None] * 4
    + [[6616.455183, 3312.227592], [6616.455183, -3288.227592], [-6584.455183, -3288.227592], [-6584.455183, 3312.227592]],
}
FOG = {
    **{"visibility_m": 500.0, "kind": "fog", "rain_mm_h": 0.0, "wind_m_s": [0.0, 0.0], "exposure_s": 0.004},
    **{"ground_cover": 0.0, "vehicle_cover": 0.0},
}


@pytest.fixture
def dataset(tmp_path):
    with CocoDataset.open(tmp_path, categories=["tank", "truck"]) as dataset:
        dataset.reserve_ids("p" * 64, images=3, annotations=3)
        for i in range(3):
            label = recorded(VEHICLE, VEHICLE) | {"id": i + 1, "segmentation": encode_mask(MASK), "area": 60}
            append(dataset, f"images/{i}.png", Image.new("RGB", (32, 24), (i, 0, 0)), [label], id=i + 1)
    return tmp_path


def damage(folder, change) -> list[Finding]:
    """Findings after `change` was applied to the COCO dictionary."""
    edit(folder, change)
    return list(verify_dataset(folder))


def test_a_sound_dataset_has_no_findings(dataset, capsys):
    assert list(verify_dataset(dataset)) == []
    # pycocotools' own output isn't shown
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("change", "severity", "text"),
    [
        (lambda c: c["images"][1].update(id=1), "error", "images/1.png: has the id 1, as has images/0.png"),
        (lambda c: c["images"][1].update(file_name="images/0.png"), "error", "images/0.png: belongs to 2 records"),
        (lambda c: c["images"][1].update(width=33), "error", "is 32 x 24 pixels, its record has 33 x 24"),
        (lambda c: c["images"][1].update(file_name="images/x.png"), "error", "images/x.png: is missing"),
        (lambda c: c["annotations"][1].update(id=1), "error", "annotation 1: its id is given twice"),
        (lambda c: c["annotations"][1].update(id=0), "warning", "annotation 0: ids below 1 are taken for unmatched"),
        (lambda c: c["annotations"][1].update(image_id=9), "error", "annotation 2: image 9 does not exist"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 29, 6]), "error", "leaves its image of 32 x 24"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 0, 6]), "error", "has no area"),
        (lambda c: c["annotations"][1].update(bbox=[7, 4, 8, 6]), "error", "beyond its bbox"),
        (
            lambda c: c["annotations"][1].update(bbox=[5, 4, 16, 6], visible_fraction=1.0),
            "warning",
            "6 px larger than its mask",
        ),
        (lambda c: c["annotations"][1].update(area=61), "error", "area is 61, its mask has 60 pixels"),
        (lambda c: c["annotations"][1]["segmentation"].update(size=[32, 24]), "error", "expected size [24, 32]"),
        (lambda c: c["annotations"][1].update(segmentation=[[1, 2, 3, 4]]), "error", "at least three points"),
        (lambda c: c["annotations"][1].update(visible_fraction=1.5), "error", "visible_fraction is 1.5"),
        (lambda c: c["annotations"][1].update(bbox_amodal=[6, 4, 9, 7]), "error", "is not inside bbox_amodal"),
        (lambda c: c["annotations"][1].update(bbox_amodal=[6, 4, 9]), "error", "bbox_amodal is [6, 4, 9]"),
        (lambda c: c["annotations"].append({**c["annotations"][1], "id": 8}), "warning", "repeats class and box"),
        (lambda c: c["categories"].append({"id": 2, "name": "other"}), "error", "category 2: its id is given twice"),
        (lambda c: c["categories"].append({"id": 5, "name": "tank"}), "error", "category tank: belongs to 2 records"),
        (lambda c: c["categories"].append({"id": 5, "name": "Tank"}), "warning", "differs from tank in capitals"),
        (lambda c: c["annotations"][1].update(obb=[1e308, "x", None]), "error", "obb is [1e+308"),
        (lambda c: c["categories"][0].update(keypoints=5), "error", "keypoints is 5"),
        (lambda c: c["images"][1].update(K=[[1e308]], dist="x"), "warning", "K is [[1e+308]]"),
        (lambda c: (c["images"].pop(), c["annotations"].pop()), "warning", "images/2.png: belongs to no record"),
    ],
)
def test_every_damage_is_found(dataset, change, severity, text):
    findings = damage(dataset, change)
    assert any(text in str(finding) and finding.severity == severity for finding in findings), findings


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda c: c["images"][1].update(height=None), "images/1.png: height is None"),
        (lambda c: c["images"][1].update(file_name="../x.png"), "no path inside the dataset"),
        (lambda c: c["images"][1].update(id=c["images"][0]["id"]), "images/1.png: has the id 1, as has images/0.png"),
        (lambda c: c["annotations"][1].update(category_id=9), "annotation 2: category 9 does not exist"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 6]), "bbox is [5, 4, 6]"),
        (lambda c: c["annotations"][1].update(bbox=[5, True, 10, 6]), "bbox is [5, True"),
        (lambda c: c["annotations"][1].update(category_id=[1]), "category [1] does not exist"),
        (lambda c: c["annotations"][1].update(image_id=[2]), "image [2] does not exist"),
        (lambda c: c["annotations"][1].update(image_id=99), "image 99 does not exist"),
        (lambda c: c["categories"].append({"id": 5}), "category 5: name is None"),
    ],
)
def test_an_unusable_record_is_found_and_neither_exported_nor_joined(dataset, change, text):
    assert any(text in str(finding) and finding.severity == "error" for finding in damage(dataset, change))
    for use in (partial(export_dataset, layout="yolo"), lambda folder, out: join_datasets([folder], out)):
        with pytest.raises(DatasetError, match=re.escape(text)):
            use(dataset, dataset / "out")
        assert not (dataset / "out").exists()


def test_a_broken_picture_is_found(dataset):
    path = dataset / "images" / "1.png"
    path.write_bytes(path.read_bytes()[:60])
    (finding,) = verify_dataset(dataset)
    assert str(finding).startswith("error: images/1.png: cannot be read as a picture")


@pytest.mark.parametrize("largest", [32 * 24, 32 * 24 - 1])
def test_pillows_size_limit_is_not_damage(dataset, monkeypatch, largest):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 32 * 24 // 3)
    monkeypatch.setattr(check_pictures, "MAX_PICTURE_PIXELS", largest)
    assert list(verify_dataset(dataset)) == []


def test_equal_pictures_are_found(dataset):
    (dataset / "images" / "2.png").write_bytes((dataset / "images" / "0.png").read_bytes())
    assert list(map(str, verify_dataset(dataset))) == ["warning: images/2.png: is the same picture as images/0.png"]


def planned_row(i):
    """A row of a foggy image with two hidden companions, and a third in image 1."""
    unseen = [{**VEHICLE, "visible_fraction": 0.0, "label": "none"}, {**VEHICLE, "bbox": None, "label": "none"}]
    seen = [{**VEHICLE, "category": "truck", "bbox": [6.5, 4.0, 8.0, 6.0]}] if i == 1 else []
    return row(i, fov_x_deg=1 / 3, weather=FOG, file_name=f"images/{i}.png", companions=unseen + seen)


def recorded(values, keys):
    """The values of a row that a record has, of these keys."""
    return {key: values[key] for key in keys if key not in UNRECORDED}


@pytest.fixture
def planned(tmp_path):
    """A dataset with real images and another plan before it, and the plan that was rendered into it."""
    rows = [planned_row(i) for i in range(4)]
    plan = write_lines(tmp_path / "plan.jsonl", rows)
    folder = tmp_path / "dataset"
    with CocoDataset.open(folder, categories=["truck", "tank"]) as dataset:
        append(dataset, "images/real.png", Image.new("RGB", (32, 24), (9, 0, 0)), [])
        dataset.reserve_ids("p" * 64, images=3, annotations=3)
        run = dataset.reserve_ids(hashlib.sha256(plan.read_bytes()).hexdigest(), images=4, annotations=5)
        n = run.annotation_offset
        for i, each in enumerate(rows):
            name = run.dataset_file_name(each["file_name"])
            boxes = []
            for vehicle in (each["planned"][0], *each["planned"][3:]):
                n += 1
                boxes.append({"id": n, **recorded(vehicle, VEHICLE), **IN_SPACE, "iscrowd": 0})
            picture, image = Image.new("RGB", (32, 24), (i, 0, 0)), recorded(each, IMAGE) | {"file_name": name}
            append(dataset, name, picture, boxes, id=run.image_offset + i + 1, **image)
    return folder, plan


def test_a_dataset_that_follows_its_plan_has_no_findings(planned):
    folder, plan = planned
    assert [one for one in verify_dataset(folder, plan=plan) if one.severity == "error"] == []


def moved(pose):
    return [[1.0, 0.0, 0.0, 0.25], *pose[1:]]


@pytest.mark.parametrize(
    ("change", "severity", "text"),
    [
        (lambda i, a: i.update(height=23), "error", "height is 23, planned is 24"),
        (lambda i, a: i.update(file_name="images/2.png"), "error", "is 'images/2.png', planned is 'images/2-"),
        (lambda i, a: i.update(world_from_camera=moved(POSE)), "error", "world_from_camera is [[1.0, 0.0, 0.0, 0.25],"),
        (lambda i, a: i.pop("fov_x_deg"), "error", "fov_x_deg is None, planned is 0.3333333333333333"),
        (lambda i, a: i.update(weather=None), "error", "weather is None, planned is {'visibility_m': 500.0,"),
        (lambda i, a: a.update(bbox=[5.0, 4.0, 10.0, 6.0 + 1e-12]), "error", "'t72': bbox is [5.0, 4.0, 10.0, 6.00"),
        (lambda i, a: a.update(category_id=1), "error", "tank 't72': category is 'truck', planned is 'tank'"),
        (lambda i, a: a.update(category_id=[1]), "error", "tank 't72': category is None, planned is 'tank'"),
        (lambda i, a: a.update(image_id=6), "error", "image_id is 6, planned is 7"),
        (lambda i, a: a.update(image_id=[7]), "error", "image_id is [7], planned is 7"),
        (lambda i, a: (a.update(image_id=[7]), i.update(id=100)), "warning", "1 of 4 planned images are not there"),
        (lambda i, a: a.update(world_from_vehicle=moved(POSE)), "error", "world_from_vehicle is"),
        (lambda i, a: a.update(articulation={"turret": 0.2}), "error", "articulation is {'turret': 0.2}"),
        (lambda i, a: a.update(visible_fraction=0.5), "error", "visible_fraction is 0.5, planned is 0.75"),
        (lambda i, a: a.update(id=100), "error", "tank 't72' is planned and has no annotation"),
        (lambda i, a: i.update(id=100), "warning", "plan.jsonl: 1 of 4 planned images are not there, such as images/2-"),
    ],
)
def test_every_difference_from_the_plan_is_found(planned, change, severity, text):
    folder, plan = planned
    edit(folder, lambda coco: change(coco["images"][3], coco["annotations"][3]))
    findings = list(verify_dataset(folder, plan=plan))
    assert any(text in str(finding) and finding.severity == severity for finding in findings), findings


@pytest.mark.parametrize(("pixels", "found"), [(0, False), (2, False), (3, True)])
def test_masks_are_computed_anew_up_to_rays_on_edges(tmp_path, render, pixels, found):
    plan, folder = write_plan(tmp_path, [make_row(i) for i in range(2)]), tmp_path / "d"
    render(plan, folder)
    (folder / "journal.jsonl").unlink()

    def change(coco):
        label = coco["annotations"][1]
        mask = decode_mask(label["segmentation"], 16, 16)
        mask[tuple(np.argwhere(mask)[:pixels].T)] = False
        label |= {"segmentation": encode_mask(mask), "segmentation_amodal": encode_mask(mask), "area": int(mask.sum())}
        label["obb"] = smallest_mask_rectangle(label["segmentation"], 16, 16).tolist()

    edit(folder, change)
    for fast, keys in ((False, ["segmentation", "area", "segmentation_amodal", "obb"] if found else []), (True, [])):
        problems = [one.problem for one in verify_dataset(folder, plan, fast=fast, assets=lambda: CUBES)]
        assert [problem.split()[2] for problem in problems if "planned is" in problem] == keys


def test_an_annotation_with_another_ones_id_is_found(planned):
    folder, plan = planned
    edit(folder, lambda coco: (coco["images"].pop(), coco["annotations"][-1].update(image_id=7)))
    assert "-2.png: annotation 8 has the id of one" in "".join(map(str, verify_dataset(folder, plan=plan)))


def test_a_plan_that_was_not_rendered_here_is_reported(planned):
    folder, plan = planned
    plan.write_text(plan.read_text().replace("0.75", "0.7"))
    (finding,) = verify_dataset(folder, plan=plan)
    assert str(finding) == "error: plan.jsonl: nothing here was rendered from this file, as it is now"


def test_a_plans_assets_are_read_once_within_the_users_limits(planned, monkeypatch):
    folder, plan = planned
    read = []

    def load(plan, *, limits, **_):
        read.append(limits)
        return CUBES

    monkeypatch.setattr("hulldown.render.verify.load_planned_library", load)
    monkeypatch.setattr("hulldown.render.verify.verify_masks", lambda *_, **__: MaskReport((), ()))
    main(["verify", str(folder), "--plan", str(plan), "--masks", "1", "--read-timeout", "7", "--read-memory", "3"])
    assert [(limits.silence_s, limits.memory_bytes) for limits in read] == [(7, 3 * GIB_BYTES)]


def test_a_missing_plan_and_a_missing_dataset_are_errors(dataset, tmp_path_factory):
    with pytest.raises(ConfigError, match="no such plan"):
        list(verify_dataset(dataset, plan=dataset / "no.jsonl"))
    with pytest.raises(DatasetError, match=r"no annotations\.json"):
        list(verify_dataset(tmp_path_factory.mktemp("empty")))


def test_a_dataset_by_another_tool_has_no_run_to_finish(dataset):
    (dataset / "journal.jsonl").unlink()
    (dataset / "annotations.json").rename(dataset / "_annotations.coco.json")
    assert not list(verify_dataset(dataset))


def test_an_interrupted_run_is_reported(dataset):
    (dataset / "annotations.json").unlink()
    with pytest.warns(UserWarning, match="is missing; it is made anew"):
        findings = list(verify_dataset(dataset))
    assert [str(f) for f in findings] == [
        "warning: annotations.json: is not there yet: the run has not been closed; render again to finish it"
    ]
