"""No file name leads out of its dataset."""

import contextlib
import os
import tempfile
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from hulldown.base.errors import DatasetError
from hulldown.dataset.store.placed_pictures import link_or_copy_picture, move_picture_to_dataset, require_path_inside

PARTS = st.sampled_from(["..", ".", "", "a", "link", "deep", "a b", "~", "C:", "\\", "..\\", "x.png", " ", "ü"])
NAMES = st.one_of(
    st.lists(PARTS, min_size=1, max_size=6).map("/".join),
    st.lists(PARTS, min_size=1, max_size=4).map("\\".join),
    st.text(max_size=20),
)


@given(name=NAMES)
def test_no_name_leads_out_of_the_dataset(name):
    with tempfile.TemporaryDirectory() as made:
        root = Path(made).resolve()
        dataset, outside = root / "dataset", root / "outside"
        (dataset / "a").mkdir(parents=True)
        outside.mkdir()
        (dataset / "link").symlink_to(outside)
        (dataset / "a" / "deep").symlink_to("../../outside")
        picture = root / "picture.png"
        picture.write_bytes(b"picture")
        try:
            path = require_path_inside(dataset, name)
        except DatasetError:
            return
        assert Path(os.path.realpath(path)).is_relative_to(dataset)
        for give in (link_or_copy_picture, move_picture_to_dataset):
            with contextlib.suppress(DatasetError):  # a folder has that name, or the name is too long
                give(picture, dataset, name)
        assert list(outside.iterdir()) == []
        assert {p.name for p in root.iterdir()} <= {"dataset", "outside", "picture.png"}
