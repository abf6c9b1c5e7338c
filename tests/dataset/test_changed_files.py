"""Changes to pictures and records after they were recorded are found."""

import hashlib
import os

import pytest

from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.base.errors import DatasetError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.join import join_datasets
from hulldown.dataset.store.document import read_coco
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import PLAN, edit, render, write_dataset


def fill(folder, n=3, **more):
    """A dataset of the first images of a plan."""
    return render(folder, range(n), **{"hashed": True, **more})


def errors(folder, **options):
    return [str(finding) for finding in verify_dataset(folder, **options) if finding.severity == "error"]


def test_every_image_has_the_hash_of_its_picture(tmp_path):
    coco = read_coco(fill(tmp_path))
    assert list(verify_dataset(tmp_path)) == []
    for image in coco["images"]:
        assert image[PICTURE_HASH_KEY] == hashlib.sha256((tmp_path / image["file_name"]).read_bytes()).hexdigest()


def test_swapped_pictures_of_equal_size_are_found(tmp_path):
    fill(tmp_path)
    a, b = (tmp_path / f"images/{i:08d}.png" for i in (1, 2))
    os.rename(a, tmp_path / "images/x.png")
    os.rename(b, a)
    os.rename(tmp_path / "images/x.png", b)
    found = errors(tmp_path)
    assert len(found) == 2
    assert all("is not the picture that was recorded" in line for line in found)
    assert errors(tmp_path, fast=True) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda c: c["annotations"][2]["bbox"].__setitem__(0, 0.5), "annotation 3 was changed"),
        (lambda c: c["annotations"][2].update(category_id=2), "annotation 3 was changed"),
        (lambda c: c["annotations"].pop(2), "annotation 3 was deleted"),
        (lambda c: c["annotations"].append({**c["annotations"][2], "id": 99}), "annotation 99 was added"),
        (lambda c: c["images"][1].update(hdri="noon"), "its record was changed"),
        (lambda c: c["images"][1].pop(PICTURE_HASH_KEY), "its record was changed"),
    ],
)
def test_a_changed_added_or_deleted_record_is_found_while_there_is_a_journal(tmp_path, change, problem):
    edit(fill(tmp_path), change)
    (found,) = (line for line in errors(tmp_path, fast=True) if "after it was recorded" in line)
    assert found == f"error: images/00000002.png: {problem} after it was recorded; if that's meant, delete journal.jsonl"
    (tmp_path / "journal.jsonl").unlink()
    assert errors(tmp_path, fast=True) == []


def test_images_that_were_deleted_and_made_again_or_are_from_elsewhere_are_no_changes(tmp_path):
    write_dataset(tmp_path, [{"file_name": "photo.png"}])
    edit(fill(tmp_path), lambda c: (c["images"].pop(), c["annotations"].pop(), c["annotations"].pop()))
    edit(tmp_path, lambda c: c["images"][0].update(license=7))
    assert errors(tmp_path) == []
    with CocoDataset.open(tmp_path) as dataset:
        run = dataset.reserve_ids(PLAN, images=6, annotations=12)
        image = {"file_name": run.dataset_file_name("images/00000003.png"), "width": 8, "height": 6, "id": run.image_offset + 3}
        dataset.append(image, [{"category": "truck", "bbox": [0, 0, 1, 3]}])
    assert errors(tmp_path) == []


def test_a_dataset_with_lines_of_older_versions_is_continued(tmp_path):
    journal = fill(tmp_path) / "journal.jsonl"
    (tmp_path / "annotations.json").unlink()
    lines = [line for line in journal.read_text().splitlines() if line != '{"merged":true}']
    journal.write_text("".join(f'{line[:-1]},"line_sha256":"{"0" * 64}"}}\n' for line in lines))
    fill(tmp_path, 0)
    assert errors(tmp_path) == []


@pytest.mark.parametrize("name", ["annotations.json", "journal.jsonl", "failures.jsonl", "provenance.json"])
def test_a_pipe_in_place_of_a_file_does_not_block(tmp_path, name):
    part = fill(tmp_path / "part")
    (part / name).unlink(missing_ok=True)
    os.mkfifo(part / name)
    with pytest.raises(DatasetError, match="isn't a regular file"):
        join_datasets([part], tmp_path / "new")


def test_a_name_of_a_megabyte_is_abbreviated(tmp_path):
    edit(fill(tmp_path), lambda c: c["images"][1].update(file_name="x" * 1_000_000))
    assert max(len(str(finding)) for finding in verify_dataset(tmp_path)) < 3000
    with pytest.raises(DatasetError) as refused:
        export_dataset(tmp_path, tmp_path / "out")
    assert len(str(refused.value)) < 3000


@pytest.mark.parametrize("name", ["images/./00000001.png", "images//00000001.png", "./images/00000001.png"])
def test_two_spellings_of_one_path_are_one_name(tmp_path, name):
    with CocoDataset.open(fill(tmp_path, 1)) as target, pytest.raises(ValueError, match="is in the dataset already"):
        target.append({"file_name": name, "width": 8, "height": 6}, [])
    edit(tmp_path, lambda c: c["images"].append({**c["images"][0], "id": 9, "file_name": name}))
    assert "error: images/00000001.png: belongs to 2 records" in errors(tmp_path)
