"""Saved copies of a picture are recognized; other and plain pictures aren't."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from hulldown.assets.picture_files import read_pixels
from hulldown.dataset.verification.check_pictures import near_duplicate_pairs, perceptual_hash
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import write_dataset


def scene(seed):
    rng = np.random.default_rng(seed)
    smooth = [ndimage.gaussian_filter(rng.normal(0, 1, (90, 160)), s) * 60 * s for s in (2, 6, 15)]
    return Image.fromarray((120 + sum(smooth)).clip(0, 255).astype(np.uint8)).convert("RGB")


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    for i in range(20):
        scene(i).save(folder / f"{i}.png")
    return folder


def hashes(paths):
    return [perceptual_hash(read_pixels(path)) for path in paths]


def paths(folder):
    return [folder / f"{i}.png" for i in range(20)]


@pytest.mark.parametrize(
    ("suffix", "change"),
    [
        (".jpg", lambda picture: picture),
        (".webp", lambda picture: picture),
        (".jpg", lambda picture: picture.resize((80, 45))),
        (".png", lambda picture: picture.resize((320, 180))),
        (".jpg", lambda picture: picture.point(lambda level: min(255, int(1.15 * level)))),
        (".png", lambda picture: picture.convert("L")),
    ],
)
def test_a_saved_copy_of_a_picture_is_found_and_no_other(photographs, tmp_path, suffix, change):
    again = []
    for i, path in enumerate(paths(photographs)):
        with Image.open(path) as picture:
            change(picture).save(tmp_path / f"{i}{suffix}")
        again.append(tmp_path / f"{i}{suffix}")
    pairs = near_duplicate_pairs(hashes(paths(photographs)), hashes(again))
    np.testing.assert_array_equal(pairs, np.stack([np.arange(20)] * 2, axis=1))


def test_plain_pictures_match_nothing():
    plain = [perceptual_hash(np.full((90, 160, 3), level, dtype=np.uint8)) for level in (0, 90, 255)]
    assert plain == [None] * 3
    assert len(near_duplicate_pairs(plain, plain)) == 0


def test_verify_warns_of_photographs_with_the_same_content(photographs, tmp_path):
    names = ["0.png", "1.png", "0.jpg"]
    for name in names:
        with Image.open(photographs / f"{name[0]}.png") as picture:
            picture.save(tmp_path / name, quality=70)
    write_dataset(tmp_path, [{"file_name": name, "width": 160, "height": 90} for name in names])
    (finding,) = verify_dataset(tmp_path)
    assert (finding.severity, finding.where, "0.png" in finding.problem) == ("warning", "0.jpg", True)
