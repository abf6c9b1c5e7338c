"""The labels that exports take from records, which may be anybody's."""

import pytest

from dataset.shares import rings_of
from geometry.errors import DatasetError


@pytest.mark.parametrize("rings", [[[1e308]], [[]], [{}], [[0, 0, 4, 0, 4]], [[0, 0, 4, 0, 4, "4"]], [[[0, 0, 4, 0]]]])
def test_a_polygon_that_is_none_is_a_line_and_no_traceback(rings):
    with pytest.raises(DatasetError, match="label 7 has a polygon that is no list of x, y, x, y"):
        rings_of({"id": 7, "bbox": [0, 0, 1, 2], "segmentation": rings})


@pytest.mark.parametrize("segmentation", [[], None, {"size": [6, 8], "counts": "0T1"}])
def test_a_label_without_polygons_is_its_box(segmentation):
    assert rings_of({"id": 7, "bbox": [1, 1, 2, 4], "segmentation": segmentation}) == [[1, 1, 3, 1, 3, 5, 1, 5]]
