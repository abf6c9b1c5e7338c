import json
import os
import subprocess
import sys

import numpy as np
import pytest

import hulldown.dataset.store.document as documents
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.provenance import GROWING_LISTS, Failure, Provenance, add_provenance, write_failures
from hulldown.dataset.store.document import read_coco
from hulldown.tests.builders.editing import edit

FOREIGN = {
    "info": {"description": "by hand", "year": 2024},
    "licenses": [{"id": 7, "name": "CC-BY"}],
    "weather_station": {"name": "north", "id": 18446744073709551615},
    "categories": [{"id": 3, "name": "truck", "keypoints": ["nose"]}, {"id": 9, "name": "tank"}],
    "images": [
        {"id": 40, "file_name": "real/b.jpg", "width": 640, "height": 480, "license": 7, "lens": {"mm": 35.5}},
        {"id": 12, "file_name": "real/a.jpg", "width": 640, "height": 480, "date_captured": "2024-05-06"},
    ],
    "annotations": [
        {"id": 0, "image_id": 12, "category_id": 3, "bbox": [1, 2, 3, 4], "area": 12, "iscrowd": 1, "score": 0.25},
        {"id": 99, "image_id": 40, "category_id": 9, "bbox": [1.5, 2, 3, 4], "segmentation": [[1, 2, 3, 4, 5, 6.5]]},
    ],
}  # fmt: skip


def image(i: int) -> dict:
    return {"file_name": f"images/{i:08d}.png", "width": 64, "height": 48, "shot": i}


def annotation(**more: object) -> dict:
    return {"category": "tank", "bbox": [1.0, 2.0, 3.5, 4.0], "visible_fraction": 0.5} | more


def load(folder) -> dict:
    return json.loads((folder / "annotations.json").read_text())


def test_a_new_dataset(tmp_path):
    with CocoDataset.open(tmp_path / "made" / "here") as dataset:
        assert dataset.append(image(1), [annotation(), annotation(category="truck", pose=np.eye(2))]) == 1
        assert dataset.append(image(2), []) == 2
        assert len(dataset) == 2
    coco = load(tmp_path / "made" / "here")
    assert [c["name"] for c in coco["categories"]] == ["tank", "truck"]
    assert coco["images"] == [{"id": 1, **image(1)}, {"id": 2, **image(2)}]
    first, second = coco["annotations"]
    assert (first["id"], first["image_id"], first["category_id"]) == (1, 1, 1)
    assert (first["area"], first["iscrowd"], first["segmentation"], first["visible_fraction"]) == (14.0, 0, [], 0.5)
    assert (second["id"], second["category_id"], second["pose"]) == (2, 2, [[1.0, 0.0], [0.0, 1.0]])


def test_an_id_of_none_is_the_next_one_and_of_true_is_refused(tmp_path):
    with CocoDataset.open(tmp_path) as dataset:
        assert dataset.append({**image(1), "id": None}, [annotation(id=None)]) == 1
        with pytest.raises(ValueError, match="expected a whole number above 0"):
            dataset.append({**image(2), "id": True}, [])
    coco = load(tmp_path)
    assert [record["id"] for record in (*coco["images"], *coco["annotations"])] == [1, 1]


def test_a_foreign_dataset_keeps_all_its_fields(tmp_path):
    (tmp_path / "annotations.json").write_text(json.dumps(FOREIGN))
    with CocoDataset.open(tmp_path, categories=["truck", "launcher"]) as dataset:
        assert dataset.finished("real/a.jpg")
        assert dataset.append(image(1), [annotation(), annotation(category="launcher")]) == 41
    coco = load(tmp_path)
    for key, value in FOREIGN.items():
        assert coco[key][: len(value)] == value if isinstance(value, list) else coco[key] == value
    assert coco["categories"][2:] == [{"id": 10, "name": "launcher", "supercategory": "vehicle"}]
    assert [(a["id"], a["category_id"]) for a in coco["annotations"][2:]] == [(100, 9), (101, 10)]


def test_the_first_of_two_categories_with_the_same_name_is_used(tmp_path):
    twice = [{"id": -5, "name": "tank"}, {"id": -3, "name": "tank"}]
    (tmp_path / "annotations.json").write_text(json.dumps({"categories": twice}))
    with CocoDataset.open(tmp_path) as dataset:
        dataset.add_categories([{"name": "car", "color": 1}, {"name": "car", "color": 2}])
        dataset.append(image(1), [annotation()])
    coco = load(tmp_path)
    assert coco["categories"] == [*twice, {"name": "car", "color": 1, "id": 1}]
    assert coco["annotations"][0]["category_id"] == -5


def test_two_plans_get_different_ids_and_names(tmp_path):
    with CocoDataset.open(tmp_path) as dataset:
        first = dataset.reserve_ids("f" * 64, images=10, annotations=20)
        dataset.append({**image(1), "id": 1}, [annotation(id=1)])
        second = dataset.reserve_ids("e" * 64, images=5, annotations=5)
    assert first.dataset_file_name("images/1.png") == "images/1.png"
    assert second.dataset_file_name("images/1.png") == "images/2-eeeeeeee-1.png"
    assert (second.image_offset, second.annotation_offset) == (10, 20)
    with CocoDataset.open(tmp_path) as dataset:
        assert dataset.reserve_ids("e" * 64, images=5, annotations=5) == second
        assert dataset.append(image(7), [annotation()]) == 16
    (tmp_path / "journal.jsonl").unlink()
    with CocoDataset.open(tmp_path) as dataset:
        assert dataset.reserve_ids("f" * 64, images=10, annotations=20) == first


def test_pictures_from_elsewhere_are_never_overwritten(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "00000001.png").write_bytes(b"mine")
    with pytest.raises(HulldownError, match="isn't empty: it has images and no dataset"):
        CocoDataset.open(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["images"]
    (tmp_path / "annotations.json").write_text("{}")
    with CocoDataset.open(tmp_path) as dataset:
        assert (
            dataset.reserve_ids("a" * 64, images=1, annotations=1).dataset_file_name("images/00000001.png")
            != "images/00000001.png"
        )


def test_records_deleted_by_hand_stay_deleted(tmp_path):
    with CocoDataset.open(tmp_path) as dataset:
        for i in range(3):
            dataset.append(image(i), [annotation()])
    edit(tmp_path, lambda coco: (coco["images"].pop(1), coco["annotations"].pop(1)))
    with CocoDataset.open(tmp_path) as dataset:
        assert not dataset.finished(image(1)["file_name"])
        dataset.append(image(3), [annotation()])
    assert [i["shot"] for i in load(tmp_path)["images"]] == [0, 2, 3]


def test_a_crash_between_the_two_files_doubles_nothing(tmp_path):
    with CocoDataset.open(tmp_path) as dataset:
        dataset.append(image(1), [annotation()])
    journal = (tmp_path / "journal.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "journal.jsonl").write_text("".join(journal[:-1]))  # without its line {"merged": true}
    CocoDataset.open(tmp_path).close()
    assert len(load(tmp_path)["images"]) == len(load(tmp_path)["annotations"]) == 1


def test_a_reader_changes_nothing_and_misses_nothing_that_is_merged_while_it_reads(tmp_path, monkeypatch):
    read = documents._read_coco_document
    with CocoDataset.open(tmp_path) as dataset:
        dataset.append(image(1), [annotation()])
        assert [i["id"] for i in read_coco(tmp_path)["images"]] == [1]
        assert not (tmp_path / "annotations.json").exists()
        dataset.merge()
        dataset.append(image(2), [annotation()])

        def and_merge(path):
            document = read(path)
            dataset.append(image(3), [annotation()])
            dataset.merge()
            return document

        with monkeypatch.context() as patch:
            patch.setattr(documents, "_read_coco_document", and_merge)
            assert [i["id"] for i in read_coco(tmp_path)["images"]] == [1, 2, 3]
    assert read_coco(tmp_path) == load(tmp_path)
    assert len(load(tmp_path)["annotations"]) == 3


def test_a_link_in_place_of_the_temporary_file_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    folder = tmp_path / "d"
    folder.mkdir()
    for name in ("annotations.json", "provenance.json", "failures.jsonl"):
        (folder / f".{name}.{os.getpid()}.tmp").symlink_to(tmp_path / "mine")
    CocoDataset.open(folder).close()
    add_provenance(folder, {"a": Provenance(**{key: [] for key in GROWING_LISTS})})
    write_failures(folder, [Failure(file_name="a.png")])
    assert (tmp_path / "mine").read_text() == "mine"
    assert not any(path.name.endswith(".tmp") for path in folder.iterdir())


def test_abandoning_removes_nothing_of_the_next_process(tmp_path, monkeypatch):
    dataset = CocoDataset.open(tmp_path / "d")
    release, following = dataset._lock.release, []

    def and_another_opens():
        release()
        following.append(CocoDataset.open(tmp_path / "d"))

    monkeypatch.setattr(dataset._lock, "release", and_another_opens)
    dataset.undo_open()
    following[0].append(image(1), [annotation()])
    following[0].close()
    assert (tmp_path / "d" / "journal.jsonl").exists()
    assert len(read_coco(tmp_path / "d")["images"]) == 1


def test_a_second_process_is_refused(tmp_path):
    with CocoDataset.open(tmp_path):
        code = f"from hulldown.dataset.coco import CocoDataset; CocoDataset.open({str(tmp_path)!r})"
        other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "another process is writing this dataset; wait until it has ended" in other.stderr
    CocoDataset.open(tmp_path).close()


def edited_run(**changes: object) -> bytes:
    run = {"key": "k", "image_offset": 0, "annotation_offset": 0, "prefix": "", "images": 1, "annotations": 1}
    return json.dumps({"info": {"hulldown_runs": [{**run, **changes}]}}).encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "isn't a COCO object"),
        (b"", "isn't a COCO object"),
        (b'{"images": []}{}', "isn't a COCO object"),
        (b'{"images": [{"id": 1, "file_name": "\xff.png"}]}', "isn't a COCO object"),
        (b'{"images": [{"id": NaN}]}', "isn't a COCO object"),
        (b'{"images": [{"id": 1, "x": %b}]}' % (b"[" * 300 + b"]" * 300), "a record cannot be written again"),
        (b'{"images": [{"id": 1, "x": %b}]}' % (b"[" * 9999 + b"]" * 9999), "isn't a COCO object"),
        (b"[]", "isn't a COCO object"),
        (b'{"images": {}}', ".*'images' is not a list of objects"),
        (b'{"images": [1]}', ".*'images' is not a list of objects"),
        (b'{"images": [{"id": "a"}]}', "image id 'a' is not a whole number"),
        (b'{"annotations": [{"bbox": []}]}', "annotation id None is not a whole number"),
        (edited_run(prefix="../"), r"'info' has 'hulldown_runs' that are not as they were written .*\[0\]\.prefix"),
        (edited_run(images=-1), r"'info' has 'hulldown_runs' that are not as they were written .*\[0\]\.images"),
    ],
)
def test_an_unusable_file_is_refused_and_unchanged(tmp_path, content, message):
    path = tmp_path / "annotations.json"
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=rf"annotations\.json: {message}.*; repair it"):
        CocoDataset.open(tmp_path)
    assert path.read_bytes() == content
    path.unlink()
    CocoDataset.open(tmp_path).close()


@pytest.mark.parametrize(
    "line",
    [
        {"image": {"id": 1}, "annotations": []},
        {"image": {"id": "1", "file_name": "1.png"}, "annotations": []},
        {"image": {"id": 1, "file_name": "1.png"}},
        {"image": {"id": 1, "file_name": "1.png"}, "annotations": [{"id": 1.5}]},
        {"categories": [{"id": 2, "name": "tank"}]},
        {"categories": [{"id": [], "name": "truck"}]},
        {"run": {"key": "k"}},
        {"run": json.loads(edited_run(images=-1))["info"]["hulldown_runs"][0]},
    ],
)
def test_the_error_of_an_invalid_journal_line_names_it(tmp_path, line):
    with CocoDataset.open(tmp_path, categories=["tank"]):
        pass
    journal = tmp_path / "journal.jsonl"
    journal.write_bytes(journal.read_bytes() + json.dumps(line).encode() + b"\n")
    before = journal.read_bytes()
    with pytest.raises(DatasetError, match=r"journal\.jsonl: line 3 does not fit this journal"):
        CocoDataset.open(tmp_path)
    with pytest.raises(DatasetError, match=r"journal\.jsonl: line 3 does not fit this journal"):
        read_coco(tmp_path)
    assert journal.read_bytes() == before


@pytest.mark.parametrize(
    "change",
    [
        lambda text: json.dumps(json.loads(text), indent=2),
        lambda text: json.dumps(dict(reversed(json.loads(text).items()))),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace('"images"', '"im\\u0061ges"').replace('"shot":0', '"shot":1.50,"shot":0'),
    ],
)
def test_other_layouts_of_the_same_json_are_read(tmp_path, change):
    with CocoDataset.open(tmp_path) as dataset:
        for i in range(3):
            dataset.append(image(i), [annotation()])
    path, before = tmp_path / "annotations.json", read_coco(tmp_path)
    path.write_text(change(path.read_text()))
    assert read_coco(tmp_path) == before


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(HulldownError, match="is a file, not a folder"):
        CocoDataset.open(tmp_path / "file")


@pytest.mark.parametrize(
    ("of_image", "of_label", "message"),
    [
        *(
            ({"file_name": name}, {}, "file_name: expected a path inside the dataset that is free")
            for name in ("/a.png", "../a.png", ".unfinished/1", "annotations.json", "Journal.jsonl", "logs/1", ".")
        ),
        ({"width": 0}, {}, "width: expected a whole number of pixels"),
        ({"height": 1.5}, {}, "height: expected a whole number of pixels"),
        ({"id": 0}, {}, "id: expected a whole number above 0"),
        ({"id": 5}, {}, "id: expected a whole number above 0 that is not in use"),
        ({"fov_x_deg": float("nan")}, {}, "image: fov_x_deg: expected finite numbers"),
        ({}, {"category": None}, r"annotations\[1\]: category: expected a name"),
        ({}, {"bbox": [1, 2, 3]}, r"annotations\[1\]: bbox: expected \[x, y, width, height\]"),
        ({}, {"bbox": [1, 2, -3, 4]}, r"annotations\[1\]: bbox"),
        ({}, {"bbox": np.array([1, 2, np.inf, 4])}, r"annotations\[1\]: bbox: expected finite numbers"),
        ({}, {"id": 1}, r"annotations\[1\]: id: .* not in use"),
    ],
)
def test_an_invalid_record_is_named_and_leaves_no_trace(tmp_path, of_image, of_label, message):
    with CocoDataset.open(tmp_path) as dataset:
        dataset.append({**image(5), "id": 5}, [])
        with pytest.raises(ValueError, match=message):
            dataset.append({**image(1), **of_image}, [annotation(id=1), annotation(**of_label)])
        assert len(dataset) == 1
    coco = load(tmp_path)
    assert (len(coco["images"]), coco["annotations"], coco["categories"]) == (1, [], [])


def test_merging_takes_a_limited_share_of_the_time(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("hulldown.dataset.coco.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("hulldown.dataset.store.journal.os.fsync", lambda descriptor: None)
    writes = []

    def ten_seconds(path: object) -> None:
        writes.append(clock[0])
        clock[0] += 10.0

    with CocoDataset.open(tmp_path) as dataset:
        monkeypatch.setattr(dataset._document, "write", ten_seconds)
        for i in range(1100):
            clock[0] += 1.0
            dataset.append(image(i), [])
    # Soon at first, when the cost is unknown; then once in 500 s, for 2 % of the time; and at the end.
    assert np.diff(writes).round().tolist() == [511.0, 511.0, 77.0]
