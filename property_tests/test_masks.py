"""Masks encoded and decoded, compared with pycocotools and brute force."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pycocotools import mask as pycocotools_mask

from hulldown.annotate.masks import decode_mask, encode_mask, mask_area_and_box, mask_box, mask_iou

sizes = st.tuples(st.integers(1, 24), st.integers(1, 24))
noise = sizes.flatmap(lambda size: hnp.arrays(bool, size))


@st.composite
def blobs(draw: st.DrawFn) -> np.ndarray:
    """Unions and differences of discs and rectangles, which look like vehicles with holes."""
    h, w = draw(sizes)
    y, x = np.mgrid[:h, :w]
    mask = np.zeros((h, w), dtype=bool)
    for _ in range(draw(st.integers(0, 4))):
        cy, cx, r = draw(st.integers(-2, h + 2)), draw(st.integers(-2, w + 2)), draw(st.integers(0, 9))
        disc = (x - cx) ** 2 + (y - cy) ** 2 <= r * r
        box = (abs(x - cx) <= r) & (abs(y - cy) <= draw(st.integers(0, 9)))
        shape = disc if draw(st.booleans()) else box
        mask = mask & ~shape if draw(st.booleans()) else mask | shape
    return mask


masks = noise | blobs()


@given(masks)
def test_run_lengths_round_trip(mask: np.ndarray) -> None:
    h, w = mask.shape
    record = encode_mask(mask)
    assert np.array_equal(decode_mask(record, w, h), mask)
    assert np.array_equal(pycocotools_mask.decode(record).astype(bool), mask)
    assert int(pycocotools_mask.area(record)) == mask.sum()
    box = mask_box(mask)
    assert pycocotools_mask.toBbox(record).tolist() == ([0.0] * 4 if box is None else box.tolist())
    pixels, extent_box = mask_area_and_box(record, w, h)
    assert pixels == mask.sum()
    assert (extent_box is None) if box is None else extent_box.tolist() == box.tolist()


@given(masks, st.data())
def test_overlap_equals_that_of_pycocotools(mask: np.ndarray, data: st.DataObject) -> None:
    other = data.draw(hnp.arrays(bool, mask.shape))
    expected = float(pycocotools_mask.iou([encode_mask(mask)], [encode_mask(other)], [0])[0, 0])
    either = mask.any() or other.any()
    assert mask_iou(mask, other) == (expected if either else 1.0)
    assert mask_iou(mask, other) == mask_iou(other, mask)
