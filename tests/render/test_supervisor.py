"""Rendering a plan into a dataset: kills, failures, resuming, appending; with a stand-in for Blender."""

import contextlib
import json
import multiprocessing
import os
import platform
import random
import signal
import threading
import time
import warnings

import numpy as np
import pytest
from PIL import Image
from pycocotools.coco import COCO

from hulldown.base.errors import DatasetError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.join import join_datasets
from hulldown.dataset.provenance import read_failures
from hulldown.dataset.store.document import read_coco
from hulldown.reading.confinement.landlock import describe_confinement
from hulldown.render.pool import Engine
from hulldown.render.supervisor import Part
from hulldown.tests.builders.render_plans import contents, cube_library, make_row, write_plan


@pytest.mark.parametrize("workers", [1, 2])
def test_a_plan_becomes_a_dataset(tmp_path, blender, render, workers):
    plan = write_plan(tmp_path, [make_row(i) for i in range(7)])
    seen = []
    engine = Engine(blender=blender, workers=workers)
    report = render(plan, tmp_path / "d", progress=seen.append, engine=engine)
    assert (report.images, report.already, report.rendered, report.failed) == (7, 0, 7, ())
    assert report.complete
    assert not report.interrupted
    assert (seen[-1].finished, seen[-1].images, seen[-1].workers) == (7, 7, workers)
    coco = COCO(tmp_path / "d" / "annotations.json")
    assert sorted(coco.imgs) == sorted(coco.anns) == list(range(1, 8))
    assert [image["file_name"] for image in coco.loadImgs(range(1, 8))] == [f"images/{i:08d}.png" for i in range(1, 8)]
    assert not (tmp_path / "d" / ".unfinished").exists()
    assert not (tmp_path / "d" / "failures.jsonl").exists()


def test_annotations_carry_box_mask_and_pose(tmp_path, render):
    plan = write_plan(tmp_path, [make_row(0)])
    render(plan, tmp_path / "d")
    coco = COCO(tmp_path / "d" / "annotations.json")
    annotation = coco.anns[1]
    # 16 px for 53.13 degrees: f = 16 px. The near face of the cube is 2 m wide and 10 m away: from 6.4 to 9.6 px.
    mask = coco.annToMask(annotation)
    assert (np.argwhere(mask).min(axis=0).tolist(), np.argwhere(mask).max(axis=0).tolist()) == ([6, 6], [9, 9])
    assert annotation["area"] == mask.sum() == 16
    assert annotation["bbox"] == [6.0, 6.0, 4.0, 4.0]
    assert annotation["world_from_vehicle"] == np.eye(4).tolist()
    assert coco.imgs[1]["fov_x_deg"] == pytest.approx(53.13, abs=0.01)


def test_pillows_size_limit_does_not_apply_to_blenders_pictures(tmp_path, render, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)  # Pillow refuses pictures of twice as many; a row has 256
    plan = write_plan(tmp_path, [make_row(0)])
    assert render(plan, tmp_path / "d").complete


def test_a_killed_runs_blender_that_still_writes_does_not_stop_the_next_run(tmp_path, render):
    folder = tmp_path / "d" / ".unfinished"
    folder.mkdir(parents=True)

    def write_on():
        for number in range(1500):
            with contextlib.suppress(OSError):
                (folder / f"late {number}.png").write_bytes(b"")
            time.sleep(0.001)

    late = threading.Thread(target=write_on)
    late.start()
    assert render(write_plan(tmp_path, [make_row(0)]), tmp_path / "d").complete
    late.join()


def test_provenance_lists_versions_and_devices_from_the_first_image_on(tmp_path, render):
    """The next run may be on another machine."""
    there = {}

    def look(progress):
        there[progress.finished] = (tmp_path / "d" / "provenance.json").exists()

    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    render(plan, tmp_path / "d", progress=look)
    assert there == {0: False, 1: True, 2: True, 3: True}
    (entry,) = json.loads((tmp_path / "d" / "provenance.json").read_text())["plans"].values()
    assert entry["blender"] == [f"fake, Python {platform.python_version()}, NumPy {np.__version__}"]
    assert entry["devices"] == ["CPU"]
    assert entry["confinement"] == [describe_confinement()]
    assert entry["plan"]["vehicles"]["cube"]["category"] == "box"


def test_a_second_run_does_nothing_twice(tmp_path, render):
    plan = write_plan(tmp_path, [make_row(i) for i in range(6)])
    first = render(plan, tmp_path / "d", part=Part(limit=4))
    assert (first.images, first.rendered) == (4, 4)
    second = render(plan, tmp_path / "d")
    assert (second.images, second.already, second.rendered) == (6, 4, 2)
    before = contents(tmp_path / "d")
    third = render(plan, tmp_path / "d")
    assert (third.already, third.rendered) == (6, 0)
    assert contents(tmp_path / "d") == before
    render(plan, tmp_path / "whole")
    assert contents(tmp_path / "whole") == before


@pytest.mark.parametrize(("limit", "n"), [(None, 3), (5, 2), (1, 4)])
def test_shares_join_to_the_whole(tmp_path, render, limit, n):
    rows = [make_row(i, hdri=("sky", "dusk")[i % 2]) for i in range(8)]
    library = cube_library(hdris=("sky", "dusk"))
    plan = write_plan(tmp_path, rows)
    parts = [tmp_path / str(k) for k in range(1, n + 1)]
    reports = [
        render(plan, part, library=library, part=Part(limit=limit, share=(k, n))) for k, part in enumerate(parts, start=1)
    ]
    assert all(report.complete for report in reports)
    sizes = [report.images for report in reports]
    assert sum(sizes) == (limit or 8)
    assert max(sizes) - min(sizes) <= 1
    assert join_datasets(parts, tmp_path / "joined").added == sum(sizes)
    render(plan, tmp_path / "whole", library=library, part=Part(limit=limit))
    assert contents(tmp_path / "joined") == contents(tmp_path / "whole")
    for name in ("annotations.json", "provenance.json"):
        assert (tmp_path / "joined" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_picture_that_cannot_be_recorded_keeps_its_name(tmp_path, render, monkeypatch):
    def full(*_):
        raise DatasetError("the disk is full")

    plan = write_plan(tmp_path, [make_row(i) for i in range(2)])
    with monkeypatch.context() as patch:
        patch.setattr(CocoDataset, "append", full)
        with pytest.raises(DatasetError, match="the disk is full"):
            render(plan, tmp_path / "d")
    render(plan, tmp_path / "d")
    render(plan, tmp_path / "whole")
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")


def test_a_second_plan_is_appended_under_new_names_and_ids(tmp_path, render):
    one = write_plan(tmp_path / "one", [make_row(i) for i in range(3)])
    two = write_plan(tmp_path / "two", [make_row(i, strength=2.0) for i in range(3)])
    render(one, tmp_path / "d", part=Part(limit=2))
    render(two, tmp_path / "d")
    render(one, tmp_path / "d")
    images, annotations, categories, pictures = contents(tmp_path / "d")
    assert [image["id"] for image in images] == [1, 2, 3, 4, 5, 6]
    assert [annotation["image_id"] for annotation in annotations] == [1, 2, 3, 4, 5, 6]
    assert len({image["file_name"] for image in images}) == len(pictures) == 6
    assert len(categories) == 1


def test_failures_are_recorded_and_tried_again_by_the_next_run(tmp_path, render):
    rows = [make_row(i, **({"width": 65536} if i == 2 else {})) for i in range(4)]
    plan = write_plan(tmp_path, rows)
    report = render(plan, tmp_path / "d")
    assert report.failed == ("images/00000003.png",)
    assert report.rendered == 3
    assert not report.complete
    (line,) = (tmp_path / "d" / "failures.jsonl").read_text().splitlines()
    failure = json.loads(line)
    assert failure["index"] == 2
    assert len(failure["reasons"]) == 3
    assert [image["id"] for image in read_coco(tmp_path / "d")["images"]] == [1, 2, 4]
    again = render(plan, tmp_path / "d")
    assert (again.already, again.failed) == (3, ("images/00000003.png",))


def test_failures_of_images_that_are_not_rendered_now_are_kept(tmp_path, render):
    rows = [make_row(i, **({"width": 65536} if i == 2 else {})) for i in range(4)]
    plan, dataset = write_plan(tmp_path, rows), tmp_path / "d"
    render(plan, dataset, part=Part(limit=1))
    other = [f"images/{name}.png" for name in ("00000004", "2-1f0c9a77-00000001")]
    lines = [{"file_name": name, "reasons": []} for name in (*other, "images/00000002.png")]
    (dataset / "failures.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    render(plan, dataset, part=Part(limit=2))
    assert [failure.file_name for failure in read_failures(dataset)] == other
    render(plan, dataset, part=Part(limit=3))
    assert [failure.file_name for failure in read_failures(dataset)] == [*other, "images/00000003.png"]


def run_apart(render, plan, dataset, engine):
    os.setsid()
    warnings.simplefilter("ignore")  # a journal's line that the last kill cut off
    render(plan, dataset, engine=engine)
    os._exit(0)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_runs_lose_and_double_nothing(tmp_path, blender, render, number):
    plan = write_plan(tmp_path, [make_row(i) for i in range(40)])
    context, engine = multiprocessing.get_context("fork"), Engine(blender=blender, workers=2)
    rng = random.Random(int(number))
    for attempt in range(7):
        process = context.Process(target=run_apart, args=(render, plan, tmp_path / "d", engine))
        process.start()
        process.join(rng.uniform(0.1, 0.4) if attempt < 6 else None)
        if process.exitcode is None:
            os.kill(process.pid, number)
            process.join()
    assert process.exitcode == 0
    render(plan, tmp_path / "whole")
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")
    assert not (tmp_path / "d" / ".unfinished").exists()


def test_a_stopped_run_is_reported_as_interrupted(tmp_path, render):
    plan = write_plan(tmp_path, [make_row(i) for i in range(500)])

    def stop_after_five(progress):
        if progress.finished == 5:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)  # ignored if the tests run in the background
    report = render(plan, tmp_path / "d", progress=stop_after_five)
    assert report.interrupted
    assert not report.complete
    assert 5 <= report.rendered < 500
    assert len(read_coco(tmp_path / "d")["images"]) == report.rendered
    assert signal.getsignal(signal.SIGINT) is before
