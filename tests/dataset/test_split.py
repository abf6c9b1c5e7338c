import json

import numpy as np
import pytest
from PIL import Image as Pictures

from hulldown.annotate.records import Image, Label
from hulldown.base.outputs import DONE_NAME, UNFINISHED_NAME, OutputError
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.exports.split import SPLIT_NAMES, split_name_by_image_id
from hulldown.dataset.images import position_group_key
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.tests.builders.editing import write_dataset


def pose(x: float) -> list:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix.tolist()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """60 positions of 5 shots, two classes, and 20 real images."""
    images = [
        {"file_name": f"images/{i}.png"} | ({"scenery": "hills", "position": i // 5, "shot": i % 5} if i < 300 else {})
        for i in range(320)
    ]
    labels = [
        {"image_id": i + 1, "category_id": 1 if i // 5 % 3 else 2, "bbox": [4, 3, 8, 6], "vehicle": "a"}
        | {"world_from_vehicle": pose(i // 5)}
        for i in range(300)
    ]
    return write_dataset(tmp_path_factory.mktemp("dataset"), images, labels, names=("tank", "truck"))


def image_of(number: int, labels: list[dict], **more) -> Image:
    of_image = {"image_id": number, "bbox": [0, 0, 1, 1]}
    records = [{"id": k, "category_id": 1, **of_image, **label} for k, label in enumerate(labels)]
    record = {"id": number, "file_name": f"{number}.png", "width": 8, "height": 6, **more}
    return Image.from_record(record, [Label.from_record(label, {}) for label in records])


@pytest.mark.parametrize("seed", range(5))
def test_images_of_one_position_stay_together(dataset, seed):
    images = read_usable_dataset(dataset).images
    split_of = split_name_by_image_id(images, seed=seed)
    splits_of_position = {}
    for image in images:
        if "position" in image.record:
            splits_of_position.setdefault(image.record["position"], set()).add(split_of[image.id])
    assert all(len(splits) == 1 for splits in splits_of_position.values())


def test_every_class_has_its_share_in_every_split(dataset):
    images = read_usable_dataset(dataset).images
    split_of = split_name_by_image_id(images, fractions=(0.7, 0.2, 0.1))
    for category, total in ((1, 200), (2, 100), (None, 20)):
        first = {image.id: image.labels[0].category_id if image.labels else None for image in images}
        splits = [split_of[i] for i, found in first.items() if found == category]
        for split, share in zip(SPLIT_NAMES, (0.7, 0.2, 0.1), strict=True):
            assert abs(splits.count(split) - share * total) <= 5  # one position


def shared_out(classes_of_images, **options):
    """Number of images in each split, and mean number of objects per image."""
    images = [image_of(i, [{"category_id": c} for c in found]) for i, found in enumerate(classes_of_images)]
    split_of = split_name_by_image_id(images, **options)
    members = {split: [image for image in images if split_of[image.id] == split] for split in SPLIT_NAMES}
    counts = {split: len(found) for split, found in members.items()}
    return counts, {split: np.mean([len(image.labels) for image in found]) for split, found in members.items()}


@pytest.mark.parametrize("seed", range(3))
def test_every_split_has_as_many_objects_per_image(seed):
    classes = [[1] * k for k in np.random.default_rng(seed).poisson(2, 400)]
    counts, objects = shared_out(classes, seed=seed)
    assert list(counts.values()) == [280, 80, 40]
    assert max(objects.values()) - min(objects.values()) < 0.1


def test_a_small_dataset_of_many_classes_reaches_every_split():
    counts, _ = shared_out([[i // 2] for i in range(14)])
    assert list(counts.values()) == [10, 3, 1]


def test_without_images_there_are_no_splits():
    assert split_name_by_image_id([]) == {}


def test_the_split_depends_only_on_the_seed(dataset):
    images = read_usable_dataset(dataset).images
    assert split_name_by_image_id(images) == split_name_by_image_id(images[::-1])
    assert split_name_by_image_id(images, seed=1) != split_name_by_image_id(images)


def test_a_share_of_zero_gets_nothing(dataset):
    images = read_usable_dataset(dataset).images
    assert set(split_name_by_image_id(images, fractions=(0.5, 0.5, 0.0)).values()) == {"train", "valid"}


@pytest.mark.parametrize("fractions", [(0.7, 0.2), (0.7, 0.2, 0.2), (1.2, -0.1, -0.1)])
def test_shares_that_do_not_add_up_are_refused(fractions):
    with pytest.raises((ValueError, TypeError), match=r"fractions"):
        split_name_by_image_id([], fractions=fractions)


@pytest.mark.parametrize("kind", [[], [[1, 2, 3]] * 3, "no pose", 7, {"x": 1}, [[0, 0, 0, "far"]] * 3, [None] * 4])
def test_other_formats_of_poses_do_not_group_images(kind):
    boxed = [{"world_from_vehicle": kind}]
    assert position_group_key(image_of(3, boxed, scenery="hills")) == "image 3"
    boxed.append({"vehicle": "a", "world_from_vehicle": pose(2)})
    assert position_group_key(image_of(3, boxed, scenery="hills")) == "hills a 2.000 0.000 0.000"


@pytest.mark.parametrize(
    "names", [("a/1.png", "b/1.png", "b/1.jpg"), ("1-3.png", "a/1.png", "b/1.png"), ("a/1-2.png", "b/1-2.png", "1.png")]
)
def test_equal_names_in_different_folders_stay_separate(tmp_path, names):
    sizes = range(4, 7)
    images = [{"file_name": name, "width": size, "height": 4} for name, size in zip(names, sizes, strict=True)]
    folder = write_dataset(tmp_path / "dataset", images)
    export_dataset(folder, tmp_path / "out", fractions=(1.0, 0.0, 0.0))
    coco = json.loads((tmp_path / "out" / "train" / "_annotations.coco.json").read_text())
    assert len({image["file_name"] for image in coco["images"]}) == 3
    for image in coco["images"]:
        with Pictures.open(tmp_path / "out" / "train" / image["file_name"]) as picture:
            assert picture.width == image["width"]
    for name, size in zip(names, sizes, strict=True):
        with Pictures.open(folder / name) as picture:
            assert picture.width == size


def test_a_folder_in_use_is_not_written_into(dataset, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("")
    with pytest.raises(OutputError, match=r"isn't empty: it has mine\.txt and no export; name a new"):
        export_dataset(dataset, out)


def test_the_remains_of_a_killed_export_are_replaced(dataset, tmp_path):
    (tmp_path / "out" / ".unfinished" / "train").mkdir(parents=True)
    (tmp_path / "out" / ".unfinished" / "train" / "old.png").touch()
    export_dataset(dataset, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted((DONE_NAME, *SPLIT_NAMES))
    assert not (tmp_path / "out" / "train" / "old.png").exists()


@pytest.mark.parametrize("left", [(), (DONE_NAME,), (DONE_NAME, "valid")])
def test_an_export_that_was_killed_late_is_done(dataset, tmp_path, capsys, left):
    """`left` wasn't moved yet."""
    out = tmp_path / "out"
    export_dataset(dataset, out)
    whole = sorted(out.rglob("*"))
    for name in left:
        (out / UNFINISHED_NAME).mkdir(exist_ok=True)
        (out / name).rename(out / UNFINISHED_NAME / name)
    assert sum(export_dataset(dataset, out).values()) > 0
    assert "is complete already" in capsys.readouterr().err
    assert sorted(out.rglob("*")) == whole
    with pytest.raises(OutputError, match="isn't empty"):
        export_dataset(dataset, out, fractions=(1.0, 0.0, 0.0))


def test_an_unwritable_target_of_an_export_is_refused(dataset, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"out: cannot be written \(Not a directory\)"):
        export_dataset(dataset, tmp_path / "file" / "out")
