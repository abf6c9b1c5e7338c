"""Folders of YOLO and VOC in place of COCO."""

import json
from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from hulldown.base.errors import DatasetError
from hulldown.cli import main
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.images import LabeledImages
from hulldown.dataset.store.document import read_coco
from hulldown.tests.builders.training_pictures import make_dataset


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("pictures") / "set", 10)


def boxes(coco):
    """Sorted labels by the stem of each picture."""
    names = {category["id"]: category["name"] for category in coco["categories"]}
    stems = {image["id"]: Path(image["file_name"]).stem for image in coco["images"]}
    found = {stem: [] for stem in stems.values()}
    for label in coco["annotations"]:
        found[stems[label["image_id"]]].append((names[label["category_id"]], label["bbox"]))
    return {stem: sorted(labels) for stem, labels in found.items()}


@pytest.mark.parametrize(
    ("layout", "split", "error"), [("yolo", "images/train", 1e-6), ("rfdetr-yolo", "train", 1e-6), ("voc", ".", 1.0)]
)
def test_an_export_can_be_read_back(pictures, tmp_path, layout, split, error):
    export_dataset(pictures, tmp_path / "out", layout=layout, fractions=(1.0, 0.0, 0.0))
    read, given = boxes(read_coco(tmp_path / "out" / split)), boxes(read_coco(pictures))
    assert read.keys() == given.keys()
    for stem, labels in given.items():
        assert [name for name, _ in read[stem]] == [name for name, _ in labels]
        for (_, box), (_, own) in zip(read[stem], labels, strict=True):
            assert box == pytest.approx(own, abs=2 * error)


def test_yolo_without_names_is_refused_by_its_labels_and_windows_paths_are_read(pictures, tmp_path):
    export_dataset(pictures, tmp_path / "out", layout="yolo", fractions=(1.0, 0.0, 0.0))
    for described in (tmp_path / "out").glob("*.y*ml"):
        described.unlink()
    with pytest.raises(DatasetError, match=r"labels/train, but no data\.yaml .*names: \[tank, truck\]"):
        read_coco(tmp_path / "out" / "images" / "train")
    content = json.loads((pictures / "annotations.json").read_text(encoding="utf-8"))
    names = [image["file_name"] for image in content["images"]]
    for image in content["images"]:
        image["file_name"] = image["file_name"].replace("/", "\\")
    (tmp_path / "annotations.json").write_text(json.dumps(content), encoding="utf-8")
    assert [image["file_name"] for image in read_coco(tmp_path)["images"]] == names
    assert any("/" in name for name in names)


def _write_labelme(folder, coco):
    shapes = [{"label": "tank", "points": [[30, 9], [10, 29]], "shape_type": "rectangle"}]
    (folder / "a.json").write_text(json.dumps({"shapes": shapes, "imagePath": "..\\a.png"}))
    return "a.png"


def _write_fiftyone(folder, coco):
    (folder / "labels.json").write_text(json.dumps(coco))
    return "data/a.png"


def _write_cvat(folder, coco):
    (folder / "annotations").mkdir()
    (folder / "annotations" / "instances_default.json").write_text(json.dumps(coco))
    return "images/default/a.png"


def _write_label_studio(folder, coco):
    coco["images"][0]["file_name"] = "../../label-studio/data/media/upload/1/a.png"
    (folder / "result.json").write_text(json.dumps(coco))
    return "images/a.png"


def _write_yolo(folder, coco, names, picture):
    text = Path(picture.replace("images", "labels")).with_suffix(".txt")
    (folder / text).parent.mkdir(exist_ok=True)
    (folder / text).write_text("0 0.2 0.35 0.2 0.4")
    (folder / names).write_text("tank\n")
    return picture


@pytest.mark.parametrize(
    "write",
    [
        *(_write_labelme, _write_fiftyone, _write_cvat, _write_label_studio),
        partial(_write_yolo, names="classes.txt", picture="images/a.png"),
        partial(_write_yolo, names="classes.txt", picture="a.png"),
        partial(_write_yolo, names="obj.names", picture="obj_train_data/a.png"),
    ],
)
def test_folders_of_other_tools_are_read(tmp_path, write):
    image = {"id": 1, "file_name": "a.png", "width": 100, "height": 50}
    label = {"id": 1, "image_id": 1, "category_id": 1, "bbox": [10, 9, 20, 20]}
    coco = {"images": [image], "annotations": [label], "categories": [{"id": 1, "name": "tank"}]}
    picture = tmp_path / write(tmp_path, coco)
    picture.parent.mkdir(exist_ok=True, parents=True)
    Image.new("RGB", (100, 50)).save(picture)
    (tmp_path / "images").mkdir(exist_ok=True)
    found = LabeledImages.from_coco_dict(read_coco(tmp_path))
    assert [each.name for each in found.categories] == ["tank"]
    assert [tmp_path / each.file_name for each in found.images] == [picture]
    assert found.images[0].labels[0].bbox == pytest.approx([10, 7.5 if "yolo" in repr(write) else 9, 20, 20])


def test_a_root_of_roboflow_is_refused_by_its_splits(tmp_path):
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / "_annotations.coco.json").write_text("{}")
    with pytest.raises(DatasetError, match=f"name one of its splits, such as {tmp_path}/train"):
        read_coco(tmp_path)


@pytest.mark.parametrize(
    ("line", "box"),
    [
        *((f"{label} .5 +0.5 2e-1 1.", [38.4, 0.0, 19.2, 54.0]) for label in ("0", "0.0")),
        *(
            (line, None)
            for line in ("0 0_.5 .5 .2 .2", "0 178.1 53.5 21.5 15.8", "0 0.1_5 .5 .2 .2", "0 nan .5 .2 .2", "inf .5 .5 .2 .2")
        ),
    ],
)
def test_numbers_of_yolo_are_those_that_other_readers_take(tmp_path, line, box):
    for kind in ("images", "labels"):
        (tmp_path / kind / "train").mkdir(parents=True)
    (tmp_path / "data.yaml").write_text("names: [tank]")
    Image.new("RGB", (96, 54)).save(tmp_path / "images" / "train" / "a.png")
    (tmp_path / "labels" / "train" / "a.txt").write_text(line)
    if box is None:
        with pytest.raises(DatasetError, match="is no class and box"):
            read_coco(tmp_path / "images" / "train")
    else:
        (label,) = read_coco(tmp_path / "images" / "train")["annotations"]
        assert label["bbox"] == pytest.approx(box)


def test_training_evaluation_and_export_accept_them(pictures, tmp_path):
    export_dataset(pictures, tmp_path / "yolo", layout="rfdetr-yolo", fractions=(1.0, 0.0, 0.0))
    train = str(tmp_path / "yolo" / "train")
    run = str(tmp_path / "run")
    arguments = ["--model", "small", "--weights", "none", "--resolution", "64", "--budget", "6", "--workers", "0"]
    assert main(["train", "--data", f"demo={train}", "-o", run, *arguments]) == 0
    assert main(["predict", run, train, "-o", str(tmp_path / "found.json")]) == 0
    assert main(["evaluate", train, str(tmp_path / "found.json"), "-o", str(tmp_path / "report")]) == 0
    assert json.loads((tmp_path / "report" / "report.json").read_text())["overall"]["fn"] is not None
    assert main(["export", train, "-o", str(tmp_path / "coco")]) == 0


def test_polygons_difficult_objects_and_empty_pictures(pictures, tmp_path):
    picture = read_coco(pictures)["images"][0]
    folder = tmp_path / "train"
    for name in ("images", "labels"):
        (folder / name).mkdir(parents=True)
    for name in ("a.png", "b.png"):
        (folder / "images" / name).write_bytes((pictures / picture["file_name"]).read_bytes())
    (tmp_path / "data.yaml").write_text("names:\n  0: tank\n  1: truck\n")
    (folder / "labels" / "a.txt").write_text("1 0.1 0.2 0.5 0.2 0.5 0.6\n\n0 0.5 0.5 0.2 0.2 0.9\n")
    with pytest.warns(UserWarning, match=r"1 of 2 have no label file, such as b\.png"):
        coco = read_coco(folder)
    width, height = picture["width"], picture["height"]
    assert boxes(coco)["b"] == []
    tank, truck = boxes(coco)["a"]
    assert tank[1] == pytest.approx([0.4 * width, 0.4 * height, 0.2 * width, 0.2 * height])
    assert truck[1] == pytest.approx([0.1 * width, 0.2 * height, 0.4 * width, 0.4 * height])
    assert len(coco["annotations"][0]["segmentation"][0]) == 6
    (folder / "labels" / "b.txt").write_text("7 0.5 0.5 0.2 0.2\n")
    with pytest.raises(DatasetError, match=r"b\.txt.*line 1"):
        read_coco(folder)
    with pytest.raises(DatasetError, match="several splits"):
        read_coco(tmp_path)
    (folder / "images" / "a.xml").write_text(
        "<annotation><filename>a.png</filename><object><name>tank</name><difficult>1</difficult>"
        "<bndbox><xmin>1</xmin><ymin>1</ymin><xmax>5</xmax><ymax>9</ymax></bndbox></object></annotation>"
    )
    label = read_coco(folder / "images")["annotations"][0]
    assert (label["bbox"], label["iscrowd"]) == ([0, 0, 5, 9], 1)
