"""Every export layout, read by the packages that it's for."""

import importlib
import json
import math
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from pycocotools.coco import COCO

from hulldown import cli
from hulldown.annotate.masks import decode_mask, encode_mask, mask_box
from hulldown.annotate.outlines import mask_polygons
from hulldown.annotate.records import Label
from hulldown.base.errors import DatasetError
from hulldown.dataset.exports.export import LAYOUTS, WITH_POLYGONS, export_dataset
from hulldown.dataset.exports.layouts.kitti import kitti_label_line
from hulldown.tests.builders.editing import edit, write_dataset
from hulldown.verbs.command import make_command_app

WIDTH, HEIGHT = 64, 40
NAMES = ["tank", 'truck "6x6"', "armored car"]  # the last has no label


def package(name):
    """A package that reads exports, and must be installed; ignore its own warnings on import."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


def mask_of(kind: int) -> np.ndarray:
    """A ring with a hole, two pieces that touch at a corner, and a triangle."""
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    if kind == 0:
        mask[8:30, 10:40] = True
        mask[14:20, 20:30] = False
    elif kind == 1:
        mask[5:15, 5:15] = True
        mask[15:25, 15:25] = True
    else:
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        mask = (rows > 4) & (columns > rows * 0.7) & (columns < 60 - rows)
    return mask


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Thirty renders of ten positions with masks, three of them without vehicles, two crowds, six photographs."""
    images, annotations = [], []
    for i in range(36):
        render = i < 30
        image = {"file_name": f"images/a.{i:03d}.png" if render else f"photographs/{i}.jpg"}
        if render:
            image |= {"scenery": "hills", "position": i // 3, "shot": i % 3, "fov_x_deg": 50.0}
        if i < 3:
            image |= {"K": [[90.0, 0.0, 20.0], [0.0, 91.0, 15.0], [0.0, 0.0, 1.0]], "fov_x_deg": None}
        if i == 35:
            image |= {"K": [90.0, 0.0, 20.0], "fov_x_deg": 50.0}  # in another notation than hulldown's
        images.append({**image, "width": WIDTH, "height": HEIGHT})
        if i % 10 == 4:
            continue
        mask = mask_of(i % 3)
        label = {"bbox": np.add(mask_box(mask), [0.25, 0.125, -0.5, -0.25]).tolist(), "area": int(mask.sum())}
        label |= {"segmentation": encode_mask(mask) if render else [], "iscrowd": int(i in (6, 7))}
        annotations.append({"image_id": i + 1, "category_id": 1 + i // 3 % 2, **label})
    folder = write_dataset(tmp_path_factory.mktemp("dataset"), images, annotations, names=NAMES)

    def renumbered(coco):  # ids that don't begin at 1, not in order
        coco["categories"].reverse()
        for category in coco["categories"]:
            category["id"] += 2
        for label in coco["annotations"]:
            label["category_id"] += 2

    edit(folder, renumbered)
    return folder


@pytest.fixture(scope="module")
def exported(dataset, tmp_path_factory):
    """The folder of a layout, with or without polygons."""
    made = {}

    def of(layout, within=None):
        if (layout, within) not in made:
            out = tmp_path_factory.mktemp(layout) / "out"
            told = pytest.warns(UserWarning, match="6 pictures have no calib") if layout == "kitti" else nullcontext()
            with told:
                counts = export_dataset(dataset, out, layout=layout, polygons=False if within is None else within)
            assert sum(counts.values()) == 36
            assert min(counts.values()) > 0
            made[layout, within] = out
        return made[layout, within]

    return of


@pytest.fixture(scope="module")
def labels(dataset):
    """Labels by the bytes of each picture: (class name, box, crowd), sorted."""
    coco = json.loads((dataset / "annotations.json").read_text())
    names = {category["id"]: category["name"] for category in coco["categories"]}
    found = {}
    for image in coco["images"]:
        labels = [one for one in coco["annotations"] if one["image_id"] == image["id"]]
        content = (dataset / image["file_name"]).read_bytes()
        found[content] = [(names[one["category_id"]], one["bbox"], one["iscrowd"]) for one in labels]
    return found


def corners(box) -> np.ndarray:
    x, y, w, h = box
    return np.array([x, y, x + w, y + h])


def compare(labels, found, *, crowds=True, atol=1e-3):
    """Check that each picture appears once, with its labels; `found` is (picture's bytes, [(class name, corners)])."""
    seen = {}
    for content, boxes in found:
        wanted = [(name, corners(box)) for name, box, crowd in labels[content] if crowds or not crowd]
        assert [name for name, _ in boxes] == [name for name, _ in wanted]
        for (_, found_box), (_, true) in zip(boxes, wanted, strict=True):
            np.testing.assert_allclose(found_box, true, rtol=0, atol=atol)
        seen[content] = True
    assert len(seen) == len(labels)


@pytest.mark.parametrize(("within", "overlap"), [(None, 0.9999), (0.0, 0.995), (0.3, 0.97)])
def test_pycocotools_reads_coco(exported, labels, capsys, within, overlap):
    out, found = exported("coco", within), []
    for split in ("train", "valid", "test"):
        coco = COCO(str(out / split / "_annotations.coco.json"))
        for image in coco.loadImgs(coco.getImgIds()):
            annotations = coco.loadAnns(coco.getAnnIds(imgIds=[image["id"]]))
            content = (out / split / image["file_name"]).read_bytes()
            found.append((content, [(coco.cats[a["category_id"]]["name"], corners(a["bbox"])) for a in annotations]))
            for annotation in annotations:
                if annotation["segmentation"]:
                    true = mask_of((image["id"] - 1) % 3)
                    shown = coco.annToMask(annotation).astype(bool)
                    assert (true & shown).sum() / (true | shown).sum() > overlap
                    assert isinstance(annotation["segmentation"], list) == (within is not None and not annotation["iscrowd"])
    compare(labels, found)


@pytest.mark.parametrize("within", [None, 0.0])
def test_rfdetr_reads_yolo(exported, labels, within):
    yolo = package("rfdetr.datasets.yolo")
    out, found, contents, masks = exported("rfdetr-yolo", within), [], list(labels), 0
    assert yolo.is_valid_yolo_dataset(str(out))
    for split in ("train", "valid", "test"):
        data = yolo.YoloDetection(
            img_folder=str(out / split / "images"),
            lb_folder=str(out / split / "labels"),
            data_file=str(out / "data.yaml"),
            transforms=None,
            include_masks=within is not None,
        )
        assert list(data.sv_dataset.classes) == NAMES
        for path, _, detections in (data.sv_dataset[i] for i in range(len(data.sv_dataset))):
            content, names = Path(path).read_bytes(), [NAMES[k] for k in detections.class_id]
            found.append((content, list(zip(names, detections.xyxy, strict=True))))
            if within is not None and names and (i := contents.index(content)) < 30:
                shown, true = detections.mask[0], mask_of(i % 3)
                # It rounds corners to whole pixels and fills polygons with their outline, up to a pixel more.
                assert (true & shown).sum() / true.sum() > 0.98
                assert (true & shown).sum() / (true | shown).sum() > 0.75
                masks += 1
    compare(labels, found, crowds=False, atol=1e-3 if within is None else 1.0)
    assert (masks > 10) == (within is not None)


def test_rfdetr_reads_coco(exported):
    datasets = package("rfdetr.datasets.coco")
    out = exported("coco")
    assert datasets.is_valid_coco_dataset(str(out))
    data = datasets.CocoDetection(out / "train", out / "train" / "_annotations.coco.json", transforms=None)
    assert len(data) > 10


def test_yolo_has_ultralytics_format(exported, labels):
    out, found = exported("yolo"), []
    for split in ("train", "valid", "test"):
        for picture in (out / "images" / split).iterdir():
            # Its rule for label files: the last /images/ becomes /labels/, the suffix .txt.
            text = out / "labels" / split / f"{picture.stem}.txt"
            rows = np.array([line.split() for line in text.read_text().splitlines()], dtype=float).reshape(-1, 5)
            assert ((rows[:, 1:] >= 0) & (rows[:, 1:] <= 1)).all()
            center, size = rows[:, 1:3] * [WIDTH, HEIGHT], rows[:, 3:] * [WIDTH, HEIGHT]
            boxes = np.hstack([center - size / 2, center + size / 2])
            found.append((picture.read_bytes(), [(NAMES[int(k)], box) for k, box in zip(rows[:, 0], boxes, strict=True)]))
    compare(labels, found, crowds=False, atol=1e-6)


def test_supervision_reads_voc(exported, labels):
    supervision = package("supervision")
    out = exported("voc")
    data = supervision.DetectionDataset.from_pascal_voc(str(out / "JPEGImages"), str(out / "Annotations"))
    found = []
    for path, _, detections in data:
        names = [data.classes[k] for k in detections.class_id]
        found.append((Path(path).read_bytes(), list(zip(names, detections.xyxy, strict=True))))
    compare(labels, found, atol=1.0)
    for (name, box), (_, true, _) in zip(found[0][1], labels[found[0][0]], strict=True):
        assert name in NAMES
        assert (box[:2] <= corners(true)[:2]).all()
        assert (box[2:] >= corners(true)[2:]).all()
    stems = [name for split in ("train", "val", "test") for name in (out / f"ImageSets/Main/{split}.txt").read_text().split()]
    assert sorted(stems) == sorted(path.stem for path in (out / "Annotations").iterdir())


@pytest.mark.parametrize("within", [None, 0.3])
def test_hugging_face_reads_the_image_folder(exported, labels, tmp_path, monkeypatch, within):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_DISABLE_PROGRESS_BARS", "1")
    datasets = package("datasets")
    datasets.disable_progress_bars()
    loaded = datasets.load_dataset("imagefolder", data_dir=str(exported("huggingface", within)), cache_dir=str(tmp_path))
    assert sorted(loaded) == ["test", "train", "validation"]
    found = []
    for part in loaded.values():
        for row in part.cast_column("image", datasets.Image(decode=False)):
            content, objects = Path(row["image"]["path"]).read_bytes(), row["objects"]
            boxes = map(corners, objects["bbox"])
            found.append((content, list(zip(objects["category"], boxes, strict=True))))
            assert objects["iscrowd"] == [crowd for *_, crowd in labels[content]]
    compare(labels, found)


def test_kitti_has_fifteen_fields_a_label_and_a_camera_a_picture(exported, labels):
    out, found, matrices = exported("kitti") / "training", [], []
    for picture in sorted((out / "image_2").iterdir()):
        lines = [line.split() for line in (out / "label_2" / f"{picture.stem}.txt").read_text().splitlines()]
        assert all(len(line) == 15 for line in lines)
        crowds = [crowd for *_, crowd in labels[picture.read_bytes()]]
        assert [line[0] == "DontCare" for line in lines] == [bool(crowd) for crowd in crowds]
        boxes = [
            (name, np.array(line[4:8], dtype=float))
            for line, (name, *_) in zip(lines, labels[picture.read_bytes()], strict=True)
        ]
        found.append((picture.read_bytes(), boxes))
        if picture.suffix == ".jpg":
            assert not (out / "calib" / f"{picture.stem}.txt").exists()
            continue
        camera = dict(line.split(": ") for line in (out / "calib" / f"{picture.stem}.txt").read_text().splitlines())
        matrices.append(np.array(camera["P2"].split(), dtype=float).reshape(3, 4))
    compare(labels, found, atol=1e-4)
    calibrated = [matrix for matrix in matrices if matrix[0, 2] != WIDTH / 2]
    np.testing.assert_array_equal(calibrated, [[[90, 0, 20, 0], [0, 91, 15, 0], [0, 0, 1, 0]]] * 3)
    assert [path.stem for path in sorted((out / "image_2").iterdir())] == [f"{i:06d}" for i in range(36)]


# Columns are forward, left, and up in the camera's frame: x right, y down, z ahead.
DRIVING_RIGHT = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
DRIVING_AWAY = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("x", "rotation", "alpha", "turn"),
    [(0, DRIVING_RIGHT, 0, 0), (20, DRIVING_RIGHT, -math.pi / 4, 0), (-20, DRIVING_AWAY, -math.pi / 4, -math.pi / 2)],
)
def test_kittis_angles_are_zero_for_a_vehicle_ahead_that_drives_to_the_right(x, rotation, alpha, turn):
    """KITTI's readme: rotation_y is in the camera's frame, 0 along x, and -pi/2 away; alpha is relative to the ray."""
    box = {"center": [x, 0.0, 20.0], "size": [8.0, 3.0, 2.0], "rotation": rotation}
    label = {"bbox": [1, 2, 3, 4], "bbox_3d": box, "visible_fraction": 0.7, "truncated_fraction": 0.25}
    label |= {"id": 1, "image_id": 1, "category_id": 1}
    kind, truncated, occluded, *fields = kitti_label_line(Label.from_record(label, {1: "a b"})).split()
    assert (kind, truncated, occluded) == ("a_b", "0.2500", "1")
    wanted = [alpha, 1, 2, 4, 6, 2, 3, 8, x, 1, 20, turn]
    np.testing.assert_allclose([float(each) for each in fields], wanted, rtol=0, atol=1e-6)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_command_knows_every_layout(layout):
    words = ["export", "d", "-o", "out", "--format", layout]
    _, given, _ = make_command_app(words, cli.VERBS).parse_args(words, exit_on_error=False)
    assert given.arguments["layout"] == layout


@pytest.mark.parametrize("layout", sorted(set(LAYOUTS) - set(WITH_POLYGONS)))
def test_a_layout_without_polygons_refuses_the_option(dataset, tmp_path, layout):
    with pytest.raises(DatasetError, match=f"layout {layout} has no polygons"):
        export_dataset(dataset, tmp_path / "out", layout=layout, polygons=True)
    assert not (tmp_path / "out").exists()


def test_polygons_of_random_masks_are_accurate():
    rng = np.random.default_rng(3)
    for _ in range(50):
        mask = rng.random((12, 16)) < rng.uniform(0.05, 0.95)
        rings = mask_polygons(encode_mask(mask), 16, 12)
        shown = decode_mask(rings, 16, 12) if rings else np.zeros_like(mask)
        assert (mask == shown).mean() > 0.95
    assert mask_polygons(encode_mask(np.zeros((4, 4), dtype=bool)), 4, 4) == []
    whole = mask_polygons(encode_mask(np.ones((4, 4), dtype=bool)), 4, 4)
    assert decode_mask(whole, 4, 4).all()
