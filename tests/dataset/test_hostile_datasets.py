"""Datasets with broken pictures, impossible masks, repeated keys, and links to other files."""

import errno
import os
import shutil
import subprocess
import sys

import pytest

from hulldown.base.errors import DatasetError, HulldownError
from hulldown.dataset.exports.export import LAYOUTS, export_dataset
from hulldown.dataset.record_checks import finding_lines
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import edit, write_dataset


@pytest.fixture
def folder(tmp_path):
    """Three photographs with one label each."""
    labels = [{"image_id": i, "bbox": [1, 1, 4, 4], "segmentation": []} for i in (1, 2, 3)]
    return write_dataset(tmp_path / "dataset", [{"file_name": f"{i}.png"} for i in (1, 2, 3)], labels)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_broken_pictures_are_all_named_and_not_exported(folder, tmp_path, layout):
    (folder / "1.png").write_bytes((folder / "1.png").read_bytes()[:60])
    (folder / "2.png").unlink()
    edit(folder, lambda coco: coco["images"][2].update(width=33))
    wanted = r"3 pictures cannot be used: 1\.png cannot be read as a picture .*2\.png is missing, 3\.png is 32 x 24"
    with pytest.raises(DatasetError, match=wanted) as error:
        export_dataset(folder, tmp_path / "out", layout=layout)
    assert error.value.path == folder
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [{}, {"layout": "voc"}, {"polygons": True}])
def test_impossible_masks_are_all_named_and_not_exported(folder, tmp_path, options):
    def with_masks(coco):
        for label, mask in zip(coco["annotations"], ([[1, 1, 5, 1, 5, 5]], [[1, 1]], 7), strict=True):
            label["segmentation"] = mask

    edit(folder, with_masks)
    wanted = r"2 masks cannot be used: 2\.png: annotation 2: segmentation: expected .* annotation 3: segmentation:"
    with pytest.raises(DatasetError, match=wanted):
        export_dataset(folder, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("exists", [False, True])
def test_a_full_disk_is_not_reported_as_a_broken_picture_and_nothing_is_left(folder, tmp_path, monkeypatch, exists):
    def full(source, target, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), source, None, target)

    def no_links(source, target):
        raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), source, None, target)

    monkeypatch.setattr(os, "link", no_links)
    monkeypatch.setattr(shutil, "copyfile", full)
    out = tmp_path / "out"
    if exists:
        out.mkdir()
    with pytest.raises(HulldownError, match=r"out: cannot be written \(No space left") as error:
        export_dataset(folder, out)
    assert "free some space" in error.value.remedy
    assert list(out.iterdir()) == [] if exists else not out.exists()


def test_many_equal_annotations_are_few_lines(folder):
    def repeat(coco):
        coco["annotations"] += [{**coco["annotations"][0], "id": i} for i in range(4, 3004)]

    edit(folder, repeat)
    lines = finding_lines(verify_dataset(folder))
    assert len(lines) == 21
    assert "2980 more" in lines[-1]


def test_findings_of_a_kind_are_counted_beyond_twenty(folder):
    edit(folder, lambda coco: coco.update(annotations=[
        {**coco["annotations"][0], "id": i, "category_id": 9, "bbox": [i % 20, i // 20, 2, 1]} for i in range(1, 201)
    ]))  # fmt: skip
    lines = finding_lines(verify_dataset(folder))
    assert len(lines) == 21
    assert "180 more" in lines[-1]


def test_repeated_keys_are_found(folder):
    path = folder / "annotations.json"
    path.write_text(path.read_text().replace('"bbox": ', '"bbox": [9, 9, 1, 1], "bbox": '))
    (finding,) = verify_dataset(folder)
    assert (finding.severity, "'bbox'" in finding.problem, "3 objects" in finding.problem) == ("error", True, True)


def test_a_file_that_is_no_picture_is_not_exported(folder, tmp_path):
    (folder / "2.png").write_text("secret")
    with pytest.raises(DatasetError, match=r"2\.png cannot be read as a picture"):
        export_dataset(folder, tmp_path / "out")


def test_output_to_an_ascii_terminal_works(folder, tmp_path):
    (folder / "ü.png").write_bytes((folder / "1.png").read_bytes() + b" ")
    edit(folder, lambda coco: coco["images"][0].update(file_name="ü.png", width=31))
    command = [sys.executable, "-m", "hulldown", "verify", str(folder)]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr.count(b"Traceback")) == (1, 0)
    assert rb"\xfc.png" in done.stdout
