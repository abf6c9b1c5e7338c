"""Plans with poses that users give."""

import numpy as np
import pytest

from hulldown.base.errors import ConfigError
from hulldown.planning.check import check_plan
from hulldown.planning.inputs.poses import read_poses
from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import small_assets, small_config

ASSETS = small_assets()
HILLS = ASSETS.sceneries["hills"].origin
CONFIG = small_config(
    seed=3,
    camera={"roll_deg": [-4.0, 4.0], "visible_fraction": [0.05, 1.0], "truncated_fraction": [0.0, 0.9]},
    placement={"vehicles_per_image": [1, 2]},
)
COLUMNS = "scenery,vehicle,x,y,z,yaw_deg,camera_x,camera_y,camera_z,look_at_x,look_at_y,look_at_z,sequence"


def written(folder, *lines, columns=COLUMNS):
    path = folder / "poses.csv"
    path.write_text("\n".join([columns, *lines]) + "\n", encoding="utf-8-sig")
    return path


def planned(folder, *lines, columns=COLUMNS, config=CONFIG, **settings):
    poses = read_poses(written(folder, *lines, columns=columns))
    return write_plan(config, ASSETS, folder / "plan.jsonl", poses=poses, **settings)


def at(x, y, z=None, origin=HILLS):
    """Grid points on the hills in their file's coordinates."""
    up = "" if z is None else f"{origin[2] + z}"
    return f"{origin[0] + x},{origin[1] + y},{up}"


def heading(row):
    forward = row.target.world_from_vehicle[:3, 0]
    return np.degrees(np.arctan2(forward[1], forward[0]))


def test_given_values_are_used_and_others_planned(tmp_path):
    plan = planned(
        tmp_path,
        f"hills,leo,{at(10, 20)},35,{at(-25, 30, 15)},,,,",
        ",ural,,,,,,,,,,,",
        f"hills,,{at(-30, 5)},,{at(-30, 45, 20)},{at(-28, 5, 3)},",
        "bare,ural,4,5,0,-120,,,,,,,",
        f"hills,t72,{at(0, -40)},,,,,{at(0, -40, 2)},",
    )
    first, free, looking, level, aimed = plan
    assert [row.target.vehicle for row in (first, level, aimed)] == ["leo", "ural", "t72"]
    assert [row.scenery for row in (first, looking, level, aimed)] == ["hills", "hills", "bare", "hills"]
    assert first.target.world_from_vehicle[:2, 3].tolist() == [10.0, 20.0]
    assert heading(first) == pytest.approx(35.0, abs=1e-6)
    assert first.world_from_camera[:3, 3].tolist() == [-25.0, 30.0, 15.0]
    assert first.target.slope_deg > 0.0, "it was settled"
    assert free.target.vehicle == "ural"
    assert looking.world_from_camera[:3, 3].tolist() == [-30.0, 45.0, 20.0]
    for row, point in ((looking, [-28.0, 5.0, 3.0]), (aimed, [0.0, -40.0, 2.0])):
        center = row.camera.project([point])[0][0]
        assert center == pytest.approx([row.width / 2, row.height / 2], abs=1e-5), "its axis goes through the point"
    assert level.target.world_from_vehicle[:3, 3].tolist() == [4.0, 5.0, 0.0]
    assert level.target.slope_deg == 0.0
    assert heading(level) == pytest.approx(-120.0, abs=1e-9)
    assert all(row.sequence is None and row.target.track_id is None for row in plan)
    assert check_plan(plan, ASSETS) == [], "the header has the lines"


def test_a_given_camera_need_not_be_within_the_configs_ranges(tmp_path):
    camera = {"size_measure": "height", "target_fraction": [0.3, 0.31], "distance_m": [8.0, 20.0], "fov_x_deg": 50.0}
    (row,) = planned(tmp_path, f"hills,leo,{at(10, 20)},35,{at(-90, 30, 30)},,,,", config=small_config(camera=camera))
    assert row.world_from_camera[:3, 3].tolist() == [-90.0, 30.0, 30.0]
    assert row.target.bbox.height < 0.1 * row.height


def test_a_sequence_moves_only_the_camera(tmp_path):
    frames = [f"hills,leo,{at(10, 20)},35,{at(-20 + 4 * k, -15, 15)},,,,drive" for k in range(5)]
    plan = planned(tmp_path, ",ural,,,,,,,,,,,", *frames, f"hills,leo,{at(10, 20)},35,{at(-20, -15, 15)},,,,")
    before, *rows, after = plan
    assert [row.shot for row in rows] == list(range(5))
    assert {row.sequence for row in rows} == {"drive"}
    assert [row.world_from_camera[0, 3] for row in rows] == [-20.0 + 4 * k for k in range(5)]
    for key in ("position", "hdri", "hdri_yaw_deg", "strength", "exposure_ev", "fov_x_deg", "weather"):
        assert len({getattr(row, key) for row in rows}) == 1, key
    for k in range(len(rows[0].planned)):
        assert len({row.planned[k].world_from_vehicle.tobytes() for row in rows}) == 1
        assert len({row.planned[k].track_id for row in rows}) == 1
    tracks = {vehicle.track_id for vehicle in rows[0].planned}
    assert len(tracks) == len(rows[0].planned)
    assert None not in tracks
    assert before.sequence is None is after.sequence
    assert after.position == rows[0].position + 1
    assert len({row.sample_seed for row in rows}) == 5, "the noise differs"
    down = np.array([row.world_from_camera[2, 0] for row in rows])
    assert np.ptp(np.abs(np.degrees(np.arcsin(down)))) < 1.0, "the roll is constant"
    assert check_plan(plan, ASSETS) == []


def test_workers_and_blocks_change_nothing(tmp_path):
    lines = [f"hills,,{at(-60 + 2 * k, 30)},,,,,,,," for k in range(70)] + ["bare,,,,,,,,,,,,"] * 70
    one = planned(tmp_path, *lines).path.read_bytes()
    assert planned(tmp_path, *lines, workers=2).path.read_bytes() == one


LINES = [  # one after a possible line, and the error
    ("hills,leo,1,,,,,,,,,,", "line 3: has x but no y"),
    ("hills,leo,,,5,,,,,,,,", "line 3: has z but no x"),
    ("hills,leo,1,north,,,,,,,,,", "line 3: column y: 'north' isn't a number"),
    ("hills,leo,1,nan,,,,,,,,,", "line 3: column y: 'nan' isn't a number"),
    ("hills,leo,1,2,,,3,4,,,,,", "line 3: has camera_x but no camera_z"),
    ("hills,leo,,,,,3,4,5,,,,", "line 3: has camera_x but no x"),
    ("hills,leo,1,2,,,3,4,5,3,4,5,", "line 3: column look_at_x: the camera looks at its own place"),
    ("hills,leo,1,2,,,,,,,,,drive", "line 3: has sequence but no camera_x"),
    ("moon,leo,1,2,,,,,,,,,", "line 3: column scenery: 'moon' is none; they are"),
    ("hills,leopard,,,,,,,,,,,", "line 3: column vehicle: 'leopard' is none; they are"),
    (",leo,1,2,,,,,,,,,", "line 3: gives coordinates but no scenery"),
    ("hills,leo,1,2,,", "line 3: has 6 cells"),
    ('hills,"leo,1,2,,', "line 3: is no CSV"),
    (f"hills,leo,{at(5000, 0)},,,,,,,,", "line 3: vehicle 'leo' on scenery 'hills' finds no place to stand"),
    (
        f"hills,leo,{at(10, 20, 9)},30,,,,,,,",
        "line 3: vehicle 'leo' on scenery 'hills' finds no place to stand: all tries at its given",
    ),
    (f"hills,leo,{at(10, 20)},30,{at(-20, 0, -30)},,,,", "line 3: vehicle 'leo' on scenery 'hills' cannot be seen"),
    (f"hills,leo,{at(10, 20)},30,{at(10, 20, 1)},,,,", "line 3: vehicle 'leo' on scenery 'hills' cannot be seen"),
]
FILES = [  # lines, columns, and the error
    ([], "", "is empty"),
    ([], COLUMNS, "has no poses"),
    (["1"], "altitude", "line 1: has the unknown column 'altitude'"),
    (["1,2"], "x,x", "line 1: has the column x twice"),
    (["1,2,0,0,9,a", "1,3,0,0,9,a"], "x,y,camera_x,camera_y,camera_z,sequence", "line 3: column y: differs"),
    (["1,2,0,0,9,a", "1,2,0,0,9,", "1,2,0,0,9,a"], "x,y,camera_x,camera_y,camera_z,sequence", "line 4: column seq"),
    *((["hills,leo,,,,,,,,,,,", line], COLUMNS, message) for line, message in LINES),
]


@pytest.mark.parametrize(("lines", "columns", "message"), FILES, ids=[message for *_, message in FILES])
def test_the_error_of_impossible_poses_names_the_line(tmp_path, lines, columns, message):
    with pytest.raises(ConfigError) as caught:
        planned(tmp_path, *lines, columns=columns)
    assert message in str(caught.value)
    assert "poses.csv" in str(caught.value)


def test_semicolons_blank_lines_and_any_column_order(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_bytes(b"yaw_deg ; x;y\r\n\r\n90;1.5;-2\r\n;;\r\n;3;4\r\n")
    poses = read_poses(path)
    assert [(line.line, line.x, line.y, line.yaw_deg) for line in poses.lines] == [(3, 1.5, -2.0, 90.0), (5, 3.0, 4.0, None)]
