"""Runs of a plan into a dataset with a stand-in for Blender: kills, hostile plans, resuming, appending."""

import json
import multiprocessing
import os
import random
import signal
import sys
import warnings
from pathlib import Path

import numpy as np
import orjson
import pytest
from pycocotools.coco import COCO

from annotate.coco import CocoDataset
from annotate.document import read_coco
from annotate.failures import read_failures
from annotate.join import join
from annotate.masks import decode
from annotate.verify import verify
from assets.scenery import Scenery
from assets.vehicle import VehicleShape
from geometry.errors import ConfigError, DatasetError, HulldownError
from geometry.meshes import Mesh
from planning.plan_file import TARGET_KEYS
from render.jobs import RenderAssets, SceneryFile, VehicleFile
from render.masks import RowMasks, verify_masks
from render.pool import Limits
from render.supervisor import render_plan

FAKE = Path(__file__).with_name("fake_blender.py")
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (0.0, 2.0)])
CUBE_FACES = np.array(
    [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
)


NO_DENOISER = r"""
printf '@hulldown {"ready": "5.0"}\n'; read line
printf '@hulldown {"done": "start", "device": "CPU", "devices": 1}\n'; read line
printf '@hulldown {"unusable": "no denoiser", "remedy": "plan without"}\n'; read line
"""


@pytest.fixture(scope="module")
def blender(tmp_path_factory):
    script = tmp_path_factory.mktemp("blender") / "blender"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} -S -E {FAKE}\n")
    script.chmod(0o755)
    return str(script)


@pytest.fixture(scope="module")
def assets():
    shape = VehicleShape(
        name="cube",
        mesh=Mesh(CUBE, CUBE_FACES, "cube"),
        vertex_part=np.zeros(8, dtype=np.int64),
        part_names=("hull",),
        part_parent=np.array([-1]),
        part_pivot=np.zeros((1, 3)),
        part_axis=np.array([[0.0, 0.0, 1.0]]),
        part_limits=np.zeros((1, 2)),
        vehicle_from_file=np.eye(4),
    )
    scenery = Scenery(
        name="void",
        origin=np.zeros(3),
        ground=None,
        ground_names=(),
        face_ground=np.empty(0, dtype=np.int64),
        obstacle_meshes=(),
        instance_mesh=np.empty(0, dtype=np.int64),
        world_from_instance=np.empty((0, 4, 4)),
        instance_names=(),
        instance_gives_way=np.empty(0, dtype=bool),
        scenery_from_file=np.eye(4),
    )
    return RenderAssets(
        {"cube": VehicleFile(shape, Path("cube.blend"))},
        {"void": SceneryFile(Path("void.blend"), np.eye(4), scenery)},
        {"sky": Path("sky.exr")},
    )


def make_row(i, **changes):
    """A cube whose near face is 10 m before a camera that looks along +x."""
    target = {
        "vehicle": "cube",
        "category": "box",
        "world_from_vehicle": np.eye(4).tolist(),
        "articulation": {},
        "bbox": [6.0, 6.0, 4.0, 4.0],
        "bbox_amodal": [6.0, 6.0, 4.0, 4.0],
        "visible_fraction": 1.0,
        "truncated_fraction": 0.0,
        "slope_deg": 0.0,
        "gap": 0.0,
        "penetration": 0.0,
        "tries": 1,
    }
    camera = [[0.0, 0.0, 1.0, -11.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
    row = {
        **{"index": i, "image_id": i + 1, "file_name": f"images/{i + 1:08d}.png", "scenery": "void"},
        **{"position": i, "shot": 0, "world_from_camera": camera, "fov_x_deg": 53.13010235415598},
        **{"width": 16, "height": 16, "hdri": "sky", "hdri_yaw_deg": 0.0, "strength": 1.0, "weather": None},
        **{"sample_seed": i, "companions": [], "rejected": {}},
        **target,
    }
    return {**row, **changes}


def write_plan(folder, rows):
    folder.mkdir(parents=True, exist_ok=True)
    header = {
        **{"hulldown_plan": 1, "seed": 0, "root": ".", "images": len(rows), "versions": {}},
        "config": {"render": {"samples": 1, "denoise": False, "adaptive_threshold": 0.0, "bounces": 1}},
        "vehicles": {"cube": {"path": "cube.blend", "sha256": "", "category": "box"}},
        "sceneries": {"void": {"path": "void.blend", "sha256": "", "origin": [0, 0, 0]}},
        "hdris": {"sky": {"path": "sky.exr", "sha256": ""}},
    }
    path = folder / "plan.jsonl"
    path.write_bytes(b"".join(orjson.dumps(r, option=orjson.OPT_APPEND_NEWLINE) for r in [header, *rows]))
    return path


def contents(folder):
    """Everything that makes a dataset what it is."""
    pictures = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.png"))}
    coco = read_coco(folder)
    return coco["images"], coco["annotations"], coco["categories"], pictures


@pytest.mark.parametrize("workers", [1, 2])
def test_a_plan_becomes_a_dataset(tmp_path, blender, assets, workers):
    plan = write_plan(tmp_path, [make_row(i) for i in range(7)])
    seen = []
    report = render_plan(
        plan, tmp_path / "d", assets=assets, blender=blender, workers=workers, progress=lambda p: seen.append(p)
    )
    assert (report.images, report.already, report.rendered, report.failed) == (7, 0, 7, ())
    assert report.complete
    assert not report.interrupted
    assert (seen[-1].finished, seen[-1].images) == (7, 7)
    coco = COCO(tmp_path / "d" / "annotations.json")
    assert sorted(coco.imgs) == sorted(coco.anns) == list(range(1, 8))
    assert [image["file_name"] for image in coco.loadImgs(range(1, 8))] == [f"images/{i:08d}.png" for i in range(1, 8)]
    assert not (tmp_path / "d" / ".unfinished").exists()
    assert not (tmp_path / "d" / "failures.jsonl").exists()


def test_annotations_carry_box_mask_and_pose(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(0)])
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    coco = COCO(tmp_path / "d" / "annotations.json")
    annotation = coco.anns[1]
    # 16 px over 53.13 degrees: f = 16 px; the cube's near face is 2 m wide, 10 m away: from 6.4 to 9.6 px.
    mask = coco.annToMask(annotation)
    assert (np.argwhere(mask).min(axis=0).tolist(), np.argwhere(mask).max(axis=0).tolist()) == ([6, 6], [9, 9])
    assert annotation["area"] == mask.sum() == 16
    assert annotation["bbox"] == [6.0, 6.0, 4.0, 4.0]
    assert annotation["world_from_vehicle"] == np.eye(4).tolist()
    assert coco.imgs[1]["fov_x_deg"] == pytest.approx(53.13, abs=0.01)


@pytest.mark.parametrize("deleted", [3, 4])
def test_a_label_that_was_deleted_is_a_warning_and_others_keep_their_masks(
    tmp_path, blender, assets, monkeypatch, deleted
):
    pose = np.eye(4)
    pose[1, 3] = 2.5
    beside = make_row(0, world_from_vehicle=pose.tolist(), bbox=[2.0, 6.0, 4.0, 4.0])
    other = {key: beside[key] for key in TARGET_KEYS}
    plan = write_plan(tmp_path, [make_row(i, companions=[other]) for i in range(2)])
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    path = tmp_path / "d" / "annotations.json"
    coco = json.loads(path.read_text())

    def as_annotated(plan, rows, *_args, **_options):
        masks = np.array([decode(label["segmentation"], 16, 16) for label in coco["annotations"]])
        return [RowMasks(i, alone=masks[2 * i : 2 * i + 2], visible=masks[2 * i : 2 * i + 2]) for i in rows]

    monkeypatch.setattr("render.masks.cycles_masks", as_annotated)
    left = [label for label in coco["annotations"] if label["id"] != deleted]
    by_hand = {**coco["annotations"][0], "id": 99, "image_id": 2}
    path.write_text(json.dumps({**coco, "annotations": [*left, by_hand]}))
    report = verify_masks(tmp_path / "d", plan, count=2, assets=assets)
    expected = "warning: images/00000002.png: box 'cube' is planned and has no annotation"
    assert [str(finding) for finding in report.findings] == [expected]
    assert [row.mask_iou for row in report.rows] == [1.0, 1.0, 1.0]
    assert expected in [str(finding) for finding in verify(tmp_path / "d", plan=plan)]


def test_provenance_says_what_was_used(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(0)])
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    (entry,) = json.loads((tmp_path / "d" / "provenance.json").read_text())["plans"].values()
    assert entry["blender"] == ["fake"]
    assert entry["devices"] == ["CPU"]
    assert entry["plan"]["vehicles"]["cube"]["category"] == "box"


def test_provenance_is_there_with_the_first_image(tmp_path, blender, assets):
    """However the run ends: the next may be on another machine."""
    there = {}

    def look(progress):
        there[progress.finished] = (tmp_path / "d" / "provenance.json").exists()

    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender, progress=look)
    assert there == {0: False, 1: True, 2: True, 3: True}


@pytest.mark.parametrize("name", ["provenance.json", "failures.jsonl"])
def test_what_is_damaged_is_met_before_rendering(tmp_path, blender, assets, name):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / name).write_text("x\n")
    with pytest.raises(DatasetError, match=name):
        render_plan(write_plan(tmp_path, [make_row(0)]), tmp_path / "d", assets=assets, blender=blender)
    assert [path.name for path in (tmp_path / "d").iterdir()] == [name]


def test_a_second_run_does_nothing_twice(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(i) for i in range(6)])
    first = render_plan(plan, tmp_path / "d", assets=assets, blender=blender, limit=4)
    assert (first.images, first.rendered) == (4, 4)
    second = render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert (second.images, second.already, second.rendered) == (6, 4, 2)
    before = contents(tmp_path / "d")
    third = render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert (third.already, third.rendered) == (6, 0)
    assert contents(tmp_path / "d") == before
    render_plan(plan, tmp_path / "whole", assets=assets, blender=blender)
    assert contents(tmp_path / "whole") == before


@pytest.mark.parametrize(("limit", "n"), [(None, 3), (5, 2), (1, 4)])
def test_shares_are_the_whole_and_each_row_is_in_one(tmp_path, blender, assets, limit, n):
    # Sorted by HDRI, which comes in turns: shares are of the order of rendering, not of the plan.
    rows = [make_row(i, hdri=("sky", "dusk")[i % 2]) for i in range(8)]
    assets = RenderAssets(assets.vehicles, assets.sceneries, {**assets.hdris, "dusk": Path("dusk.exr")})
    plan = write_plan(tmp_path, rows)
    parts = [tmp_path / str(k) for k in range(1, n + 1)]
    reports = [
        render_plan(plan, part, assets=assets, blender=blender, limit=limit, share=(k, n))
        for k, part in enumerate(parts, start=1)
    ]
    assert all(report.complete for report in reports)
    sizes = [report.images for report in reports]
    assert sum(sizes) == (limit or 8)
    assert max(sizes) - min(sizes) <= 1
    assert join(parts, tmp_path / "joined").added == sum(sizes)
    render_plan(plan, tmp_path / "whole", assets=assets, blender=blender, limit=limit)
    assert contents(tmp_path / "joined") == contents(tmp_path / "whole")
    for name in ("annotations.json", "provenance.json"):
        assert (tmp_path / "joined" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    if limit is None:
        assert {image["hdri"] for image in read_coco(parts[0])["images"]} == {"dusk"}


@pytest.mark.parametrize("share", [(0, 2), (3, 2), (1, 0)])
def test_a_share_that_is_none_is_refused(tmp_path, blender, assets, share):
    with pytest.raises(ValueError, match=r"share: expected \(k, n\)"):
        render_plan(write_plan(tmp_path, [make_row(0)]), tmp_path / "d", assets=assets, blender=blender, share=share)
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (None, "is no program that can be started; name Blender's executable"),
        ("exit 1", "Blender has not started 3 times"),
        ("echo no graphics card of that kind >&2; exit 3", "no graphics card"),
        ("""printf '@hulldown {"ready": "5.0"}\\n@hulldown {"failed": "no gpu"}\\n'; read line""", "no gpu"),
        (NO_DENOISER, "Blender cannot be used: no denoiser; plan without"),
    ],
)
@pytest.mark.parametrize("there", ["nothing", "a dataset", "an unclosed dataset"])
def test_a_blender_that_does_not_start_leaves_the_dataset_as_it_was(tmp_path, blender, assets, script, message, there):
    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    other = write_plan(tmp_path / "other", [make_row(i, strength=2.0) for i in range(2)])
    dataset = tmp_path / "new" / "d"
    if there != "nothing":
        render_plan(other, dataset, assets=assets, blender=blender, limit=1)
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
            render_plan(plan, dataset, assets=assets, blender=str(wrong))
    assert files() == before
    assert (tmp_path / "new").exists() == (there != "nothing")
    assert told.value.path is None or Path(told.value.path) == wrong or Path(told.value.path).exists()


def test_a_run_in_which_every_attempt_fails_leaves_its_logs_alone(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(i, width=70_000_000_000) for i in range(4)])
    with pytest.raises(HulldownError, match=r"logs: 4 attempts have failed one after the other"):
        render_plan(plan, tmp_path / "d", assets=assets, blender=blender, limits=Limits(give_up_after=4))
    assert {path.name for path in (tmp_path / "d").rglob("*")} == {"logs", "worker-0.log"}
    mended = write_plan(tmp_path, [make_row(0)])
    render_plan(mended, tmp_path / "d", assets=assets, blender=blender)
    (image,) = read_coco(tmp_path / "d")["images"]
    assert (image["id"], image["file_name"]) == (1, "images/00000001.png")


def test_a_run_that_is_stopped_before_its_first_image_leaves_no_trace(tmp_path, blender, assets):
    def stop(progress):
        os.kill(os.getpid(), signal.SIGINT)

    plan = write_plan(tmp_path, [make_row(0)])
    assert render_plan(plan, tmp_path / "d", assets=assets, blender=blender, progress=stop).interrupted
    assert not (tmp_path / "d").exists()


def test_a_picture_that_cannot_be_recorded_keeps_its_name(tmp_path, blender, assets, monkeypatch):
    def full(*_):
        raise DatasetError("the disk is full")

    plan = write_plan(tmp_path, [make_row(i) for i in range(2)])
    with monkeypatch.context() as patch:
        patch.setattr(CocoDataset, "append", full)
        with pytest.raises(DatasetError, match="the disk is full"):
            render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    render_plan(plan, tmp_path / "whole", assets=assets, blender=blender)
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("images", {"id": 4, "file_name": "real/x.jpg", "width": 8, "height": 6}, "image 4 .'real/x.jpg'. has the id"),
        ("annotations", {"id": 4, "image_id": 1, "category_id": 1, "bbox": [1, 1, 2, 2]}, "annotation 4 has the id"),
    ],
)
def test_an_id_of_the_plan_that_something_else_has_is_named(tmp_path, blender, assets, kind, changes, message):
    plan = write_plan(tmp_path, [make_row(i) for i in range(5)])
    render_plan(plan, tmp_path / "d", assets=assets, blender=blender, limit=2)
    path = tmp_path / "d" / "annotations.json"
    coco = json.loads(path.read_text())
    coco[kind].append(changes)
    path.write_text(json.dumps(coco))
    before = path.read_bytes()
    with pytest.raises(DatasetError, match=rf"{message} that is set aside for images/00000004\.png; .* from 6 on"):
        render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert path.read_bytes() == before
    path.write_text(path.read_text().replace('"id": 4', '"id": 6'))
    assert render_plan(plan, tmp_path / "d", assets=assets, blender=blender).rendered == 3


def test_a_second_plan_is_appended_under_new_names_and_ids(tmp_path, blender, assets):
    one = write_plan(tmp_path / "one", [make_row(i) for i in range(3)])
    two = write_plan(tmp_path / "two", [make_row(i, strength=2.0) for i in range(3)])
    render_plan(one, tmp_path / "d", assets=assets, blender=blender, limit=2)
    render_plan(two, tmp_path / "d", assets=assets, blender=blender)
    render_plan(one, tmp_path / "d", assets=assets, blender=blender)
    images, annotations, categories, pictures = contents(tmp_path / "d")
    assert [image["id"] for image in images] == [1, 2, 3, 4, 5, 6]
    assert [annotation["image_id"] for annotation in annotations] == [1, 2, 3, 4, 5, 6]
    assert len({image["file_name"] for image in images}) == len(pictures) == 6
    assert len(categories) == 1


def test_failures_are_recorded_and_tried_again_by_the_next_run(tmp_path, blender, assets):
    rows = [make_row(i, **({"width": 70_000_000_000} if i == 2 else {})) for i in range(4)]
    plan = write_plan(tmp_path, rows)
    report = render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert report.failed == ("images/00000003.png",)
    assert report.rendered == 3
    assert not report.complete
    (line,) = (tmp_path / "d" / "failures.jsonl").read_text().splitlines()
    failure = json.loads(line)
    assert failure["index"] == 2
    assert len(failure["reasons"]) == 3
    assert [image["id"] for image in read_coco(tmp_path / "d")["images"]] == [1, 2, 4]
    again = render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert (again.already, again.failed) == (3, ("images/00000003.png",))


def test_failures_of_images_that_are_not_rendered_now_are_kept(tmp_path, blender, assets):
    rows = [make_row(i, **({"width": 70_000_000_000} if i == 2 else {})) for i in range(4)]
    plan, dataset = write_plan(tmp_path, rows), tmp_path / "d"
    render_plan(plan, dataset, assets=assets, blender=blender, limit=1)
    other = [f"images/{name}.png" for name in ("00000004", "2-1f0c9a77-00000001")]
    lines = [{"file_name": name, "reasons": []} for name in (*other, "images/00000002.png")]
    (dataset / "failures.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    render_plan(plan, dataset, assets=assets, blender=blender, limit=2)
    assert [line["file_name"] for line in read_failures(dataset)] == other
    render_plan(plan, dataset, assets=assets, blender=blender, limit=3)
    assert [line["file_name"] for line in read_failures(dataset)] == [*other, "images/00000003.png"]


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("../out.png", ConfigError),
        ("images/../../out.png", ConfigError),
        ("/tmp/hulldown-hostile.png", ConfigError),
        ("C:\\out.png", ConfigError),
        ("..\\out.png", ConfigError),
        ("link/out.png", DatasetError),
        ("link/new/out.png", DatasetError),
        ("annotations.json", ConfigError),
        ("images/", ConfigError),
    ],
)
def test_a_hostile_file_name_writes_nothing_outside(tmp_path, blender, assets, name, error):
    plan = write_plan(tmp_path / "plan", [make_row(0, file_name=name)])
    outside = tmp_path / "outside"
    outside.mkdir()
    dataset = tmp_path / "d"
    dataset.mkdir()
    (dataset / "link").symlink_to(outside)
    before = {p for p in tmp_path.rglob("*") if dataset not in p.parents}
    with pytest.raises(error):
        render_plan(plan, dataset, assets=assets, blender=blender)
    assert {p for p in tmp_path.rglob("*") if dataset not in p.parents} == before
    assert not Path("/tmp/hulldown-hostile.png").exists()


@pytest.mark.parametrize("name", ["logs", ".unfinished", "images"])
def test_a_folder_of_ours_that_is_a_link_is_refused(tmp_path, blender, assets, name):
    outside = tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / name).symlink_to(outside)
    with pytest.raises(DatasetError, match="leads out of the dataset"):
        render_plan(write_plan(tmp_path, [make_row(0)]), tmp_path / "d", assets=assets, blender=blender)
    assert list(outside.iterdir()) == []


def test_two_images_of_one_name_are_refused_before_rendering(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(0), make_row(1, file_name="images/00000001.png")])
    with pytest.raises(ConfigError, match=r"2 images are called 'images/00000001.png'"):
        render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
    assert not (tmp_path / "d").exists()


def test_a_damaged_plan_leaves_the_dataset_as_it_was(tmp_path, blender, assets):
    """Down to the categories: the dataset may be somebody's real photographs."""
    plan = write_plan(tmp_path, [make_row(i) for i in range(3)])
    plan.write_bytes(plan.read_bytes()[:-40])
    dataset = tmp_path / "d"
    dataset.mkdir()
    (dataset / "annotations.json").write_text('{"images": [], "annotations": [], "categories": []}')
    with pytest.raises(ConfigError, match="line 4 is no JSON"):
        render_plan(plan, dataset, assets=assets, blender=blender)
    assert [path.name for path in dataset.iterdir()] == ["annotations.json"]
    assert (dataset / "annotations.json").read_text() == '{"images": [], "annotations": [], "categories": []}'


@pytest.mark.parametrize("change", [{"vehicle": "tank"}, {"hdri": "night"}, {"world_from_camera": None, "weather": 3}])
def test_a_row_that_cannot_be_rendered_names_its_line_or_image(tmp_path, blender, assets, change):
    plan = write_plan(tmp_path, [make_row(0, **change)])
    with pytest.raises(ConfigError, match=r"line 2|image 0"):
        render_plan(plan, tmp_path / "d", assets=assets, blender=blender)


def run_apart(plan, dataset, assets, blender, workers):
    os.setsid()
    render_plan(plan, dataset, assets=assets, blender=blender, workers=workers)
    os._exit(0)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_runs_lose_and_double_nothing(tmp_path, blender, assets, number):
    plan = write_plan(tmp_path, [make_row(i) for i in range(40)])
    context = multiprocessing.get_context("fork")
    rng = random.Random(int(number))
    for attempt in range(7):
        process = context.Process(target=run_apart, args=(plan, tmp_path / "d", assets, blender, 2))
        process.start()
        process.join(rng.uniform(0.1, 0.4) if attempt < 6 else None)
        if process.exitcode is None:
            os.kill(process.pid, number)
            process.join()
    assert process.exitcode == 0
    render_plan(plan, tmp_path / "whole", assets=assets, blender=blender)
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")
    assert not (tmp_path / "d" / ".unfinished").exists()


def test_stopping_says_so_and_ends_the_workers(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(i) for i in range(500)])

    def stop_after_five(progress):
        if progress.finished == 5:
            os.kill(os.getpid(), signal.SIGINT)

    report = render_plan(plan, tmp_path / "d", assets=assets, blender=blender, progress=stop_after_five)
    assert report.interrupted
    assert not report.complete
    assert 5 <= report.rendered < 500
    assert len(read_coco(tmp_path / "d")["images"]) == report.rendered
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_dataset_in_use_is_refused(tmp_path, blender, assets):
    plan = write_plan(tmp_path, [make_row(0)])
    with CocoDataset.open(tmp_path / "d"), pytest.raises(DatasetError, match="another process"):
        render_plan(plan, tmp_path / "d", assets=assets, blender=blender)
