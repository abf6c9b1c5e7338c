"""Properties of augmented pictures, for any picture, boxes, and seed."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.tests.training.test_augment import TABLE, augmentation, corners, mask_corners
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.data import make_example, shrink_for_augmentation
from hulldown.training.inputs.sources import Sample

WIDTH, HEIGHT = 96, 64
FULL = Augmenter(TABLE)
FLIP = Augmenter(augmentation(("HorizontalFlip", {"p": 1.0})))
SEEDS = st.integers(0, 2**32 - 1)


SIDES = st.tuples(st.floats(2, WIDTH), st.floats(2, HEIGHT), st.floats(0, 1), st.floats(0, 1))
SCENES = st.tuples(SEEDS, st.lists(SIDES, max_size=4), st.booleans())


def sample_of(scene):
    """A picture of noise with boxes, all with masks or none; not a strategy, since type checks draw random numbers."""
    seed, sides, masked = scene
    picture = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    boxes, masks = [], []
    for w, h, along, down in sides:
        x, y = along * (WIDTH - w), down * (HEIGHT - h)
        boxes.append([x, y, w, h])
        rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        inside = (abs(columns - x - w / 2) <= w / 2) & (abs(rows - y - h / 2) <= h / 2)
        masks.append(inside)
    xywh = np.array(boxes, dtype=np.float64).reshape(-1, 4)
    return Sample(picture, xywh, np.arange(len(boxes)), tuple(masks) if masked else ())


@given(SCENES, SEEDS)
def test_a_box_stays_in_the_picture_and_agrees_with_its_mask(scene, seed):
    sample = sample_of(scene)
    found = FULL(sample, seed)
    boxes = corners(found.xywh)
    assert (boxes >= -1e-4).all()  # Albumentations computes boxes in float32
    assert (boxes <= np.array([WIDTH, HEIGHT] * 2) + 1e-4).all()
    assert (found.xywh[:, 2:] > 0).all()
    assert len(set(found.class_index.tolist())) == len(found.class_index)
    assert len(found.masks) == (len(boxes) if sample.masks else 0)
    for box, mask in zip(boxes, found.masks, strict=False):
        assert np.abs(box - mask_corners(mask)).max() <= 1.0 + 1e-3


@given(SCENES, SEEDS)
def test_two_flips_cancel(scene, seed):
    sample = sample_of(scene)
    once = FLIP(sample, seed)
    twice = FLIP(once, seed)
    np.testing.assert_array_equal(once.picture, sample.picture[:, ::-1])
    np.testing.assert_array_equal(twice.picture, sample.picture)
    np.testing.assert_allclose(twice.xywh, sample.xywh, rtol=0, atol=1e-3)
    for mask, original in zip(twice.masks, sample.masks, strict=True):
        np.testing.assert_array_equal(mask, original)


@given(SCENES, st.integers(32, 200), st.integers(32, 200))
def test_boxes_scale_with_their_picture(scene, width, height):
    sample = sample_of(scene)
    seen = make_example(shrink_for_augmentation(sample, (width, height)), (width, height))
    assert tuple(seen.picture.shape) == (3, height, width)
    scale = [width / WIDTH, height / HEIGHT] * 2
    np.testing.assert_allclose(seen.xyxy.numpy(), corners(sample.xywh) * scale, rtol=1e-5, atol=1e-4)
