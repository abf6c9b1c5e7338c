"""Every reader of a file from outside reads a changed file, or refuses it in one line."""

from __future__ import annotations

import io
import json
import os
import re
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from hulldown.assets.picture_files import read_picture
from hulldown.dataset.foreign_labels import foreign_reader
from hulldown.dataset.images import LabeledImages
from hulldown.dataset.photographs import read_photographs
from hulldown.dataset.provenance import read_provenance_by_plan
from hulldown.dataset.record_checks import refuse_unusable_records
from hulldown.planning.inputs.camera_file import read_calibration_as_config
from hulldown.planning.inputs.poses import read_poses
from hulldown.property_tests.any_values import MANY, refusal
from hulldown.reading.confinement.blocks import refuse_special_references
from hulldown.reading.confinement.references import refuse_odd_references
from hulldown.reading.pieces.formats import file_format
from hulldown.reading.scenery.geotiff import read_elevations, read_orthophoto
from hulldown.tests.builders.networks import RUN
from hulldown.training.detectors.detector import find_weights
from hulldown.training.evaluation.labels import labels_from_images
from hulldown.training.evaluation.predictions import read_predictions
from hulldown.training.input_pictures import probe_video
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.settings import OWN_AUGMENTATIONS, load_settings
from hulldown.training.predict import load_detector
from hulldown.training.study.study_folder import read_study

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
COCO = {
    "images": [{"id": 1, "file_name": "1.png", "width": 64, "height": 48}],
    "annotations": [{"id": 1, "image_id": 1, "category_id": 1, "bbox": [9, 9, 20, 20], "iscrowd": 0}],
    "categories": [{"id": 1, "name": "tank"}],
}
LOW, HIGH = np.array([447000.0, 5410970.0]), np.array([447030.0, 5411000.0])
CALIBRATION = b"%YAML:1.0\nimage_width: 64\nimage_height: 48\nK: !!opencv-matrix\n  data: [90, 0, 32, 0, 90, 24, 0., 0, 1]\n"
BOX = "<bndbox><xmin>1</xmin><ymin>2</ymin><xmax>9</xmax><ymax>9</ymax></bndbox>"
VOC = f"<annotation><filename>1.png</filename><object><name>tank</name>{BOX}</object></annotation>".encode()
GLTF = {"asset": {"version": "2.0"}, "buffers": [{"uri": "m.bin", "byteLength": 3}]}
RUNS = {"plans": {"a": {"blender": ["5.0"], "devices": ["CPU"], "systems": ["Linux"], "confinement": ["none"]}}}
FOUND = [{"image_id": 1, "category_id": 1, "bbox": [9, 9, 20, 20], "score": 0.5}]
STUDY = {"config": {}, "classes": ["tank"], "datasets": {}}


def encoded(value: object) -> bytes:
    return json.dumps(value).encode()


def picture(kind: str) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (64, 48), (40, 90, 9)).save(file, kind)
    return file.getvalue()


def raster(bands: int, kind: str) -> bytes:
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    place = {"transform": Affine(2, 0, 447000, 0, -2, 5411000), "crs": "EPSG:32632"}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", height=16, width=16, count=bands, dtype=kind, **place) as file:
            file.write(np.full((bands, 16, 16), 100, dtype=kind))
        return bytes(memory.read())


@cache
def video() -> bytes:
    import cv2

    with tempfile.TemporaryDirectory() as folder:
        writer = cv2.VideoWriter(f"{folder}/a.mp4", cv2.VideoWriter_fourcc(*"mp4v"), 10, (32, 16))
        for k in range(3):
            writer.write(np.full((16, 32, 3), 60 * k, dtype=np.uint8))
        writer.release()
        return Path(f"{folder}/a.mp4").read_bytes()


@cache
def weights() -> bytes:
    import torch

    content = io.BytesIO()
    torch.save({"model": {"class_embed.bias": torch.zeros(3)}, "args": {"class_names": ["tank"]}}, content)
    return content.getvalue()


@cache
def tensors(name: str) -> bytes:
    from hulldown.tests.builders.networks import tiny_weights

    return Path(tiny_weights(), name).read_bytes()


def foreign(folder: Path) -> None:
    """Read a folder of YOLO or VOC."""
    read = foreign_reader(folder)
    if read is not None:
        coco = read()
        refuse_unusable_records(folder, coco["categories"], coco["images"], coco["annotations"])


# Files beside the changed one, by the first folder of its path.
BESIDE: dict[str, dict[str, Callable[[], bytes]]] = {
    "y": {
        "y/images/1.png": lambda: picture("PNG"),
        "y/labels/1.txt": lambda: b"0 0.5 0.5 0.2 0.2\n",
        "y/data.yaml": lambda: b"names:\n  0: tank\n  1: truck\n",
    },
    "v": {"v/1.png": lambda: picture("PNG")},
    "w": {f"w/{name}": partial(tensors, name) for name in ("config.json", "preprocessor_config.json")},
}
# The path of the changed file, its content, and what reads it, given the path.
READERS: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], object]]] = {
    "calibration": ("c.yaml", lambda: CALIBRATION, read_calibration_as_config),
    "photographs": ("a.json", lambda: encoded(COCO), read_photographs),
    "poses": ("p.csv", lambda: b"x,y,yaw_deg,sequence\n1,2,30,\n", read_poses),
    "elevations": ("e.tif", lambda: raster(1, "float32"), lambda path: read_elevations(path, area=None, scale=None)),
    "orthophoto": ("o.tif", lambda: raster(3, "uint8"), lambda path: read_orthophoto(path, crs="", low=LOW, high=HIGH)),
    "glTF": ("m.gltf", lambda: encoded(GLTF), lambda path: refuse_odd_references(path, file_format(path))),
    "blend": ("m.blend", lambda: b"BLENDER-v300LI\0\0" + bytes(40), refuse_special_references),
    "classes": ("y/data.yaml", BESIDE["y"]["y/data.yaml"], lambda path: foreign(path.parent / "images")),
    "YOLO": ("y/labels/1.txt", lambda: b"1 0.1 0.1 0.3 0.1 0.3 0.4\n", lambda path: foreign(path.parents[1] / "images")),
    "VOC": ("v/1.xml", lambda: VOC, lambda path: foreign(path.parent)),
    "PNG": ("a.png", lambda: picture("PNG"), read_picture),
    "JPEG": ("a.png", lambda: picture("JPEG"), read_picture),
    "provenance": ("provenance.json", lambda: encoded(RUNS), lambda path: read_provenance_by_plan(path.parent)),
    "predictions": (
        "p.json",
        lambda: encoded(FOUND),
        lambda path: read_predictions(path, labels_from_images(LabeledImages.from_coco_dict(COCO), path=path)),
    ),
    "run": ("run.json", lambda: encoded(RUN), lambda path: find_weights(path.parent)),
    "augmentation": (
        "a.yaml",
        (OWN_AUGMENTATIONS / "table1.yaml").read_bytes,
        lambda path: Augmenter(load_settings(None, {"augmentation": str(path)}).augmentation),
    ),
    "study": ("study.json", lambda: encoded(STUDY), lambda path: read_study(path.parent)),
    "weights": ("w.pt", weights, lambda path: load_detector(path, "cpu")),
    "tensors": ("w/model.safetensors", partial(tensors, "model.safetensors"), lambda path: load_detector(path.parent, "cpu")),
    "video": ("v.mp4", video, probe_video),
}
UNSOUND = ("glTF", "study", "weights")  # as the files above are
OPENED_BY_OTHERS = ("blend", "elevations", "orthophoto", "classes")  # or skipped, if they aren't regular
ODD = (
    *(b"", b"0", b"-1", b"1e308", b"5e-324", b"1e999", b"NaN", b".inf", b"1" + b"0" * 400, b"2147483648", b"[]", b"{}"),
    *(b"null", b"true", b'""', b"[" * 2000, b"<a>" * 99, b"&a [*a]", b"!!timestamp x", b"!!int ''", b"\0", b"\xff\xfe"),
    *(b"\n", b",", b"\xff\xff\xff\x7f", b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"a" * 5000),
)
# Where bytes are replaced, how many, and by which ones.
changes = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 8), st.sampled_from(ODD) | st.binary(max_size=8)), min_size=1, max_size=3
)


def written(folder: Path, name: str, data: bytes) -> Path:
    """Write the files of a reader into a folder; return the path of the one with the data."""
    path = folder / READERS[name][0]
    beside = BESIDE.get(READERS[name][0].split("/")[0], {})
    for other, content in {**beside, READERS[name][0]: lambda: data}.items():
        (folder / other).parent.mkdir(parents=True, exist_ok=True)
        (folder / other).write_bytes(content())
    return path


@pytest.mark.parametrize("name", READERS)
@settings(MANY, max_examples=max(5, MANY.max_examples // 5))
@given(changes=changes)
def test_any_file_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str, changes: list) -> None:
    _, content, read = READERS[name]
    data = content()
    for place, length, new in changes:
        at = round(place * len(data))
        data = data[:at] + new + data[at + length :]
    assert "\n" not in refusal(read, written(tmp_path_factory.getbasetemp() / name, name, data))


@pytest.mark.parametrize("name", READERS)
def test_a_sound_file_is_read_and_a_fifo_is_refused(tmp_path: Path, name: str) -> None:
    _, content, read = READERS[name]
    path = written(tmp_path, name, content())
    assert name in UNSOUND or refusal(read, path) == ""
    path.unlink()
    os.mkfifo(path)
    assert name in OPENED_BY_OTHERS or re.search("regular file|FIFO", refusal(read, path))
