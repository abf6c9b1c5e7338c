"""Reading any dataset gives findings or a one-line error."""

from __future__ import annotations

import copy
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.join import join_datasets
from hulldown.property_tests.any_values import MANY, containers, refusal, values_of
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import append

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # damaged datasets may also cause warnings
KEYS = (
    *("id", "file_name", "width", "height", "image_id", "category_id", "bbox", "segmentation", "area", "iscrowd"),
    *("bbox_amodal", "visible_fraction", "world_from_vehicle", "picture_sha256", "world_from_camera"),
    *("hulldown_runs", "key", "image_offset", "annotation_offset", "prefix", "images", "annotations", "run", "merged"),
    *("name", "counts", "size", "hdri", "weather", "scenery", "position"),
)
masks = ([[0, 0, 4, 0, 4, 4]], *({"size": [6, 8], **counts} for counts in ({}, {"counts": [48]}, {"counts": "0T1"})))
values = values_of(".", "CON", *masks)
change = st.tuples(st.integers(0, 2**16), st.sampled_from(KEYS), values, st.sampled_from(["set", "drop", "put", "twice"]))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rendered images and a photograph, in a dataset that each example copies."""
    folder = tmp_path_factory.mktemp("sound") / "d"
    with CocoDataset.open(folder, categories=["tank"]) as dataset:
        dataset.reserve_ids("f" * 64, images=2, annotations=2)
        for i in (1, 2, 7):
            mask = {"size": [6, 8], "counts": [7, 4, 37]}
            label = {"id": i, "category": "tank", "bbox": [1, 1, 2, 4], "segmentation": mask, "area": 4}
            append(dataset, f"images/{i}.png", Image.new("RGB", (8, 6), (40 * i, 90, 9)), [label], hashed=i < 7, id=i)
    return folder


@contextmanager
def copied(sound: Path) -> Iterator[Path]:
    """A copy of the dataset in a new folder."""
    with tempfile.TemporaryDirectory() as top:
        yield Path(shutil.copytree(sound, Path(top) / "d"))


def changed(value: Any, changes: list[tuple[int, str, Any, str]]) -> Any:
    """A JSON value with changed values, keys, and items."""
    for at, key, new, how in changes:
        found = containers(value)
        if not found:
            return value
        place = found[at % len(found)]
        if isinstance(place, dict):
            keys = [key, *place] if how == "put" else list(place) or [key]
            place[keys[at % len(keys)]] = copy.deepcopy(new)  # later changes must not reach the original
            if how == "drop":
                place.pop(keys[at % len(keys)])
        elif how == "twice" and place:
            place.append(copy.deepcopy(place[at % len(place)]))
        elif how == "drop" and place:
            place.pop(at % len(place))
        elif place:
            place[at % len(place)] = copy.deepcopy(new)
    return value


def used(folder: Path) -> None:
    uses: list[Callable[[], object]] = [
        lambda: [str(finding) for finding in verify_dataset(folder)],
        lambda: export_dataset(folder, folder.parent / "coco"),
        lambda: export_dataset(folder, folder.parent / "yolo", layout="yolo"),
        lambda: join_datasets([folder], folder.parent / "joined"),
        lambda: CocoDataset.open(folder, categories=["truck"]).close(),
    ]
    assert all(len(refusal(use)) < 5000 for use in uses)
    outside = {path.name for path in folder.parent.iterdir()} - {"d", "coco", "yolo", "joined"}
    assert outside == set()


@MANY
@given(st.lists(change, min_size=1, max_size=4))
def test_any_annotations_file_is_read_or_refused(sound: Path, changes: list) -> None:
    with copied(sound) as folder:
        path = folder / "annotations.json"
        path.write_bytes(orjson.dumps(changed(orjson.loads(path.read_bytes()), changes)))
        used(folder)


@MANY
@given(st.lists(change, min_size=1, max_size=4), st.booleans())
def test_any_journal_is_read_or_refused(sound: Path, changes: list, alone: bool) -> None:
    with copied(sound) as folder:
        path = folder / "journal.jsonl"
        lines = [orjson.loads(line) for line in path.read_bytes().splitlines()]
        if alone:
            (folder / "annotations.json").unlink()
        found = changed(lines, changes)
        path.write_bytes(b"".join(orjson.dumps(line) + b"\n" for line in found))
        used(folder)


@MANY
@given(st.binary(max_size=40), st.sampled_from(["annotations.json", "journal.jsonl", "provenance.json", "failures.jsonl"]))
def test_any_bytes_are_refused_in_one_line(sound: Path, content: bytes, name: str) -> None:
    with copied(sound) as folder:
        (folder / name).write_bytes(content)
        used(folder)
