"""Joining parts of plans, and datasets made elsewhere."""

import json
import os
import warnings

import pytest
from PIL import Image

from hulldown.base.errors import DatasetError
from hulldown.dataset.join import join_datasets
from hulldown.dataset.store.document import read_coco
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import PLAN, edit, render, write_dataset

ENTRY = {"first_image_id": 1, "images": 6, "blender": ["5.0"], "devices": [], "systems": ["x"], "confinement": ["x"]}


def photos(folder, names, *, first=0):
    """A dataset made elsewhere; pictures and ids are numbered from `first`."""
    images = [{"id": i, "file_name": name, "width": 8, "height": 6} for i, name in enumerate(names, start=first)]
    label = {"id": 0, "image_id": first, "category_id": 1, "bbox": [1, 1, 2, 2], "score": 0.5}
    write_dataset(folder, images, [label], names=("tank", "car"))

    def made_elsewhere(coco):
        coco["info"] = {"year": 2024}
        coco["categories"][0].update(id=5, keypoints=["nose"])
        coco["categories"][1].update(id=7, supercategory="civil")
        coco["annotations"][0].update(category_id=5)

    edit(folder, made_elsewhere)
    return folder


def contents(folder):
    """All files of a dataset, except those that only a running process needs."""
    hidden = (".hulldown.lock", "journal.jsonl")
    files = [p for p in folder.rglob("*") if p.is_file() and p.name not in hidden]
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def test_joining_again_adds_only_new_images(tmp_path):
    one, two = render(tmp_path / "1", [0]), render(tmp_path / "2", [4])
    first = join_datasets([one, two], tmp_path / "joined")
    assert (first.added, first.already, first.failed, first.missing) == (2, 0, 0, 4)
    assert (tmp_path / "joined/images/00000001.png").samefile(one / "images/00000001.png")
    before = contents(tmp_path / "joined")
    again = join_datasets([one, two], tmp_path / "joined")
    assert (again.added, again.already) == (0, 2)
    assert contents(tmp_path / "joined") == before
    render(one, [1, 2])
    # The other machine has also rendered one of the first machine's images.
    render(two, [0])
    more = join_datasets([two, one], tmp_path / "joined")
    assert (more.added, more.already, more.missing) == (2, 3, 2)


def test_a_part_is_read_up_to_the_end_of_its_journal(tmp_path):
    part = render(tmp_path / "1", [0, 1])
    (part / "annotations.json").unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        assert join_datasets([part], tmp_path / "joined").added == 2


def test_two_plans_get_different_ids_and_names(tmp_path):
    one, two = render(tmp_path / "1", [0, 5]), render(tmp_path / "2", [0, 2], key="b" * 64)
    rest = render(tmp_path / "3", [1], key="b" * 64)
    # A dataset that already has both plans, under another prefix.
    both = render(render(tmp_path / "4", [3], key="b" * 64), [1])
    for parts in ([one, two], [rest], [both]):
        join_datasets(parts, tmp_path / "joined")
    coco = read_coco(tmp_path / "joined")
    found = {image["id"]: (image["file_name"], image["shot"]) for image in coco["images"]}
    assert found == {
        1: ("images/00000001.png", 0),
        2: ("images/00000002.png", 1),
        6: ("images/00000006.png", 5),
        7: ("images/2-bbbbbbbb-00000001.png", 0),
        8: ("images/2-bbbbbbbb-00000002.png", 1),
        9: ("images/2-bbbbbbbb-00000003.png", 2),
        10: ("images/2-bbbbbbbb-00000004.png", 3),
    }
    assert {a["id"]: a["image_id"] for a in coco["annotations"]} == {2 * i - 1 + k: i for i in found for k in (0, 1)}
    assert verify_dataset(tmp_path / "joined") == []


def test_a_dataset_made_elsewhere_keeps_its_fields(tmp_path):
    part = photos(tmp_path / "real", ["a.png", "b/c.png"])
    joined = tmp_path / "joined"
    join_datasets([render(tmp_path / "1", [0]), part], joined)
    join_datasets([part], joined)
    coco = read_coco(joined)
    assert [(c["id"], c["name"], c.get("supercategory")) for c in coco["categories"]] == [
        (1, "tank", "vehicle"), (2, "truck", "vehicle"), (3, "car", "civil"),
    ]  # fmt: skip
    assert [(i["id"], i["file_name"]) for i in coco["images"]] == [
        (1, "images/00000001.png"), (7, "a.png"), (8, "b/c.png"),
    ]  # fmt: skip
    box = coco["annotations"][-1]
    assert (box["id"], box["image_id"], box["category_id"], box["score"]) == (13, 7, 1, 0.5)
    assert verify_dataset(joined) == []


def test_join_appends_to_an_existing_dataset(tmp_path):
    real = photos(tmp_path / "real", ["a.png"])
    join_datasets([render(tmp_path / "1", [0, 1])], real)
    coco = read_coco(real)
    assert coco["info"]["year"] == 2024
    assert [i["file_name"] for i in coco["images"]] == [
        "a.png", "images/1-aaaaaaaa-00000001.png", "images/1-aaaaaaaa-00000002.png",
    ]  # fmt: skip


def test_failures_and_provenance_are_carried_over(tmp_path):
    parts = [render(tmp_path / "1", [0]), render(tmp_path / "2", [1])]
    for device, part in zip(("CPU", "GPU"), parts, strict=True):
        failure = {"index": 2, "file_name": "images/00000003.png", "reasons": [device]}
        (part / "failures.jsonl").write_text(json.dumps(failure) + "\n")
        (part / "provenance.json").write_text(json.dumps({"plans": {PLAN: {**ENTRY, "devices": [device]}}}))
    joined = tmp_path / "joined"
    photos(joined, ["a.png", "b.png"])
    assert join_datasets(parts, joined).failed == 1
    (line,) = map(json.loads, (joined / "failures.jsonl").read_text().splitlines())
    assert (line["index"], line["file_name"]) == (2, "images/1-aaaaaaaa-00000003.png")
    (found,) = json.loads((joined / "provenance.json").read_text())["plans"].values()
    assert (found["devices"], found["first_image_id"]) == (["CPU", "GPU"], 2)
    # Another machine has rendered it since.
    assert join_datasets([render(tmp_path / "3", [2])], joined).failed == 0
    assert not (joined / "failures.jsonl").exists()


def run_without_a_key(folder):
    """A record with an id of the dataset's plan, but without a plan."""
    edit(folder, lambda coco: coco["info"]["hulldown_runs"][0].update(key=""))
    (folder / "journal.jsonl").unlink(missing_ok=True)


def edited(key, **fields):
    return lambda folder: edit(folder, lambda coco: coco[key][0].update(fields))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "images/00000001.png").unlink(), r"00000001\.png: is missing"),
        (
            lambda folder: edit(folder, lambda coco: coco.update(licenses=[{"id": 1}])),
            "has 'licenses', which joining would lose; join the other parts into this one",
        ),
        (run_without_a_key, r"'hulldown_runs' that are not as they were written .*\[0\]\.key"),
        (edited("images", id=2), r"00000002\.png: has the id 2, as has images/00000001\.png"),
        (edited("images", file_name="images/00000002.png"), "file names aren't unique"),
        (edited("annotations", id=2), "annotation 2: its id is given twice"),
        (edited("annotations", image_id=77), "image 77 does not exist"),
        (lambda folder: (folder / "provenance.json").write_text("{}"), "isn't a hulldown provenance file"),
        (lambda folder: (folder / "annotations.json").write_text("{"), "isn't a COCO object"),
        (edited("annotations", bbox=[5, 5, -1, 3]), r"00000001\.png: annotations\[0\]: bbox: expected"),
        (edited("categories", name=""), "category 1: name is ''"),
        (edited("annotations", id=11), r"00000001\.png: annotation 11 is on another image too"),
    ],
)
def test_a_part_that_cannot_be_joined_leaves_the_dataset_unchanged(tmp_path, damage, message):
    part, other, target = render(tmp_path / "1", [0, 1]), render(tmp_path / "2", [5]), render(tmp_path / "3", [3])
    damage(part)
    before = contents(target)
    for folder in (target, tmp_path / "new" / "joined"):
        with pytest.raises(DatasetError, match=message):
            join_datasets([other, part], folder)
    assert contents(target) == before
    assert not (tmp_path / "new").exists()


def test_a_picture_whose_plan_was_removed_is_still_recognized(tmp_path):
    share = render(tmp_path / "1", [0])
    bare = render(tmp_path / "2", [0])
    (bare / "journal.jsonl").unlink()
    edit(bare, lambda coco: coco.pop("info"))
    assert (join_datasets([share, bare], tmp_path / "new").added, len(read_coco(tmp_path / "new")["images"])) == (1, 1)


def with_photograph(folder, image_id, name="real/x.png"):
    """A photograph added by hand, with an id or a name reserved for the plan, or without a record."""
    (folder / name).parent.mkdir(exist_ok=True)
    Image.new("RGB", (8, 6), (200, 7, 7)).save(folder / name)
    photograph = {"id": image_id, "file_name": name, "width": 8, "height": 6}
    edit(folder, lambda coco: coco["images"].extend([photograph] if image_id else []))
    return folder


IN_THE_WAY = {
    "photo": lambda folder: photos(folder, ["a.png"]),
    "namesake": lambda folder: photos(folder, ["a.png"], first=9),
    "first": lambda folder: render(folder, [0]),
    "called like first": lambda folder: photos(folder, ["images/00000001.png"]),
    "fourth": lambda folder: render(folder, [3]),
    "numbered like fourth": lambda folder: with_photograph(render(folder, [0, 1]), 4),
    "also called like fourth": lambda folder: with_photograph(render(folder, [0]), 99, "images/00000004.png"),
    "with a file called like photo": lambda folder: with_photograph(render(folder, [0]), None, "a.png"),
}


@pytest.mark.parametrize(
    ("parts", "target", "message"),
    [
        (["photo", "namesake"], "new", r"namesake/a\.png: is another picture than .*; give one of them another name"),
        (["namesake"], "photo", r"a\.png: is another picture than .*; give one of them another name"),
        (["called like first", "first"], "new", r"0001\.png: is another picture than .*; give the one of no plan"),
        (["first", "called like first"], "new", r"0001\.png: is another picture than .*; give the one of no plan"),
        (["called like first"], "first", r"0001\.png: is another picture than"),
        (["fourth"], "also called like fourth", r"0004\.png: is another picture than .*; give the one of no plan"),
        (["photo"], "with a file called like photo", r"a\.png: is another picture than"),
        (["numbered like fourth", "fourth"], "new", r"\.png: has the id 4, as has .*\.png; give the one that is not"),
        (["fourth"], "numbered like fourth", r"\.png: has the id 4, as has .*\.png; give the one that is not"),
        (["numbered like fourth"], "fourth", r"\.png: has the id 4, as has .*\.png; give the one that is not"),
    ],
)
def test_another_picture_with_the_same_name_or_id_is_refused(tmp_path, parts, target, message):
    for name in {*parts, target} - {"new"}:
        IN_THE_WAY[name](tmp_path / name)
    before = contents(tmp_path)
    with pytest.raises(DatasetError, match=message):
        join_datasets([tmp_path / part for part in parts], tmp_path / target)
    assert contents(tmp_path) == before
    assert not (tmp_path / "new").exists()
    assert target != "photo" or not (tmp_path / target / "journal.jsonl").exists()


def test_a_name_without_the_plans_prefix_is_not_the_plans(tmp_path):
    real = photos(tmp_path / "real", ["a.png"])
    with_photograph(render(real, [0]), 4)
    assert join_datasets([real, render(tmp_path / "2", [2])], tmp_path / "new").added == 4
    found = {image["file_name"]: image["id"] for image in read_coco(tmp_path / "new")["images"]}
    assert found == {"images/00000001.png": 1, "images/00000003.png": 3, "a.png": 7, "real/x.png": 8}


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("provenance.json", {"plans": {"a": {**ENTRY, "blender": [{}]}}}, "isn't a hulldown provenance file"),
        ("failures.jsonl", [], "line 1 is damaged"),
    ],
)
def test_a_damaged_dataset_is_unchanged(tmp_path, name, content, message):
    target = render(tmp_path / "1", [0])
    (target / name).write_text(json.dumps(content) + "\n")
    before = contents(target)
    with pytest.raises(DatasetError, match=message):
        join_datasets([render(tmp_path / "2", [1])], target)
    assert contents(target) == before


def test_the_dataset_itself_and_folders_without_a_dataset_are_refused_as_parts(tmp_path):
    part = render(tmp_path / "1", [0])
    with pytest.raises(DatasetError, match="is a part of itself"):
        join_datasets([part], part)
    with pytest.raises(DatasetError, match=r"no annotations\.json and no journal"):
        join_datasets([tmp_path], tmp_path / "joined")


def test_no_picture_is_written_outside(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    joined = tmp_path / "joined"
    joined.mkdir()
    (joined / "images").symlink_to(outside)
    (joined / "annotations.json").write_text("{}")
    with pytest.raises(DatasetError, match="leads out of the dataset"):
        join_datasets([render(tmp_path / "1", [0])], joined)
    assert list(outside.iterdir()) == []
    assert sorted(path.name for path in joined.iterdir()) == ["annotations.json", "images"]


def test_without_links_pictures_are_copied(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    part = render(tmp_path / "1", range(6))
    join_datasets([part], tmp_path / "joined")
    assert not (tmp_path / "joined/images/00000001.png").samefile(part / "images/00000001.png")
    assert contents(tmp_path / "joined") == contents(part)
