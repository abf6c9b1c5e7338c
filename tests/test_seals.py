"""Changes to pictures, records, and journal lines after writing are found."""

import json
import os

import orjson
import pytest

from hulldown.base.errors import DatasetError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export
from hulldown.dataset.join import join
from hulldown.dataset.store.document import read_coco
from hulldown.dataset.store.seals import PICTURE_KEY, RECORD_KEY, digest, seal_of
from hulldown.dataset.verification.verify import verify
from hulldown.tests.editing import edit, render


def fill(folder, n=3, **more):
    """A dataset of the first images of a plan."""
    return render(folder, range(n), **{"seal": True, **more})


def errors(folder, **options):
    return [str(finding) for finding in verify(folder, **options) if finding.severity == "error"]


def test_every_record_has_hashes_of_itself_and_its_picture(tmp_path):
    coco = read_coco(fill(tmp_path))
    assert list(verify(tmp_path)) == []
    for image in coco["images"]:
        assert image[PICTURE_KEY] == digest((tmp_path / image["file_name"]).read_bytes())
    assert all(record[RECORD_KEY] == seal_of(record) for record in (*coco["images"], *coco["annotations"]))


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
    "change",
    [
        lambda c: c["annotations"][1]["bbox"].__setitem__(0, 0.5),
        lambda c: c["annotations"][1].update(category_id=2),
        lambda c: c["images"][1].update(hdri="noon"),
        lambda c: c["images"][1].update({PICTURE_KEY: "0" * 64}),
        lambda c: c["images"][1].pop(PICTURE_KEY),
    ],
)
def test_a_changed_record_is_found_unless_it_is_marked_as_edited(tmp_path, change):
    edit(fill(tmp_path), change)
    found = errors(tmp_path)
    assert found
    assert any("was changed after it was recorded" in line for line in found)
    assert errors(tmp_path, fast=True) == []
    edit(tmp_path, lambda c: [record.update({RECORD_KEY: None}) for record in (c["images"][1], c["annotations"][1])])
    assert not any("was changed" in line for line in errors(tmp_path))


def test_a_record_without_a_seal_is_a_warning(tmp_path):
    edit(fill(tmp_path), lambda c: c["annotations"][1].pop(RECORD_KEY))
    (found,) = verify(tmp_path)
    assert found.severity == "warning"
    assert f"has no {RECORD_KEY}" in found.problem


def test_old_datasets_and_photographs_need_no_seals(tmp_path):
    fill(tmp_path, seal=False)
    journal = tmp_path / "journal.jsonl"
    old = [json.loads(line) for line in journal.read_text().splitlines()]
    for line in old:
        line.pop("line_sha256", None)
    journal.write_bytes(b"".join(orjson.dumps(line) + b"\n" for line in old))
    assert list(verify(tmp_path)) == []
    assert all(RECORD_KEY not in record for record in read_coco(tmp_path)["annotations"])
    fill(tmp_path, 2, key="d" * 64)
    assert list(verify(tmp_path)) == []


@pytest.mark.parametrize("merged", [True, False])
def test_a_flipped_bit_in_the_journal_is_found(tmp_path, merged):
    journal = fill(tmp_path, 2) / "journal.jsonl"
    if not merged:
        (tmp_path / "annotations.json").unlink()
        journal.write_bytes(journal.read_bytes().replace(b'{"merged":true}\n', b""))
    before = journal.read_bytes()
    missed = []
    for at in range(0, len(before), 3):
        spoilt = bytearray(before)
        spoilt[at] ^= 1 << at % 8
        journal.write_bytes(spoilt)
        if not _found(tmp_path):
            missed.append((at, bytes(spoilt[max(at - 20, 0) : at + 20])))
    assert missed == []


def _found(folder):
    try:
        return list(verify(folder, fast=True))
    except DatasetError as error:
        return [error]


def test_join_keeps_seals_and_refuses_records_that_do_not_match(tmp_path):
    part = fill(tmp_path / "part")
    fill(tmp_path / "all", key="e" * 64)
    join([part], tmp_path / "all")
    assert list(verify(tmp_path / "all")) == []
    edit(part, lambda c: c["annotations"][1].update(category_id=2))
    with pytest.raises(DatasetError, match="annotation 2 is not as it was recorded; check it with"):
        join([part], tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_export_has_matching_seals(tmp_path):
    fill(tmp_path / "all")
    edit(tmp_path / "all", lambda c: c["images"][1].update(license=7))
    export(tmp_path / "all", tmp_path / "out", fractions=(1.0, 0.0, 0.0))
    coco = json.loads((tmp_path / "out/train/_annotations.coco.json").read_text())
    assert [image[RECORD_KEY] == seal_of(image) for image in coco["images"]] == [True, False, True]
    edit(tmp_path / "all", lambda c: c["images"][1].update(width=7))
    with pytest.raises(DatasetError, match="its record has 7 x "):
        export(tmp_path / "all", tmp_path / "again", fractions=(1.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["annotations.json", "journal.jsonl", "failures.jsonl", "provenance.json"])
def test_a_pipe_in_place_of_a_file_does_not_block(tmp_path, name):
    part = fill(tmp_path / "part")
    (part / name).unlink(missing_ok=True)
    os.mkfifo(part / name)
    with pytest.raises(DatasetError, match="isn't a regular file"):
        join([part], tmp_path / "new")


def test_a_name_of_a_megabyte_is_abbreviated(tmp_path):
    edit(fill(tmp_path), lambda c: c["images"][1].update(file_name="x" * 1_000_000))
    assert max(len(str(finding)) for finding in verify(tmp_path)) < 3000
    with pytest.raises(DatasetError) as refused:
        export(tmp_path, tmp_path / "out")
    assert len(str(refused.value)) < 3000


@pytest.mark.parametrize("name", ["images/./00000001.png", "images//00000001.png", "./images/00000001.png"])
def test_two_spellings_of_one_path_are_one_name(tmp_path, name):
    with CocoDataset.open(fill(tmp_path, 1)) as target, pytest.raises(ValueError, match="is in the dataset already"):
        target.append({"file_name": name, "width": 8, "height": 6}, [])
    edit(tmp_path, lambda c: c["images"].append({**c["images"][0], "id": 9, "file_name": name}))
    assert "error: images/00000001.png: belongs to 2 image records" in errors(tmp_path)
