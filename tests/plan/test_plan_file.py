"""A plan on disk: streaming, indexing, damaged lines, continued attempts."""

import json
import math
import os
import re
from pathlib import Path

import pytest

from hulldown.base.errors import ConfigError, HulldownError
from hulldown.base.files import is_safe_relative_path
from hulldown.base.outputs import OutputError
from hulldown.plan.lines import PlanWriter
from hulldown.plan.picture_names import PICTURE_NAME
from hulldown.plan.plan_file import read_plan
from hulldown.plan.row import PlannedVehicle, Row, decode_header, encode_line, row_fields
from hulldown.tests.builders.plan_lines import HEADER, POSE, VEHICLE, line, row, write_lines
from hulldown.tests.builders.planning_assets import small_config


def header(**changes):
    return decode_header(line({**HEADER, **changes}))


def written(path, rows=5, **changes):
    with PlanWriter(path, header(**changes)) as writer:
        for i in range(rows):
            writer.write(line(row(i)), 1)
        writer.finish()
    return path


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "plan.jsonl")


def test_rows_round_trip(path):
    plan = read_plan(path)
    assert plan.header == header()
    assert len(plan) == 5
    assert [json.loads(encode_line(found)) for found in plan] == [row(i) for i in range(5)]
    assert [json.loads(encode_line(plan[i])) for i in (4, 0, 2)] == [row(4), row(0), row(2)]
    assert plan[3].world_from_camera.shape == (4, 4)
    assert plan[3].intrinsics.fov_x == math.radians(50.0)
    with pytest.raises(IndexError, match="index: expected -5 to 4, got 5"):
        plan[5]


def test_the_row_of_these_tests_has_every_key():
    assert set(row(0)) == {name for name, field in row_fields(Row).items() if not field.optional}
    assert set(VEHICLE) == {name for name, field in row_fields(PlannedVehicle).items() if not field.optional}


def turned(**changes):
    """A pose that isn't rigid."""
    pose = [list(line) for line in POSE]
    for place, value in changes.items():
        pose[int(place[1])][int(place[2])] = value
    return pose


OUT_OF_RANGE = [
    *(("fov_x_deg", value) for value in (-1.0, 0, 180, 1e308)),
    *((key, pose) for key in ("world_from_camera", "world_from_vehicle") for pose in (
        [[0.0] * 4] * 4, [[1e308] * 4] * 4, turned(_00=-1.0), turned(_00=1.01), turned(_01=0.1), turned(_32=0.5),
        turned(_33=2.0), turned(_03=1e300), turned(_03=10**400), turned(_03=True), turned(_03="1"), [*POSE, POSE[3]],
    )),
    *((key, share) for key in ("visible_fraction", "truncated_fraction") for share in (-5.0, 7.0, 1.0000001)),
    *((key, box) for key in ("bbox", "bbox_amodal") for box in (
        [-1e300, 0, 1, 1], [0, 0, -1, 1], [0, 0, 1, 1e300], [], [1, 2, 3], [1, 2, 3, 4, 5], [1, 2, 3, None],
    )),
    ("strength", -5.0), ("strength", True), ("background", 1), ("planned", {"a": 1}), ("planned", [3]),
    ("weather", {"visibility_m": 0, "kind": "fog"}),
    ("weather", {"visibility_m": 9.0, "kind": "hail"}), ("weather", {}),
    ("hdri_yaw_deg", 361), ("slope_deg", -1.0), ("slope_deg", 91.0), ("gap", -0.1), ("penetration", -0.1),
    ("position", -1), ("shot", 2**63), ("tries", -1), ("tries", 1.5), ("width", 65537), ("height", 10**400),
    ("paint", [{}]), ("paint", [{"materials": ["*"], "color": "red"}]), ("paint", [{"materials": "*"}]),
    ("sample_seed", 2**64), ("rejected", {"small": -1}), ("rejected", {"bored": 1}),
    ("rejected", []), ("articulation", {"gun": 1e300}),
    ("articulation", {"turret": "left"}),
]  # fmt: skip


NO_LABEL = {key: VEHICLE[key] for key in VEHICLE if key != "label"}
CHANGED = [
    ({"image_id": 1}, "line 4 has image_id 1, expected 3"),
    ({"world_from_camera": [[None] * 4] * 4}, "line 4 has world_from_camera .*, expected a 4x4 matrix"),
    ({"bbox": "big"}, r"line 4 has planned\[0\].bbox 'big', expected \[x, y, width, height\]"),
    ({"bbox": None}, r"line 4 has planned\[0\].bbox None"),
    ({"planned": []}, r"line 4 has planned vehicles \[\], expected the target, then"),
    ({"planned": [VEHICLE, VEHICLE]}, r"line 4 has planned vehicles \['target', 'target'\], expected the target, then"),
    ({"hdri_yaw_deg": "x"}, "line 4 has hdri_yaw_deg 'x', expected a number"),
    ({"width": 0}, "line 4 has width 0, expected a whole number from 1 to 65536"),
    ({"distractors": [{**VEHICLE, "label": "no"}]}, r"has planned\[1\].label 'no', expected \"full\""),
    ({"companions": [NO_LABEL]}, r"line 4 lacks planned\[1\].label"),
    ({"companions": [{**VEHICLE, "bbox": None, "gap": []}]}, r"line 4 has planned\[1\].gap \[\]"),
    ({"category": "zeppelin"}, "line 4 has the class 'zeppelin' for 't72', expected 'tank'"),
    ({"companions": [{**VEHICLE, "category": "car"}]}, "line 4 has the class 'car' for 't72', expected 'tank'"),
    *(({key: v}, rf"line 4 has (planned\[0\]\.)?{key} ") for key, v in OUT_OF_RANGE),
]
DAMAGED = [  # the number of a line, its replacement, and the error
    (3, b"{\n", r"line 3 is no JSON"),
    (3, b"[]\n", r"line 3 is list, not an image"),
    (4, line({"index": 2}), r"line 4 lacks image_id, file_name, scenery"),
    (2, line(row(1)), r"line 2 has index 1, expected 0"),
    (6, line(row(4, file_name="../x.png")), r"line 6 has file_name '../x.png', expected a path like images/1.png"),
    (6, b"", r"ends after 4 of 5 images"),
    (6, line(row(4)) + line(row(5)), r"line 7 is more than the 5 images of the header"),
    *((4, line(row(2, **changed)), message) for changed, message in CHANGED),
]


@pytest.mark.parametrize(("number", "text", "message"), DAMAGED)
def test_the_error_of_a_damaged_line_names_it(tmp_path, number, text, message):
    path = written(tmp_path / "plan.jsonl", vehicles={"t72": {"category": "tank"}})
    lines = path.read_bytes().splitlines(keepends=True)
    lines[number - 1] = text
    path.write_bytes(b"".join(lines))
    with pytest.raises(ConfigError, match=message) as caught:
        list(read_plan(path))
    assert str(path) in str(caught.value)


def test_a_plan_whose_config_has_a_key_of_an_earlier_version_names_the_key(tmp_path):
    config = {**small_config().model_dump(mode="json"), "sensor": {"preset": "phone"}}
    plan = read_plan(write_lines(tmp_path / "plan.jsonl", [row(0)], root="..", config=config))
    with pytest.raises(ConfigError, match=r"plan.jsonl: line 1, config: sensor is gone; .*`train`.*; plan again"):
        _ = plan.config


def test_only_plans_are_overwritten(path):
    written(path, rows=5)
    config = path.with_name("hulldown.toml")
    config.write_text("seed = 0\n")
    with pytest.raises(OutputError, match=r"hulldown.toml: exists and isn't a plan by hulldown; name another file"):
        PlanWriter(config, header())
    assert config.read_text() == "seed = 0\n"
    with pytest.raises(OutputError, match="is a folder; name a file for a plan"):
        PlanWriter(path.parent, header())
    assert sorted(os.listdir(path.parent)) == ["hulldown.toml", "plan.jsonl"]
    assert not path.parent.with_name(path.parent.name + ".partial").exists()


HEADERS = [
    *(("images", value) for value in (-1, 2**63, 1.0, True)), ("seed", -1), ("seed", 2**63), ("config", []),
    ("root", None), ("vehicles", [1]), ("vehicles", {"a": 1}), ("vehicles", {"a": {}}),
    ("sceneries", {"a": {"origin": [0, 0]}}), ("hdris", {"a": {"path": 3}}), ("versions", {"python": 3}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty, not a plan"),
        (b"\x89PNG\r\n", "is a picture, not a plan"),
        (b'{"images": [], "annotations": []}\n', "is another file, not a plan"),
        (line({**HEADER, "hulldown_plan": 3}), "line 1 has plan format 3, this is format 4; plan again"),
        (line({**HEADER, "hulldown_plan": 5}), "line 1 has plan format 5, this is format 4; plan again"),
        (line({k: v for k, v in HEADER.items() if k != "images"}), "line 1 lacks images"),
        (b"[" * 100_000, "is another file, not a plan"),
        (b'{"hulldown_plan": 4, "a": "\xff"}', "line 1 isn't the header of a plan"),
        *((line({**HEADER, key: value}), f"line 1 has {key} ") for key, value in HEADERS),
        (line({**HEADER, "images": 3_159_564_035}), "line 1 has 3159564035 images, more than the [0-9]+ bytes of the"),
        (None, "no such plan; make one with"),
    ],
)
def test_a_foreign_file_is_not_a_plan(tmp_path, content, message):
    path = tmp_path / "plan.jsonl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        read_plan(path)


def attempt(path, rows, tail=b""):
    """Files of a process that was killed after some rows, in the middle of a line."""
    writer = PlanWriter(path, header())
    for i in range(rows):
        writer.write(line(row(i)), 1)
    writer.write(tail, 0)
    writer.__exit__(KeyboardInterrupt, None, None)


def test_an_attempt_at_another_plan_is_replaced(tmp_path):
    path = tmp_path / "plan.jsonl"
    attempt(path, 3)
    with PlanWriter(path, header(seed=1)) as writer:
        assert writer.rows == 0
    assert os.listdir(tmp_path) == []


def test_a_plan_is_replaced_when_its_successor_is_complete(path):
    before = path.read_bytes()
    attempt(path, 2)
    assert path.read_bytes() == before


def test_two_processes_cannot_write_one_plan(tmp_path):
    path = tmp_path / "plan.jsonl"
    with PlanWriter(path, header()), pytest.raises(OutputError, match="another process is writing this plan"):
        PlanWriter(path, header())


def test_the_lock_of_a_plan_is_removed_before_it_is_released(tmp_path, monkeypatch):
    writer = PlanWriter(tmp_path / "plan.jsonl", header())
    there = []
    release = writer._lock._lock.release
    monkeypatch.setattr(writer._lock._lock, "release", lambda: (there.append(Path(writer._lock.path).exists()), release()))
    writer.__exit__(None, None, None)
    assert there == [False]


LEGAL = ["images/1.png", "images/a/b c.png", "images/é.v2.png", "images/constant.png"]
ILLEGAL = [
    *("images/./1.png", "images//1.png", "./images/1.png", "images/../images/1.png", "/images/1.png", "../1.png"),
    *("images", "images/", "images/.png", ".unfinished/1.png", "images/.unfinished/1.png", "images/a/.b.png", "1.png"),
    *("annotations.json", "images/1.jpg", "images/1.PNG", "Images/1.png", "a/images/1.png", "images/1.png/"),
    *("images\\1.png", "C:\\images\\1.png", "images/a:b.png", "images/1.png\n", "images/\x1b[31m.png"),
    *("images/CON.png", "images/nul/1.png", "images/a./1.png", "images/a /1.png", "images/a?.png", "images/*.png"),
    *("", "images/a\0.png", "images/" + "a" * 300 + ".png", "images/" + "a/" * 100 + "1.png"),
]


@pytest.mark.parametrize("name", ILLEGAL)
def test_refused_names_of_pictures(tmp_path, name):
    """Two spellings of one name were two rows with one picture; names with a leading dot were deleted."""
    assert not re.search(PICTURE_NAME, name)
    path = write_lines(tmp_path / "plan.jsonl", [row(0, file_name=name)])
    with pytest.raises(ConfigError, match=r"line 2 has file_name .*, expected a path like images/1.png"):
        list(read_plan(path))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (LEGAL, None),
        (["images/a.png", "images/A.png"], "line 3 has file_name 'images/A.png', which line 2 has"),
        (["images/00000002.png", "images/00000002.png"], "line 3 has file_name 'images/00000002.png', which line 2"),
        (["images/00000001.png", "images/00000001.png"], "line 3 has file_name 'images/00000001.png', which line 2"),
        (["images/00000001.png", "images/b.png", "images/B.png"], "line 4 has file_name 'images/B.png', which line 3"),
        (["images/e\u0301.png", "images/\u00e9.png"], "line 3 has file_name .*, which line 2 has"),
        (["images/00000002.png", "images/00000001.png", "images/00000003.png"], None),
        (["images/1.png", "images/0000001.png", "images/000000001.png", "images/00000003.png"], None),
    ],
)
def test_two_pictures_with_one_name_are_found_and_others_allowed(tmp_path, names, message):
    path = write_lines(tmp_path / "plan.jsonl", [row(i, file_name=name) for i, name in enumerate(names)])
    if message is None:
        assert [read.file_name for read in read_plan(path)] == names
        assert all(map(is_safe_relative_path, names))
    else:
        with pytest.raises(ConfigError, match=message):
            list(read_plan(path))


@pytest.mark.parametrize(
    ("name", "kind"),
    [("plan.jsonl.partial", "link"), ("plan.jsonl.partial", "dangling"), ("plan.jsonl.partial", "fifo"),
     (".plan.jsonl.lock", "link")],
)  # fmt: skip
def test_links_beside_a_plan_are_not_followed(tmp_path, name, kind):
    """The target of a linked partial file was overwritten."""
    precious = tmp_path / "precious"
    precious.write_text("content")
    folder = tmp_path / "plans"
    folder.mkdir()
    if kind == "fifo":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to(precious if kind == "link" else tmp_path / "new")
    with pytest.raises(HulldownError, match=r"plan\.jsonl: cannot be written"):
        PlanWriter(folder / "plan.jsonl", header())
    assert os.listdir(folder) == [name]
    assert precious.read_text() == "content"
    assert not (tmp_path / "new").exists()
