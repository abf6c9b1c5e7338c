"""`hulldown check`: a plan compared with one made from its config, and labels with poses."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hulldown.base.errors import ConfigError
from hulldown.plan.pictures.preview import Artist
from hulldown.plan.plan_file import read_plan
from hulldown.plan.row import PlannedVehicle, Row, row_fields
from hulldown.planning.check import check_plan, find_plan_row_problems
from hulldown.planning.planner import Planner
from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import DISTRACTOR_ENTRIES, VEHICLE_ENTRIES, hills, small_assets, small_config
from hulldown.tests.builders.shapes import surface

ASSETS = small_assets(distractors=True)
PAINT = [{"materials": ["*"], "colors": ["#4b5320", "#94835e"]}]
CONFIG = small_config(
    seed=3,
    assets={
        "vehicles": [{**entry, "paint": PAINT} for entry in VEHICLE_ENTRIES],
        "distractors": [{**entry, "paint": PAINT} for entry in DISTRACTOR_ENTRIES],
    },
    budget={"images_per_class": 8, "images_per_position": 2, "background_share": 0.2},
    placement={"vehicles_per_image": 2, "companion_distance": [9, 30], "distractors_per_image": [1, 2]},
    camera={"visible_fraction": [0.2, 1.0]},
    weather={"fog": 0.2, "rain": 0.2, "snow": 0.2, "dust": 0.2},
)
# Values that no row of the plan has.
OTHERS = {
    "vehicle": "leo2", "category": "plane", "articulation": {"turret": 0.123}, "bbox": [1.0, 2.0, 3.0, 4.0],
    "bbox_amodal": [1.0, 2.0, 3.0, 4.0], "label": "ignored", "bounds": [[-1.0] * 3, [1.0] * 3], "paint": [],
    "file_name": "images/other.png", "scenery": "moon", "hdri": "moon", "horizon_deg": 3.0, "background": None,
    "K": [[1e3, 0.0, 960.0], [0.0, 1e3, 540.0], [0.0, 0.0, 1.0]], "dist": [-0.1, 0.0, 0.0, 0.0, 0.0],
    "like": {"sampled": "a.jpg", "photograph": None}, "sequence": "drive", "track_id": 7,
    "rejected": {"gap": 1000}, "weather": {"visibility_m": 5.5, "kind": "fog"},
    "geo": {"crs": "EPSG:32632", "easting": 1.0, "northing": 2.0, "longitude": 3.0, "latitude": 4.0},
}  # fmt: skip
# The file's reader refuses another index, image number, class, or role.
READER = {"index", "image_id", "category", "role", "planned"}
FOLLOWS = {"bbox", "bbox_amodal", "visible_fraction", "truncated_fraction", "slope_deg", "gap", "penetration", "label",
           "bounds", "air_contrast", "geo"}  # fmt: skip


@pytest.fixture(scope="module")
def planner():
    """A library that plans once for all tests."""
    planner = Planner(CONFIG, ASSETS)
    planner.rows = cache(planner.rows)
    return planner


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write_plan(CONFIG, ASSETS, tmp_path_factory.mktemp("made") / "plan.jsonl")


def edited(made, path, change):
    header, *rows = map(json.loads, made.path.read_bytes().splitlines())
    change(header, rows)
    path.write_text("".join(json.dumps(each) + "\n" for each in (header, *rows)))
    return read_plan(path)


def place_of(row, role):
    """The place of the first vehicle with a role in a row, or None."""
    return next((k for k, vehicle in enumerate(row.planned) if vehicle.role == role), None)


def other(row, key):
    """Another value for a field."""
    if key.startswith("world_from"):
        return [[1.0, 0.0, 0.0, row[key][0][3] + 1e-3], *np.eye(4).tolist()[1:]]
    if key == "background":
        return not row[key]
    if key == "category":
        return None
    if key in OTHERS:
        return OTHERS[key]
    return row[key] + (1 if isinstance(row[key], int) else 1e-5 if row[key] < 0.5 else -1e-5)


def test_an_unchanged_plan_has_no_findings(made, planner):
    seen = []
    assert find_plan_row_problems(made, planner, progress=lambda done, n: seen.append((done, n))) == []
    assert seen[-1] == (len(made), len(made))


@pytest.mark.parametrize("whose", ["", "target", "companion", "distractor"])
def test_every_changed_field_is_found(made, planner, tmp_path, whose):
    """Change one field in each row, in as many rounds as needed for all fields."""
    keys = [key for key in row_fields(PlannedVehicle if whose else Row) if key not in READER]
    rows = [row.index for row in made if not whose or place_of(row, whose) is not None]
    for start in range(0, len(keys), len(rows)):
        some = dict(zip(rows, keys[start : start + len(rows)], strict=False))

        def change(_, lines, some=some):
            for i, key in some.items():
                at = lines[i]["planned"][place_of(made[i], whose)] if whose else lines[i]
                at[key] = other(at, key)

        findings = find_plan_row_problems(edited(made, tmp_path / "plan.jsonl", change), planner)
        for i, key in some.items():
            prefix = f"image {i}: {f'planned[{place_of(made[i], whose)}].' if whose else ''}{key} is "
            wanted = "its poses give" if key in FOLLOWS else "planned is"
            (finding,) = (line for line in findings if line.startswith(prefix))
            assert wanted in finding
        assert {int(line.split()[1].rstrip(":")) for line in findings} == set(some)


@pytest.mark.parametrize(
    ("section", "changes", "message"),
    [("budget", {"images_per_class": 9}, "20 images, the budget is 22"), ("light", {"exposure": 4.0}, "exposure_ev is")],
)
def test_a_changed_config_is_found(made, tmp_path, section, changes, message):
    plan = edited(made, tmp_path / "plan.jsonl", lambda header, _: header["config"][section].update(changes))
    findings = check_plan(plan, ASSETS)
    assert any(message in line for line in findings), findings[:20]


def test_findings_are_limited_in_number(made, planner, tmp_path, monkeypatch):
    monkeypatch.setattr("hulldown.planning.check.MAX_PLAN_FINDINGS", 3)
    plan = edited(made, tmp_path / "plan.jsonl", lambda _, rows: [row["planned"][0].update(tries=99) for row in rows])
    findings = find_plan_row_problems(plan, planner)
    assert len(findings) == 4
    assert findings[-1] == f"and {len(made) - 3} more"


@pytest.mark.parametrize("whose", ["target", "companion", "distractor"])
def test_an_unknown_part_is_a_one_line_error(made, planner, tmp_path, whose):
    number, place = next((row.index, k) for row in made if (k := place_of(row, whose)) is not None)

    def change(_, rows):
        rows[number]["planned"][place]["articulation"]["crane"] = 0.5

    plan = edited(made, tmp_path / "plan.jsonl", change)
    (finding,) = find_plan_row_problems(plan, planner)
    assert finding.startswith(f"image {number}: planned[{place}].articulation is")
    with pytest.raises(ConfigError, match=rf"plan\.jsonl: image {number}: part 'crane' is not known to the plan"):
        Artist(plan, ASSETS).picture(list(plan)[number], width=8)


def test_a_place_in_the_dark_is_found(tmp_path):
    """The second scenery is the first one under a roof over everything, where nothing is planned."""
    open_air, at = hills("hills", height=0.0, trees=1), np.array([-300.0, 300.0])
    roof = surface(at, at, np.full((2, 2), 6.0), "roof")
    cave = replace(open_air, name="cave", obstacle_meshes=(roof, roof), world_from_instance=np.eye(4)[None])
    assets = small_assets(open_air, cave)
    made = write_plan(small_config(budget={"images_per_class": 2}), assets, tmp_path / "made.jsonl")
    assert {row.scenery for row in made} == {"hills"}
    plan = edited(made, tmp_path / "plan.jsonl", lambda _, rows: rows[1].update(scenery="cave"))
    findings = check_plan(plan, assets)
    assert f"image 1: planned[0], {made[1].planned[0].vehicle}, is where no light of the sky reaches it" in findings
