"""Statistics of a plan: counts and displays."""

import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

from hulldown.plan.row import decode_row
from hulldown.plan.summary import Histogram, summarize_plan
from hulldown.tests.builders import plan_lines
from hulldown.tests.builders.plan_lines import VEHICLE, line

# 3 m ahead of the center of the box and 4 m above it.
CAMERA = [[1.0, 0.0, 0.0, 3.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.25], [0.0, 0.0, 0.0, 1.0]]
TARGET = {"bbox": [0.0, 0.0, 10.0, 20.0], "visible_fraction": 1.0, "slope_deg": 5.0, "air_contrast": 1.0, "paint": []}
FOG, RAIN = ({"visibility_m": 100.0, "kind": kind} for kind in ("fog", "rain"))


def companion(**changes):
    """Another vehicle in an image."""
    return {**VEHICLE, **TARGET, **changes}


def row(i, **changes):
    where = {"position": i // 2, "shot": i % 2, "world_from_camera": CAMERA, "exposure_ev": 0.0}
    return decode_row(line(plan_lines.row(i, **{**where, **TARGET, **changes})))


ROWS = [
    row(0, rejected={"too_steep": 3, "camera_low": 1}),
    row(1, bbox=[0.0, 0.0, 33.0, 33.0], weather=FOG),
    row(2, category="truck", vehicle="ural", bbox=[0.0, 0.0, 500.0, 200.0], companions=[companion()]),
    row(3, category="truck", vehicle="man", slope_deg=29.5, visible_fraction=0.4, rejected={"hidden": 2}),
]


def test_counts():
    found = summarize_plan(iter(ROWS)).to_json()
    assert found["images"] == 4
    assert found["positions"] == 2
    assert found["classes"] == {"tank": {"t72": 2}, "truck": {"ural": 1, "man": 1}}
    assert found["sizes"] == {"tank": {"small": 1, "medium": 1}, "truck": {"large": 1, "small": 1}}
    assert found["companions"] == {"t72": 1}
    assert found["foggy"] == 1
    assert found["weather"] == {"clear": 3, "fog": 1}
    assert found["rejected"] == {"too_steep": 3, "camera_low": 1, "hidden": 2}
    slope = found["histograms"]["slope_deg"]
    assert (slope["lowest"], slope["highest"], slope["mean"]) == (5.0, 29.5, 11.125)
    assert [i for i, n in enumerate(slope["counts"]) if n] == [5, 29]
    assert found["histograms"]["distance_m"]["lowest"] == 5.0
    assert json.loads(json.dumps(found)) == found


def test_companions_and_distractors_are_counted():
    car = [companion(vehicle="car", category=None, label="none")]
    rows = [
        row(0, left_out=2, distractors=car, weather=RAIN, hdri="dusk", air_contrast=0.5),
        row(1, left_out=2, distractors=car, companions=[companion(label="ignored")]),
        row(2, background=True, category=None, vehicle="bales", label="none", exposure_ev=2.0),
        row(3, weather=FOG, air_contrast=0.25, exposure_ev=1.0),
        row(4, background=True, label="none"),
    ]
    summary = summarize_plan(rows)
    found = summary.to_json()
    assert found["distractors"] == {"car": 2}
    assert found["backgrounds"] == {"bales": 1, "": 1}
    assert found["hdris"] == {"dusk": 1, "noon": 4}
    assert found["labels"] == {"full": 3, "ignored": 1}
    assert found["companions_left_out"] == 2
    assert summary.open_sky == 1
    assert summarize_plan(rows, overcast=True).open_sky == 0
    histograms = found["histograms"]
    assert (histograms["air_contrast"]["lowest"], histograms["air_contrast"]["highest"]) == (0.25, 0.5)
    assert sum(histograms["air_contrast"]["counts"]) == 2
    assert histograms["elevation_deg"]["mean"] == pytest.approx(math.degrees(math.atan2(4.0, 3.0)))
    assert histograms["box_px"]["mean"] == pytest.approx(math.sqrt(200.0))
    assert histograms["exposure_ev"]["highest"] == 1.0
    assert len(summary.unmet_wish_notes()) == 2


def test_one_class_without_backgrounds_is_noted():
    assert "background_share" in summarize_plan([row(0)]).unmet_wish_notes()[0]
    assert summarize_plan([row(0), row(1, category="truck")]).unmet_wish_notes() == []
    assert summarize_plan([row(0), row(1, background=True, label="none")]).unmet_wish_notes() == []


def test_an_empty_plan():
    summary = summarize_plan([])
    assert summary.to_json()["histograms"]["slope_deg"]["lowest"] is None
    assert len(summary.tables()) == 3


@pytest.mark.parametrize(
    ("rows", "shown"),
    [
        (ROWS, ("4 images at 2 positions", "ural 1, man 1", "too steep at the spot", "60.0 %", "hidden more than")),
        ([row(0, category="tank [/old]", vehicle="t72[b]")], ("tank [/old]", "t72[b] 1")),
    ],
    ids=["what to act on", "names with brackets"],
)
def test_tables_show(rows, shown):
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(*summarize_plan(rows).tables())
    text = console.export_text()
    assert all(words in text for words in shown), text


def test_a_histogram_counts_all_values():
    histogram = Histogram("x", np.array([0.0, 1.0, 2.0]), np.array([-5.0, 0.0, 0.5, 1.0, 2.0, 9.0]))
    assert histogram.bin_counts.tolist() == [3, 3]
    assert (histogram.lowest_mean_and_highest["lowest"], histogram.lowest_mean_and_highest["highest"]) == (-5.0, 9.0)
    assert histogram.bars_text() == "██"
