"""A dataset survives appending, cutting, and killing without lost or doubled records."""

from __future__ import annotations

import json
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hulldown.dataset.coco
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.join import join_datasets
from hulldown.dataset.store.document import read_coco

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # of cut journals and missing files of killed processes
texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=8)
numbers = st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False)
values = st.recursive(
    st.none() | st.booleans() | numbers | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
extra = st.dictionaries(texts.map("x_{}".format), values, max_size=3)
boxes = st.lists(st.floats(0, 1e4), min_size=4, max_size=4)
annotations = st.lists(
    st.builds(
        lambda more, box, category: {**more, "bbox": box, "category": category},
        extra,
        boxes,
        st.sampled_from(["tank", "truck", "Lkw"]),
    ),
    max_size=3,
)
batches = st.lists(st.tuples(extra, annotations), max_size=5)


def append_all(folder: Path, batch: list, first: int) -> None:
    with CocoDataset.open(folder) as dataset:
        for i, (more, boxed) in enumerate(batch, start=first):
            if not dataset.finished(name := f"images/{i}.png"):
                dataset.append({**more, "file_name": name, "width": 8, "height": 6}, boxed)


@given(batches, batches)
def test_records_of_two_sessions_are_appended_in_order(first: list, second: list) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        append_all(folder, first, 0)
        append_all(folder, second, len(first))
        coco = json.loads((folder / "annotations.json").read_text())
        assert coco == read_coco(folder)
        names = {category["id"]: category["name"] for category in coco["categories"]}
        given_labels = []
        for i, (record, (more, labels)) in enumerate(zip(coco["images"], first + second, strict=True), start=1):
            assert record == {**record, **more, "id": i, "file_name": f"images/{i - 1}.png"}
            given_labels += [{**label, "image_id": i} for label in labels]
        for k, (record, label) in enumerate(zip(coco["annotations"], given_labels, strict=True), start=1):
            assert {**record, "category": names[record["category_id"]]} == {**record, **label, "id": k}


@given(batches.filter(bool), st.data())
def test_cutting_the_journal_at_any_byte_loses_only_later_lines(batch: list, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        append_all(folder, batch, 0)
        (folder / "annotations.json").unlink()
        journal = folder / "journal.jsonl"
        content = journal.read_bytes().removesuffix(b'{"merged":true}\n')
        cut = data.draw(st.integers(0, len(content)))
        journal.write_bytes(content[:cut])
        whole = content[:cut].count(b"\n")
        assert [i["file_name"] for i in read_coco(folder)["images"]] == [f"images/{i}.png" for i in range(whole)]
        append_all(folder, batch, 0)
        fresh = folder / "fresh"
        append_all(fresh, batch, 0)
        assert (folder / "annotations.json").read_bytes() == (fresh / "annotations.json").read_bytes()


@given(st.integers(0, 2**32))
@settings(max_examples=1)
def test_fifty_kills_lose_and_double_nothing(seed: int) -> None:
    rng = random.Random(seed)
    total = 400
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "killed"
        acknowledged: set[int] = set()
        for _ in range(50):
            heard = killed(lambda tell: render_share(folder, total, tell=tell), rng.randrange(12), rng.uniform(0.0, 0.003))
            acknowledged |= {int(line) for line in heard.split()}
            if not folder.exists():
                continue
            found = [int(i["file_name"][7:-4]) for i in read_or_nothing(folder)["images"]]
            assert len(found) == len(set(found))
            assert acknowledged <= set(found)
        render_share(folder, total)
        render_share(Path(name) / "quiet", total)
        assert (folder / "annotations.json").read_bytes() == (Path(name) / "quiet" / "annotations.json").read_bytes()
        assert len(acknowledged) > 0


@given(st.lists(st.integers(0, 3), max_size=9), st.permutations(range(4)), st.integers(0, 3), st.randoms())
def test_shares_joined_in_any_order_are_the_whole(
    owner: list[int], order: list[int], at_once: int, shuffle: random.Random
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = [folder / str(k) for k in range(4)]
        for k, part in enumerate(parts):
            own_rows = [i for i, k_of_i in enumerate(owner) if k_of_i == k]
            shuffle.shuffle(own_rows)
            render_share(part, len(owner), own_rows)
        for group in (order[:at_once], order[at_once:]):
            join_datasets([parts[k] for k in group], folder / "joined")
        render_share(folder / "whole", len(owner))
        for file in ("annotations.json", *(f"images/{i}.png" for i in range(len(owner)))):
            assert (folder / "joined" / file).read_bytes() == (folder / "whole" / file).read_bytes()


def render_share(folder: Path, total: int, indices: Iterable[int] | None = None, *, tell: int | None = None) -> None:
    """Add the missing ones of these images of a plan (all) as rendering does; image i has i % 3 annotations.

    The number of each added image goes to the pipe `tell`.
    """
    with CocoDataset.open(folder, categories=["tank", "truck"]) as dataset:
        run = dataset.reserve_ids("p" * 64, images=total, annotations=total * 2)
        (folder / "images").mkdir(exist_ok=True)
        for i in range(total) if indices is None else indices:
            name = run.dataset_file_name(f"images/{i}.png")
            if dataset.finished(name):
                continue
            (folder / name).write_bytes(b"%d" % i)
            boxed = [{"category": "truck", "bbox": [0, 0, 4, k + 0.1], "id": 2 * i + k} for k in range(1, i % 3 + 1)]
            dataset.append({"id": i + 1, "file_name": name, "width": 8, "height": 6}, boxed)
            if tell is not None:
                os.write(tell, b"%d\n" % i)


def test_a_killed_join_loses_and_doubles_nothing() -> None:
    rng = random.Random(0)
    total = 150
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = [folder / str(k) for k in range(2)]
        for k, part in enumerate(parts):
            render_share(part, total, list(range(k, total, 2)))
        began = []
        for _ in range(6):
            killed(
                lambda tell: join_datasets(parts, folder / "joined", progress=lambda done, of: os.write(tell, b"\n")),
                rng.randrange(40),
                rng.uniform(0.0, 0.01),
            )
            if (folder / "joined").exists():
                began.append(len(read_or_nothing(folder / "joined")["images"]))
        assert began == sorted(began)
        join_datasets(parts, folder / "joined")
        render_share(folder / "whole", total)
        joined, whole = ((folder / which / "annotations.json").read_bytes() for which in ("joined", "whole"))
        assert joined == whole
        assert {path.name for path in (folder / "joined" / "images").iterdir()} == {f"{i}.png" for i in range(total)}
        assert any(0 < n < total for n in began)


def read_or_nothing(folder: Path) -> dict:
    if not (folder / "journal.jsonl").exists():
        return {"images": []}
    return read_coco(folder)


def killed(work: Callable[[int], object], lines: int, after_s: float) -> bytes:
    """What a process wrote to a pipe that does some work and is killed soon after this many lines."""
    hear, tell = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            # It merges continuously, so that kills interrupt merges too.
            hulldown.dataset.coco.MERGE_EVERY_S, hulldown.dataset.coco.MAX_MERGE_TIME_SHARE = 0.0, 0.5
            work(tell)
        finally:
            os._exit(0)
    os.close(tell)
    with os.fdopen(hear, "rb", buffering=0) as pipe:
        heard = b""
        while heard.count(b"\n") < lines and (byte := pipe.read(1)):
            heard += byte
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return heard + pipe.read()
