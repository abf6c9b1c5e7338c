"""A plan on disk: streaming, by index, damage named by its line, attempts continued."""

import os

import pytest

from geometry.errors import ConfigError
from geometry.files import stays_inside
from planning.plan_file import ROW_KEYS, PlanWriter, encode, read_plan

HEADER = {
    "hulldown_plan": 1,
    "config": {},
    "seed": 0,
    "root": ".",
    "vehicles": {},
    "sceneries": {},
    "hdris": {},
    "versions": {},
    "images": 5,
}


POSE = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
VEHICLE = {
    "vehicle": "t72",
    "category": "tank",
    "world_from_vehicle": POSE,
    "articulation": {"turret": 0.1},
    "bbox": [1.0, 2.0, 3.0, 4.0],
    "bbox_amodal": [1.0, 2.0, 3.0, 4.0],
    "visible_fraction": 0.5,
    "truncated_fraction": 0.0,
    "slope_deg": 1.0,
    "gap": 0.1,
    "penetration": 0.0,
    "tries": 1,
}
ROW = {
    "scenery": "hills",
    "position": 0,
    "shot": 0,
    "world_from_camera": POSE,
    "fov_x_deg": 50.0,
    "width": 64,
    "height": 48,
    "hdri": "noon",
    "hdri_yaw_deg": 3.0,
    "strength": 1.0,
    "weather": None,
    "sample_seed": 7,
    **VEHICLE,
    "companions": [],
    "rejected": {},
}


def row(i):
    return {**ROW, "index": i, "image_id": i + 1, "file_name": f"images/{i:08d}.png", "gap": 0.1 * i}


def written(path, rows=5, header=HEADER):
    with PlanWriter(path, header) as writer:
        for i in range(rows):
            writer.write(encode(row(i)), 1)
        writer.finish()
    return path


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "plan.jsonl")


def test_rows_come_back_as_they_were(path):
    plan = read_plan(path)
    assert plan.header == HEADER
    assert len(plan) == 5
    assert list(plan) == [row(i) for i in range(5)]
    assert list(plan.rows(3)) == [row(3), row(4)]
    assert [plan[i] for i in (4, 0, 2)] == [row(4), row(0), row(2)]
    with pytest.raises(IndexError, match="index: expected 0 to 4, got 5"):
        plan[5]


def test_nothing_but_the_plan_is_left(path):
    assert os.listdir(path.parent) == ["plan.jsonl"]


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (3, b"{\n", r"line 3 is no JSON"),
        (3, b"[]\n", r"line 3 is list, not an image"),
        (4, encode({"index": 2}), r"line 4 lacks image_id, file_name, scenery"),
        (2, encode(row(1)), r"line 2 has index 1, expected 0"),
        (6, encode({**row(4), "file_name": "../x.png"}), r"line 6 has file_name '../x.png', which leaves"),
        (6, b"", r"ends after 4 of 5 images"),
        (6, encode(row(4)) + encode(row(5)), r"line 7 is more than the 5 images of the header"),
    ],
)
def test_a_damaged_line_is_named(path, line, text, message):
    lines = path.read_bytes().splitlines(keepends=True)
    lines[line - 1] = text
    path.write_bytes(b"".join(lines))
    with pytest.raises(ConfigError, match=message) as caught:
        list(read_plan(path))
    assert str(path) in str(caught.value)


def test_the_row_of_these_tests_has_every_key():
    assert set(row(0)) == set(ROW_KEYS)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"image_id": 1}, "line 4 has image_id 1, expected 3"),
        ({"world_from_vehicle": POSE[:2]}, r"line 4 has world_from_vehicle .*, expected a 4x4 matrix"),
        ({"world_from_camera": [[None] * 4] * 4}, r"line 4 has world_from_camera .*, expected a 4x4 matrix"),
        ({"bbox": "big"}, r"line 4 has bbox 'big', expected \[x, y, width, height\]"),
        ({"bbox": None}, r"line 4 has bbox None"),
        ({"hdri_yaw_deg": "x"}, "line 4 has hdri_yaw_deg 'x', expected a number"),
        ({"strength": True}, "line 4 has strength True"),
        ({"width": 0}, "line 4 has width 0, expected a whole number of at least 1"),
        ({"weather": {"fog": 1}}, "line 4 has weather"),
        ({"articulation": {"turret": "left"}}, "line 4 has articulation"),
        ({"companions": {"a": 1}}, "line 4 has companions that are no list of vehicles"),
        ({"companions": [{"vehicle": "t72"}]}, r"line 4 lacks companions\[0\].category"),
        ({"companions": [{**VEHICLE, "bbox": None, "gap": []}]}, r"line 4 has companions\[0\].gap \[\]"),
        ({"category": "zeppelin"}, "line 4 has the class 'zeppelin' for 't72', expected 'tank'"),
        ({"companions": [{**VEHICLE, "category": "car"}]}, "line 4 has the class 'car' for 't72', expected 'tank'"),
    ],
)
def test_a_line_edited_into_nonsense_is_named(tmp_path, changed, message):
    header = {**HEADER, "vehicles": {"t72": {"category": "tank"}}}
    path = written(tmp_path / "plan.jsonl", header=header)
    lines = path.read_bytes().splitlines(keepends=True)
    lines[3] = encode({**row(2), **changed})
    path.write_bytes(b"".join(lines))
    with pytest.raises(ConfigError, match=message):
        list(read_plan(path))


def test_no_file_but_a_plan_is_written_over(path):
    written(path, rows=5)
    config = path.with_name("hulldown.toml")
    config.write_text("seed = 0\n")
    with pytest.raises(ConfigError, match=r"hulldown.toml: exists and is no plan; name another file"):
        PlanWriter(config, HEADER)
    assert config.read_text() == "seed = 0\n"
    with pytest.raises(ConfigError, match="is a folder; name a file for the plan"):
        PlanWriter(path.parent, HEADER)
    assert sorted(os.listdir(path.parent)) == ["hulldown.toml", "plan.jsonl"]
    assert not path.parent.with_name(path.parent.name + ".partial").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1 is no header of a plan"),
        (b"\x89PNG\r\n", "line 1 is no header of a plan"),
        (b'{"images": [], "annotations": []}\n', "line 1 is no header of a plan"),
        (encode({**HEADER, "hulldown_plan": 2}), "line 1 has plan format 2, this is format 1"),
        (encode({k: v for k, v in HEADER.items() if k != "images"}), "line 1 lacks images"),
    ],
)
def test_a_foreign_file_is_no_plan(tmp_path, content, message):
    path = tmp_path / "plan.jsonl"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        read_plan(path)


def test_a_missing_plan(tmp_path):
    with pytest.raises(ConfigError, match="no such plan; make one with"):
        read_plan(tmp_path / "plan.jsonl")


def attempt(path, rows, tail=b""):
    """What a process leaves that was killed after so many rows, in the middle of a line."""
    writer = PlanWriter(path, HEADER)
    for i in range(rows):
        writer.write(encode(row(i)), 1)
    writer.write(tail, 0)
    writer.__exit__(KeyboardInterrupt, None, None)


def test_an_attempt_is_continued_at_the_last_whole_row(tmp_path):
    path = tmp_path / "plan.jsonl"
    attempt(path, 3, tail=b'{"index": 3, "im')
    assert not path.exists()
    with PlanWriter(path, HEADER) as writer:
        assert writer.rows == 3
        writer.keep(2)
        for i in range(2, 5):
            writer.write(encode(row(i)), 1)
        writer.finish()
    assert path.read_bytes() == written(tmp_path / "other.jsonl").read_bytes()


def test_an_attempt_at_another_plan_is_replaced(tmp_path):
    path = tmp_path / "plan.jsonl"
    attempt(path, 3)
    other = {**HEADER, "seed": 1}
    with PlanWriter(path, other) as writer:
        assert writer.rows == 0
    assert os.listdir(tmp_path) == []


def test_a_plan_stays_until_its_successor_is_complete(path):
    before = path.read_bytes()
    attempt(path, 2)
    assert path.read_bytes() == before


def test_two_processes_do_not_write_one_plan(tmp_path):
    path = tmp_path / "plan.jsonl"
    with PlanWriter(path, HEADER), pytest.raises(ConfigError, match="another process is writing this plan"):
        PlanWriter(path, HEADER)


@pytest.mark.parametrize("name", ["images/1.png", "a.png", "a/b..c/d.png"])
def test_names_inside(name):
    assert stays_inside(name)


@pytest.mark.parametrize("name", ["", "/a", "../a", "a/../../b", "C:\\a", "\\a", "a\\..\\b", "C:a", None, 3, "a\0b"])
def test_names_that_leave_the_folder(name):
    assert not stays_inside(name)
