"""Pictures that don't show what their labels say are found; photographs are skipped."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from hulldown.annotate.masks import encode_mask, mask_box
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.verification.check_pictures import target_appearance
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import append

SIZE = (180, 320)
NOBODY = np.zeros(SIZE, dtype=bool)


def scene(seed):
    """Rough ground with an upright box on it, and the box's position."""
    rng = np.random.default_rng(seed)
    ground = ndimage.gaussian_filter(rng.normal(0.0, 1.0, SIZE), 1.5) * 90.0 + np.array(120.0)
    mask = np.zeros(SIZE, dtype=bool)
    y, x = rng.integers(40, 120), rng.integers(30, 230)
    mask[y : y + 40, x : x + 60] = True
    picture = np.where(mask, 60.0 + 0.3 * ndimage.gaussian_filter(rng.normal(0.0, 200.0, SIZE), 2.0), ground)
    return np.repeat(picture.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2), mask


def dataset(folder, pictures, masks, **fields):
    with CocoDataset.open(folder, categories=["tank"]) as target:
        for i, (picture, mask) in enumerate(zip(pictures, masks, strict=True)):
            label = {"segmentation": encode_mask(mask), "area": int(mask.sum()), "bbox": mask_box(mask).tolist()}
            labels = [{"category": "tank", **label}]
            append(target, f"images/{i}.png", Image.fromarray(picture), labels, hashed=not fields, **fields)
    return list(verify_dataset(folder))


def painted(picture, mask, level):
    return np.where(mask[..., None], np.uint8(level), picture)


def test_sound_pictures_have_no_findings(tmp_path):
    scenes = [scene(i) for i in range(6)]
    assert dataset(tmp_path, *zip(*scenes, strict=True)) == []


@pytest.mark.parametrize(
    ("level", "problem"), [(3, "its pixels are black: 3.0 of 255"), (254, "its pixels are white: 254.0 of 255")]
)
def test_a_target_that_is_black_or_overexposed_is_found(tmp_path, level, problem):
    picture, mask = scene(0)
    (found,) = dataset(tmp_path, [painted(picture, mask, level)], [mask])
    assert (found.severity, found.where) == ("error", "images/0.png: annotation 1")
    assert found.problem == problem
    assert found.figure == pytest.approx(level, abs=0.1)


@pytest.mark.parametrize(("color", "found"), [((212, 150, 209), True), ((166, 70, 140), True), ((161, 130, 165), False)])
def test_ground_in_the_color_of_missing_pictures_is_found(tmp_path, color, found):
    picture, mask = scene(0)
    picture[150:] = color
    problems = [one.problem for one in dataset(tmp_path, [picture], [mask]) if one.severity == "error"]
    assert ["magenta" in problem for problem in problems] == [True] * found


@pytest.mark.parametrize(("apart", "severity"), [(0, "error"), (3, "warning"), (30, None)])
def test_a_barely_visible_target_is_found_with_its_contrast(tmp_path, apart, severity):
    _, mask = scene(0)
    fog = np.full((*SIZE, 3), 170, dtype=np.uint8)
    found = dataset(tmp_path, [painted(fog, mask, 170 + apart)], [mask])
    assert [(each.severity, each.figure) for each in found] == ([(severity, apart)] if severity else [])


def plain_car():
    """A car whose windows and shadows have much steeper edges than its outline, on ground without texture."""
    _, mask = scene(0)
    inner = ndimage.binary_erosion(mask, iterations=5)
    stripes = np.where(np.arange(SIZE[1]) // 4 % 2, 200, 60)[None, :]
    return np.where(inner, stripes, np.where(mask, 128, 116)), mask


def truck_in_snow():
    """A truck that is slightly darker than the ground, behind falling snow."""
    _, mask = scene(0)
    flakes = np.random.default_rng(1).random(SIZE) > 0.9
    snow = ndimage.gaussian_filter(np.where(flakes, 170.0, 0.0), 0.7)
    return np.where(mask, 150, 165) + snow - snow.mean(), mask


@pytest.mark.parametrize("sound", [plain_car, truck_in_snow])
def test_sound_pictures_with_little_contrast_have_no_findings(tmp_path, sound):
    levels, mask = sound()
    picture = np.repeat(levels.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)
    assert dataset(tmp_path, [picture], [mask]) == []


def test_photographs_are_skipped(tmp_path):
    picture, mask = scene(0)
    assert dataset(tmp_path, [np.zeros_like(picture)], [mask], taken="at night") == []


def test_an_empty_mask_has_no_appearance():
    assert target_appearance(scene(3)[0], NOBODY, NOBODY) is None
