import numpy as np
import pytest

from hulldown.annotate.masks import decode_mask, mask_area_and_box


def test_uncompressed_run_lengths_and_polygons_are_read():
    assert np.array_equal(decode_mask({"size": [2, 3], "counts": [2, 2, 2]}, 3, 2), [[0, 1, 0], [0, 1, 0]])
    assert np.array_equal(decode_mask([[1, 0, 3, 0, 3, 2, 1, 2]], 4, 3), [[0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0]])


def test_damaged_run_lengths_do_no_harm():
    """pycocotools writes beyond its memory with some of these, and crashes then or later."""
    rng = np.random.default_rng(0)
    refused = 0
    for text in rng.integers(40, 120, (2000, 24), dtype=np.uint8):
        record = {"size": [13, 17], "counts": bytes(text[: rng.integers(1, 25)]).decode("ascii")}
        try:
            assert decode_mask(record, 17, 13).shape == (13, 17)
        except ValueError:
            refused += 1
    assert refused > 1900


LENGTHS = [None, 5, {}, "zzz", "", "o", "0 0", "\u00e9", "oooooooo0", "1", [-1], [99], [3], ["a"], [[None]], [10**30]]


@pytest.mark.parametrize(
    "segmentation",
    [
        *(5, "x", [1], [], [[1, 2, 3, 4]], {"size": [3, 4]}),
        *({"size": size, "counts": "0"} for size in (3, [4, 3])),
        *([[wrong] * 6] for wrong in ("a", None, 1e9)),
        *({"size": [3, 4], "counts": counts} for counts in LENGTHS),
    ],
)
def test_invalid_segmentations_are_refused(segmentation):
    with pytest.raises(ValueError, match="segmentation: expected"):
        decode_mask(segmentation, 4, 3)


def test_a_mask_of_40_000_million_pixels_needs_no_memory():
    n = 200_000
    pixels, box = mask_area_and_box({"size": [n, n], "counts": [5 * n + 7, 3, n * n - 5 * n - 10]}, n, n)
    assert (pixels, box.tolist()) == (3, [5.0, 7.0, 1.0, 3.0])
    with pytest.raises(ValueError, match="pixels at most"):
        mask_area_and_box([[0, 0, 5, 0, 5, 5]], n, n)
