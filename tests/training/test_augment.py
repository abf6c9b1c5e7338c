import json
import random
from functools import partial

import albumentations
import numpy as np
import pytest
from PIL import Image

from hulldown.base.errors import ConfigError
from hulldown.tests.builders.training_pictures import make_dataset
from hulldown.training.inputs import data
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.data import Batches, DrawnExamples, make_draws
from hulldown.training.inputs.settings import KNOWN_AUGMENTATIONS, load_settings
from hulldown.training.inputs.sources import Sample, read_classes_and_sources
from hulldown.training.sheet import write_augmentation_sheet

TABLE = load_settings(None, {"augmentation": "table1"}).augmentation


def augmentation(*transforms):
    """The contents of an Albumentations file with these transforms, each with its name and options."""
    listed = [{"__class_fullname__": name, **options} for name, options in transforms]
    return {"transform": {"__class_fullname__": "Compose", "transforms": listed}}


def parts_of(transform):
    """The transforms of a file, without groups."""
    inner = transform.get("transforms")
    return [transform] if inner is None else [part for one in inner for part in parts_of(one)]


AFFINE = [part for part in parts_of(TABLE["transform"]) if part["__class_fullname__"] == "Affine"]


def ellipse_sample(angle_deg=0.0, masked=True):
    """An ellipse of 60 x 24 in a picture of 200 x 120, turned counterclockwise, with its exact box."""
    rows, columns = np.mgrid[:120, :200] + 0.5
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    x, y = columns - 100, rows - 60
    mask = ((c * x - s * y) / 30) ** 2 + ((s * x + c * y) / 12) ** 2 <= 1
    picture = np.where(mask[..., None], 200, 40).astype(np.uint8) * np.ones(3, dtype=np.uint8)
    half = np.hypot([30 * c, 30 * s], [12 * s, 12 * c])
    xywh = np.array([[100 - half[0], 60 - half[1], 2 * half[0], 2 * half[1]]])
    return Sample(picture, xywh, np.array([1]), (mask,) if masked else ())


def mask_corners(mask):
    rows, columns = np.nonzero(mask)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


def corners(xywh):
    return np.concatenate((xywh[..., :2], xywh[..., :2] + xywh[..., 2:]), axis=-1)


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("affine", AFFINE, ids=["turned", "sheared"])
def test_boxes_follow_their_contents(affine, masked):
    # The box of a turned or sheared ellipse is much smaller than that of its turned box, with and without a mask.
    augment = Augmenter({"transform": affine | {"p": 1.0}})
    for seed in range(40):
        found = augment(ellipse_sample(masked=masked), seed)
        bright = mask_corners(found.picture[..., 0] > 120)
        assert np.abs(corners(found.xywh[0]) - bright).max() <= 2.0  # one pixel for interpolation


def test_an_empty_file_changes_nothing():
    sample = ellipse_sample(20)
    found = Augmenter(augmentation())(sample, 0)
    np.testing.assert_array_equal(found.picture, sample.picture)
    np.testing.assert_allclose(found.xywh, sample.xywh, atol=1e-4)


@pytest.mark.parametrize("masked", [True, False])
def test_a_box_cut_to_less_than_a_fifth_is_dropped(masked):
    picture = np.zeros((100, 100, 3), dtype=np.uint8)
    masks = np.zeros((3, 100, 100), dtype=bool)
    masks[0, 40:60, 0:20], masks[1, 40:60, 40:60], masks[2, 70:80, 70:90] = True, True, True
    xywh = np.array([[0, 40, 20, 20], [40, 40, 20, 20], [70, 70, 20, 10]], dtype=float)
    sample = Sample(picture, xywh, np.array([0, 1, 2]), tuple(masks) if masked else ())
    augment = Augmenter(augmentation(("Affine", {"p": 1.0, "translate_percent": [-0.4, 0.4]})))
    sizes = set()
    for seed in range(60):
        found = augment(sample, seed)
        sizes.add(len(found.class_index))
        for box, label in zip(found.xywh, found.class_index, strict=True):
            assert box[2] * box[3] >= 0.2 * (400, 400, 200)[label] - 20  # a mask has whole pixels
    assert min(sizes) < 3 == max(sizes)


def test_transforms_are_applied_with_their_probabilities_and_independently():
    # Three with distinguishable effects: a flip, a shift of the value, and noise.
    shifted = {"p": 0.3, "hue_shift_limit": 0, "sat_shift_limit": 0, "val_shift_limit": 20}
    augment = Augmenter(
        augmentation(
            ("HorizontalFlip", {"p": 0.5}),
            ("HueSaturationValue", shifted),
            ("GaussNoise", {"p": 0.3, "std_range": [0.01, 0.05]}),
        )
    )
    picture = np.full((32, 48, 3), (90, 120, 150), dtype=np.uint8)
    picture[:, :24] = (30, 60, 90)
    sample = Sample(picture, np.zeros((0, 4)), np.zeros(0, dtype=np.int64))
    seen = []
    for seed in range(1000):
        found = augment(sample, seed).picture.astype(float)
        flipped = found[:, :24].mean() > found[:, 24:].mean()
        noisy = found[:, :24].std(axis=(0, 1)).max() > 0.5
        other = picture[:, ::-1] if flipped else picture
        shifted = abs((found - other).mean()) > 0.7
        seen.append((flipped, noisy, shifted))
    flipped, noisy, shifted = np.array(seen).T
    for found, expected in ((flipped, 0.5), (noisy, 0.3), (shifted, 0.3), (noisy & shifted, 0.09)):
        assert abs(found.mean() - expected) < 5 * np.sqrt(expected * (1 - expected) / 1000) + 0.01
    assert abs((flipped & noisy).mean() - 0.15) < 0.07


@pytest.mark.parametrize("name", KNOWN_AUGMENTATIONS)
def test_every_transform_of_a_known_file_has_an_effect(name):
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (72, 128, 3), dtype=np.uint8)
    sample = Sample(picture, np.array([[40.0, 20, 30, 20]]), np.array([0]))
    for part in parts_of(load_settings(None, {"augmentation": name}).augmentation["transform"]):
        augment = Augmenter({"transform": part | {"p": 1.0}})
        changed = [augment(sample, seed).picture for seed in range(4)]
        assert any((other != picture).any() for other in changed), part
        assert all(other.shape == picture.shape and other.dtype == np.uint8 for other in changed), part


def test_a_file_of_albumentations_augments_like_itself(tmp_path):
    # Written by Albumentations with a treatment of boxes of its own, and named by a config beside it.
    boxes = albumentations.BboxParams(format="coco", label_fields=["class"])
    transforms = [albumentations.HorizontalFlip(p=1.0), albumentations.GaussNoise(p=1.0)]
    sample = ellipse_sample(20)
    for name in ("mine.json", "mine.yaml"):
        made = albumentations.Compose(transforms, bbox_params=boxes)
        albumentations.save(made, tmp_path / name, data_format=name[-4:])
        (tmp_path / "train.toml").write_text(f'augmentation = "{name}"\n')
        found = Augmenter(load_settings(tmp_path / "train.toml", {}).augmentation)(sample, 3)
        made.set_random_state(np.random.default_rng(3), random.Random(3))
        np.testing.assert_array_equal(found.picture, made(image=sample.picture, bboxes=[], **{"class": []})["image"])
        np.testing.assert_allclose(found.xywh[0, 0], 200 - sample.xywh[0, 0] - sample.xywh[0, 2], atol=1.0)


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (("Sheer", {"p": 1}), "has no Sheer"),
        (("Affine", {"p": 1, "degrees": 5}), "'degrees' are not valid for transform Affine"),
        (("Affine", {}), "Transform Affine has no 'p' parameter"),
        (("ImageCompression", {"p": 1, "quality_range": [90, 40]}), r"quality_range .*got \(90, 40\)"),
        (("HorizontalFlip", {"p": 2}), "p Input should be less than or equal to 1"),
    ],
)
def test_a_wrong_transform_is_named(transform, message):
    with pytest.raises(ConfigError, match=rf"augmentation: .*{message}"):
        Augmenter(augmentation(transform))


@pytest.mark.parametrize("transform", [[], 5, {}, {"__class_fullname__": "Compose"}, {"__class_fullname__": []}])
def test_a_file_of_other_content_is_refused(transform):
    with pytest.raises(ConfigError, match="augmentation: "):
        Augmenter({"transform": transform})


def test_pictures_that_no_network_reads_are_refused():
    with pytest.raises(ConfigError, match="augmentation: makes pictures of float32"):
        Augmenter(augmentation(("ToFloat", {"p": 1.0})))(ellipse_sample(), 0)


@pytest.mark.parametrize("kept_bytes", [0, 5 * 86 * 48 * 3, data.KEPT_PICTURE_BYTES])  # nothing, a few pictures, all
def test_draw_k_has_the_same_pixels_in_any_worker(tmp_path, monkeypatch, kept_bytes):
    _, sources = read_classes_and_sources({"demo": make_dataset(tmp_path / "set", 12)})
    draws = make_draws([12], 30, seed=5)
    examples = [DrawnExamples(sources, draws, (64, 48), TABLE, masks=True)]
    monkeypatch.setattr(data, "KEPT_PICTURE_BYTES", kept_bytes)
    examples.append(DrawnExamples(sources, draws, (64, 48), TABLE, masks=True))
    forwards = [examples[0][k] for k in range(30)]
    for k in range(29, -1, -1):
        again = examples[1][k]
        assert (again.picture == forwards[k].picture).all()
        assert (again.xyxy == forwards[k].xyxy).all()
        assert again.picture.shape == (3, 48, 64)


@pytest.mark.parametrize(
    ("draws", "batch", "sizes"), [(10, 4, [4, 4, 2]), (10, 2, [2, 2, 2, 2, 2]), (9, 2, [2, 2, 2, 2, 1]), (3, 4, [3])]
)
def test_every_draw_is_in_one_step_and_a_restart_continues_in_the_middle(draws, batch, sizes):
    batches = Batches(draws, batch=batch)
    found = list(batches)
    assert [k for one in found for k in one] == list(range(draws))
    assert [len(one) for one in found] == sizes
    assert len(batches) == len(found)
    assert list(Batches(draws, batch=batch, first=1)) == found[1:]


def sheet_of(dataset, **options):
    path = dataset.parent / "sheet.png"
    write_augmentation_sheet(dataset, path, **options)
    with Image.open(path) as sheet:
        return sheet.copy()


def test_the_sheet_has_a_row_of_nine_for_each_picture(tmp_path):
    sheet = partial(sheet_of, make_dataset(tmp_path / "set", 5))
    one, two = sheet(rows=1), sheet(rows=2)
    assert one.width == two.width
    assert 1.8 < two.height / one.height < 2.2
    assert sheet(rows=1).tobytes() == one.tobytes()
    assert sheet(rows=1, seed=1).tobytes() != one.tobytes()


def test_another_file_changes_the_sheet(tmp_path):
    path = tmp_path / "still.json"
    path.write_text(json.dumps(augmentation()))
    sheet = np.asarray(sheet_of(make_dataset(tmp_path / "set", 1), augmentation=str(path)))
    tile = sheet.shape[1] // 9
    assert np.abs(sheet[:, 4 : tile - 8].astype(int) - sheet[:, 4 + tile : 2 * tile - 8]).mean() < 12
