"""Refusals by `render_plan`, which leave the dataset unchanged; with a stand-in for Blender."""

import os
import signal
import warnings
from pathlib import Path

import pytest

from hulldown.base.errors import ConfigError, DatasetError, HulldownError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.store.document import read_coco
from hulldown.render.pool import Engine
from hulldown.render.session import MAX_FAILURES_IN_A_ROW
from hulldown.render.supervisor import Part
from hulldown.tests.builders.editing import edit
from hulldown.tests.builders.render_plans import make_row, write_plan

NO_GPU = r"""printf '@hulldown {"ready": "5.0"}\n@hulldown {"failed": "no gpu"}\n'; cat"""
NO_DENOISER = r"""
printf '@hulldown {"ready": "5.0"}\n@hulldown {"device": "CPU", "devices": 1}\n'
printf '@hulldown {"unusable": "no denoiser", "remedy": "plan without"}\n'; cat
"""


@pytest.mark.parametrize("name", ["provenance.json", "failures.jsonl"])
def test_a_damaged_file_is_found_before_rendering(tmp_path, render, name):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / name).write_text("x\n")
    (tmp_path / "d" / "annotations.json").write_text("{}")
    with pytest.raises(DatasetError, match=name):
        render(write_plan(tmp_path, [make_row(0)]), tmp_path / "d")
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == sorted([name, "annotations.json"])


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (None, "isn't an executable program; name Blender's executable"),
        ("echo no library >&2; exit 3", r"has not started 3 times.* no library; see .*wrong --background` starts"),
        (NO_GPU, "no gpu"),
        (NO_DENOISER, "Blender cannot be used: no denoiser; plan without$"),
    ],
)
@pytest.mark.parametrize("there", ["nothing", "a dataset", "an unclosed dataset"])
def test_a_blender_that_does_not_start_leaves_the_dataset_unchanged(tmp_path, blender, render, script, message, there):
    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    other = write_plan(tmp_path / "other", [make_row(i, strength=2.0) for i in range(2)])
    dataset = tmp_path / "new" / "d"
    if there != "nothing":
        render(other, dataset, part=Part(limit=1))
        (dataset / "failures.jsonl").write_text('{"file_name": "images/00000002.png"}\n')
    if there == "an unclosed dataset":
        (dataset / "annotations.json").unlink()
    wrong = tmp_path / "wrong"
    if script is not None:
        wrong.write_text(f"#!/bin/sh\n{script}\n")
        wrong.chmod(0o755)

    def files():
        return {p: p.is_file() and p.read_bytes() for p in (tmp_path / "new").rglob("*") if p.parent.name != "logs"}

    before = files()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(HulldownError, match=message) as told:
            render(plan, dataset, engine=Engine(blender=str(wrong)))
    assert files() == before
    assert (tmp_path / "new").exists() == (there != "nothing")
    assert told.value.path is None or Path(told.value.path) == wrong or Path(told.value.path).exists()


def test_a_run_in_which_every_attempt_fails_leaves_only_logs(tmp_path, render):
    plan = write_plan(tmp_path, [make_row(i, width=65536) for i in range(MAX_FAILURES_IN_A_ROW)])
    with pytest.raises(HulldownError, match=f"logs: {MAX_FAILURES_IN_A_ROW} attempts have failed one after the other"):
        render(plan, tmp_path / "d")
    assert {path.name for path in (tmp_path / "d").rglob("*")} == {"logs", "worker-0.log"}
    render(write_plan(tmp_path, [make_row(0)]), tmp_path / "d")
    (image,) = read_coco(tmp_path / "d")["images"]
    assert (image["id"], image["file_name"]) == (1, "images/00000001.png")


def test_a_run_that_is_stopped_before_its_first_image_leaves_no_trace(tmp_path, render):
    def stop(progress):
        os.kill(os.getpid(), signal.SIGINT)

    plan = write_plan(tmp_path, [make_row(0)])
    assert render(plan, tmp_path / "d", progress=stop).interrupted
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("images", {"id": 4, "file_name": "real/x.jpg", "width": 8, "height": 6}, "image 4 .'real/x.jpg'. has the id"),
        ("annotations", {"id": 4, "image_id": 1, "category_id": 1, "bbox": [1, 1, 2, 2]}, "annotation 4 has the id"),
    ],
)
def test_an_id_of_the_plan_that_another_record_has_is_named(tmp_path, render, kind, changes, message):
    plan = write_plan(tmp_path, [make_row(i) for i in range(5)])
    render(plan, tmp_path / "d", part=Part(limit=2))
    edit(tmp_path / "d", lambda coco: coco[kind].append(changes))
    path = tmp_path / "d" / "annotations.json"
    before = path.read_bytes()
    with pytest.raises(DatasetError, match=rf"{message} that is set aside for images/00000004\.png; .* from 6 on"):
        render(plan, tmp_path / "d")
    assert path.read_bytes() == before
    path.write_text(path.read_text().replace('"id": 4', '"id": 6'))
    assert render(plan, tmp_path / "d").rendered == 3


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("../out.png", ConfigError),
        ("/tmp/hulldown-hostile.png", ConfigError),
        ("images/link/out.png", DatasetError),
        ("images/link/new/out.png", DatasetError),
        ("annotations.json", ConfigError),
        ("images/", ConfigError),
    ],
)
def test_a_hostile_file_name_writes_nothing_outside(tmp_path, render, name, error):
    plan = write_plan(tmp_path / "plan", [make_row(0, file_name=name)])
    outside = tmp_path / "outside"
    outside.mkdir()
    dataset = tmp_path / "d"
    (dataset / "images").mkdir(parents=True)
    (dataset / "images" / "link").symlink_to(outside)
    (dataset / "annotations.json").write_text("{}")
    before = {p for p in tmp_path.rglob("*") if dataset not in p.parents}
    with pytest.raises(error):
        render(plan, dataset)
    assert {p for p in tmp_path.rglob("*") if dataset not in p.parents} == before
    assert not Path("/tmp/hulldown-hostile.png").exists()


@pytest.mark.parametrize("name", ["logs", ".unfinished", "images"])
def test_a_link_in_place_of_our_folder_is_refused(tmp_path, render, name):
    outside = tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / name).symlink_to(outside)
    (tmp_path / "d" / "annotations.json").write_text("{}")
    with pytest.raises(DatasetError, match="leads out of the dataset"):
        render(write_plan(tmp_path, [make_row(0)]), tmp_path / "d")
    assert list(outside.iterdir()) == []


@pytest.mark.parametrize("link", [True, False])
def test_a_file_or_link_called_unfinished_is_replaced_and_its_target_kept(tmp_path, render, link):
    plan, dataset = write_plan(tmp_path, [make_row(i) for i in range(3)]), tmp_path / "d"
    render(plan, dataset, part=Part(limit=2))
    if link:
        (dataset / ".unfinished").symlink_to("images")
    else:
        (dataset / ".unfinished").touch()
    assert render(plan, dataset).complete
    assert len(list((dataset / "images").iterdir())) == 3


def test_a_log_that_is_a_link_is_not_followed(tmp_path, blender, render, monkeypatch):
    monkeypatch.setenv("HULLDOWN_READ", os.path.dirname(blender))  # the folder of what the script starts
    outside, dataset = tmp_path / "outside", tmp_path / "d"
    outside.write_text("precious")
    (dataset / "logs").mkdir(parents=True)
    (dataset / "logs" / "worker-0.log").symlink_to(outside)
    loud = tmp_path / "loud"
    loud.write_text(f"#!/bin/sh\necho hello >&2\nexec {blender}\n")
    loud.chmod(0o755)
    render(write_plan(tmp_path, [make_row(0)]), dataset, engine=Engine(blender=str(loud)))
    assert outside.read_text() == "precious"
    assert "hello" in (dataset / "logs" / "worker-0.log").read_text()


def test_a_damaged_plan_leaves_the_dataset_unchanged(tmp_path, render):
    """Not even categories are added, since the dataset may be real photographs."""
    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    plan.write_bytes(plan.read_bytes()[:-40])
    dataset = tmp_path / "d"
    dataset.mkdir()
    (dataset / "annotations.json").write_text('{"images": [], "annotations": [], "categories": []}')
    with pytest.raises(ConfigError, match="line 4 is no JSON"):
        render(plan, dataset)
    assert [path.name for path in dataset.iterdir()] == ["annotations.json"]
    assert (dataset / "annotations.json").read_text() == '{"images": [], "annotations": [], "categories": []}'


@pytest.mark.parametrize("change", [{"vehicle": "tank"}, {"hdri": "night"}, {"world_from_camera": None, "weather": 3}])
def test_a_row_that_cannot_be_rendered_names_its_line_or_image(tmp_path, render, change):
    plan = write_plan(tmp_path, [make_row(0, **change)])
    with pytest.raises(ConfigError, match=r"line 2|image 0"):
        render(plan, tmp_path / "d")


@pytest.mark.parametrize("change", ["another plan", "nothing"])
def test_replacing_the_plan_during_a_run_ends_it(tmp_path, render, change):
    plan = write_plan(tmp_path, [make_row(i) for i in range(40)])
    other = write_plan(tmp_path / "other", [make_row(i, strength=2.0) for i in range(40)])

    def replace(progress):
        if progress.finished == 5 and change == "nothing":
            plan.unlink(missing_ok=True)
        elif progress.finished == 5 and other.exists():
            other.replace(plan)

    with pytest.raises(ConfigError, match=r"plan\.jsonl: is not what it was when this run began; run again"):
        render(plan, tmp_path / "d", progress=replace)
    assert {image["strength"] for image in read_coco(tmp_path / "d")["images"]} == {1.0}


def test_a_dataset_in_use_is_refused(tmp_path, render):
    plan = write_plan(tmp_path, [make_row(0)])
    with CocoDataset.open(tmp_path / "d"), pytest.raises(HulldownError, match="another process"):
        render(plan, tmp_path / "d")
