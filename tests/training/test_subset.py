import pytest

from hulldown.base.errors import DatasetError
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.tests.builders.editing import write_dataset
from hulldown.training.subset import nested_subset_ids, write_subsets


def make(folder, count, shots=1):
    images = [{"file_name": f"images/{i:03}.png", "scenery": "hills"} for i in range(count)]
    if shots > 1:
        images = [{**image, "position": i // shots, "shot": i % shots} for i, image in enumerate(images)]
    label_of = [1 if i // shots % 4 else 2 for i in range(count)]
    labels = [{"image_id": i, "category_id": label, "bbox": [0, 0, 2, 2]} for i, label in enumerate(label_of, start=1)]
    return write_dataset(folder, images, labels, names=("tank", "truck"))


def names(folder):
    return {image.file_name for image in read_usable_dataset(folder).images}


def test_subsets_of_the_paper_are_nested_datasets_with_linked_pictures(tmp_path):
    dataset = make(tmp_path / "real", 420)
    assert write_subsets(dataset, tmp_path / "out") == {"100": 420, "50": 210, "25": 105, "10": 42, "5": 21}
    larger = names(dataset)
    for name in ("100", "50", "25", "10", "5"):
        subset = names(tmp_path / "out" / name)
        assert subset <= larger
        larger = subset
        assert all(image.labels for image in read_usable_dataset(tmp_path / "out" / name).images)
        for file_name in subset:
            assert (tmp_path / "out" / name / file_name).samefile(dataset / file_name)


def test_the_seed_matters_and_the_order_of_records_and_ids_does_not(tmp_path):
    found = read_usable_dataset(make(tmp_path / "real", 40)).images

    def chosen(images, **options):
        by_id = {image.id: image.file_name for image in images}
        return [by_id[i] for i in nested_subset_ids(images, [1.0], **options)[0]]

    assert chosen(found) == chosen(found[::-1])
    assert chosen(found) != chosen(found, seed=1)
    assert sorted(chosen(found)) == sorted(image.file_name for image in found)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stratified", [False, True])
def test_images_of_a_position_stay_together(tmp_path, seed, stratified):
    dataset = make(tmp_path / "set", 60, shots=5)
    counts = write_subsets(dataset, tmp_path / "out", fractions=(0.5, 0.1), seed=seed, stratified=stratified)
    assert counts == {"50": 30, "10": 5}
    for name in counts:
        positions = [image.record["position"] for image in read_usable_dataset(tmp_path / "out" / name).images]
        assert all(positions.count(p) == 5 for p in positions)


@pytest.mark.parametrize("seed", range(3))
def test_classes_keep_their_proportions_on_request(tmp_path, seed):
    write_subsets(make(tmp_path / "set", 160), tmp_path / "out", fractions=(0.5, 0.1), seed=seed, stratified=True)
    for name, trucks in (("50", 20), ("10", 4)):
        images = read_usable_dataset(tmp_path / "out" / name).images
        labels = [label.category_id for image in images for label in image.labels]
        assert abs(labels.count(2) - trucks) <= 1


@pytest.mark.parametrize(
    ("count", "fractions", "message"),
    [
        (4, (0.0,), "fraction 0: expected a share above 0 and at most 1"),
        (4, (1.5,), r"fraction 1\.5: expected a share"),
        (4, (float("nan"),), "fraction nan: expected a share"),
        (4, (0.5, 0.5), r"fraction 0\.5 is given twice"),
        (0, (0.5,), "has no images"),
    ],
)
def test_fractions_out_of_range_and_empty_datasets_are_refused(tmp_path, count, fractions, message):
    with pytest.raises(DatasetError, match=message):
        write_subsets(make(tmp_path / "set", count), tmp_path / "out", fractions=fractions)
    assert not (tmp_path / "out").exists()


def test_a_missing_picture_is_named_and_nothing_is_written(tmp_path):
    dataset = make(tmp_path / "set", 4)
    (dataset / "images/002.png").unlink()
    with pytest.raises(DatasetError, match=r"002\.png: is missing"):
        write_subsets(dataset, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_exported_split_is_a_dataset(tmp_path):
    dataset = make(tmp_path / "set", 4)
    (dataset / "annotations.json").rename(dataset / "_annotations.coco.json")
    assert write_subsets(dataset, tmp_path / "out", fractions=(0.5,)) == {"50": 2}
