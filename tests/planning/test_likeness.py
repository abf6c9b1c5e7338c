"""Plans that follow photographs: sizes, positions, and shapes of boxes, within the limits of the config."""

import numpy as np
import pytest
from scipy.stats import ks_2samp

from hulldown.base.errors import ConfigError
from hulldown.dataset.photographs import read_photographs
from hulldown.plan.plan_file import read_plan
from hulldown.plan.summary import summarize_plan
from hulldown.planning.check import check_plan
from hulldown.planning.search.likeness import TRUNCATION_MARGIN, Likeness
from hulldown.planning.write import write_plan
from hulldown.tests.builders.editing import write_dataset
from hulldown.tests.builders.planning_assets import bare, plan, small_assets, small_config

WIDTH, HEIGHT = 1600, 1200  # of the photographs; renders are 1920 x 1080
NEAR_PX = 1.0  # of positions, since turning the camera changes a box slightly
# In shares of the picture: companions are on level ground, unlike in the photograph, and later tries turn cameras.
LEVEL = (0.06, 0.1, 0.01)
FROM_ABOVE = (0.03, 0.03, 0.06)  # heights follow from headings
ROUNDED_PX = 2e-6  # boxes in plans
ASSETS = small_assets(bare("bare"))


def photographed(folder, boxes, names=("tank",)):
    """A photograph for each list of boxes (class, left, top, width, height)."""
    images = [{"file_name": f"{i}.jpg", "width": WIDTH, "height": HEIGHT} for i in range(len(boxes))]
    labels = [
        {"image_id": i, "category_id": names.index(name) + 1, "bbox": box}
        for i, of_image in enumerate(boxes, start=1)
        for name, *box in of_image
    ]
    write_dataset(folder, images, labels, names=names, pictures=False)
    return read_photographs(folder)


def config_of(known, images=60, **camera):
    camera = {"like": str(known.path), "like_share": 1.0, "visibility_rays": 16, "distance_m": [2, 1e5], **camera}
    return small_config(camera=camera, budget={"images_per_class": images})


def drawn_boxes(n, seed=0):
    """Small, low, and left of the center, unlike the configured ranges."""
    rng = np.random.default_rng(seed)
    height = HEIGHT * np.exp(rng.uniform(np.log(0.03), np.log(0.12), n))
    size = np.stack([height * rng.uniform(1.3, 3.0, n), height], 1)
    center = np.stack([WIDTH * rng.beta(2, 4, n), HEIGHT * rng.beta(5, 2, n)], 1)
    low = np.clip(center - size / 2, 10, np.array([WIDTH, HEIGHT]) - size - 10)
    return [[("tank", *box)] for box in np.concatenate([low, size], 1).tolist()]


def features(rows):
    boxes = np.array([row.target.bbox for row in rows])
    center = (boxes[:, :2] + boxes[:, 2:] / 2) / [1920, 1080]
    return {"height": boxes[:, 3] / 1080, "x": center[:, 0], "y": center[:, 1], "aspect": boxes[:, 2] / boxes[:, 3]}


def test_a_plan_matches_sizes_positions_and_shapes_of_the_photographs(tmp_path):
    known = photographed(tmp_path, drawn_boxes(200))
    wanted = {"height": known.height, "x": known.center[:, 0], "y": known.center[:, 1], "aspect": known.aspect}
    found, other = (
        features(list(plan(config_of(known, 500, like_share=share, elevation_deg=[1, 8]), ASSETS))) for share in (1.0, 0.0)
    )
    for key, values in wanted.items():
        distance = ks_2samp(found[key], values).statistic
        assert distance < (0.2 if key == "aspect" else 0.1), key
        assert distance < ks_2samp(other[key], values).statistic / (1.4 if key == "aspect" else 2.0), key


@pytest.mark.parametrize("options", [{}, {"roll_deg": [-20, 20]}, {"size_measure": "area"}])
def test_sizes_are_exact_and_positions_follow(tmp_path, options):
    known = photographed(tmp_path, drawn_boxes(5))
    for row in plan(config_of(known, like_spread=0.0, **options), ASSETS):
        assert row.like.photograph == row.like.sampled
        i = known.file_names.index(row.like.photograph)
        x, y, w, h = row.target.bbox
        assert h == pytest.approx(known.height[i] * 1080, abs=ROUNDED_PX)
        np.testing.assert_allclose([x + w / 2, y + h / 2], known.center[i] * [1920, 1080], atol=NEAR_PX)


def test_boxes_cut_by_the_frame_are_cut_at_the_same_sides(tmp_path):
    cuts = {
        "left": ("tank", 0, 500, 90, 80), "bottom": ("tank", 700, 1120, 300, 80),
        "corner": ("tank", 1400, 0, 200, 80), "none": ("tank", 700, 500, 200, 80),
    }  # fmt: skip
    known = photographed(tmp_path, [[box] for box in cuts.values()])
    sides = {"left": [1, 0, 0, 0], "bottom": [0, 0, 0, 1], "corner": [0, 1, 1, 0], "none": [0, 0, 0, 0]}
    shown, reached = set(), []
    for row in plan(config_of(known, 100, truncated_fraction=[0.0, 0.8], like_spread=0.0), ASSETS):
        if row.like.photograph is None:
            continue
        i = known.file_names.index(row.like.photograph)
        shown.add(i)
        x, y, w, h = row.target.bbox_amodal
        ends = np.array([x, y, 1920 - x - w, 1080 - y - h]) <= NEAR_PX
        assert ends.tolist() == [bool(side) for side in sides[list(cuts)[i]]]
        # The visible share is the same, unless a vehicle is too short, or too long for the limit.
        wanted = np.array(list(cuts.values())[i][3:]) * 1080 / HEIGHT
        kept = np.minimum([x + w, y + h], [1920, 1080]) - np.maximum([x, y], 0)
        across, down = np.reshape(sides[list(cuts)[i]], (2, 2)).any(axis=0)
        at_limit = kept.prod() <= (1.0 - TRUNCATION_MARGIN * 0.8) * w * h + NEAR_PX * max(w, h)
        assert not across or at_limit or kept[0] <= wanted[0] + NEAR_PX
        assert not down or kept[1] == pytest.approx(wanted[1], abs=NEAR_PX)
        reached.append(not across or kept[0] >= wanted[0] - NEAR_PX)
    assert np.mean(reached) > 0.8
    assert shown == {0, 1, 2, 3}


def test_other_values_follow_the_configured_ranges(tmp_path):
    known = photographed(tmp_path, drawn_boxes(1))
    mixed = list(plan(config_of(known, like_share=0.5), ASSETS))
    alone = list(plan(config_of(known, like=None), ASSETS))
    rest = [(one, other) for one, other in zip(mixed, alone, strict=True) if one.like is None]
    assert 0.3 * len(mixed) < len(rest) < 0.7 * len(mixed)
    assert all(one.target.bbox == other.target.bbox for one, other in rest)


def test_limits_override_photographs_and_the_summary_counts_them(tmp_path):
    small, large = ("tank", 700, 500, 80, 40), ("tank", 300, 200, 1000, 700)
    known = photographed(tmp_path, [[small], [large]])
    summary = summarize_plan(plan(config_of(known, distance_m=[40, 1e5]), ASSETS))
    like = summary.counts["like"]
    assert like["followed"] > 0
    assert like["another"] > 0
    assert any("limits won over" in note for note in summary.unmet_wish_notes())
    # No camera can produce any of them.
    none = summarize_plan(
        plan(config_of(known, images=5, distance_m=[3000, 4000], target_fraction=0.001, min_box_px=1), ASSETS)
    )
    assert none.counts["like"] == {"none": 10}


@pytest.mark.parametrize(
    ("box", "limits", "problem"),
    [
        (("tank", 0, 500, 90, 80), {}, "cut off more than camera.truncated_fraction"),
        (("tank", 100, 500, 90, 80), {"truncated_fraction": [0.1, 0.5]}, "cut off less than"),
        (("tank", 100, 500, 9, 8), {}, "smaller than camera.min_box_px"),
    ],
)
def test_photographs_without_a_box_within_the_limits_are_refused(tmp_path, box, limits, problem):
    known = photographed(tmp_path, [[box]])
    with pytest.raises(ConfigError, match=problem) as caught:
        next(plan(config_of(known, **limits), ASSETS))
    assert caught.value.remedy
    with pytest.raises(ConfigError, match="it has none"):
        next(plan(config_of(photographed(tmp_path, [[]])), ASSETS))


def test_classes_without_boxes_follow_all_photographs_and_are_named(tmp_path):
    known = photographed(tmp_path, [*drawn_boxes(25), [("tank", 0, 0, 20, 20)]], names=("tank", "bus"))
    notes = Likeness(known, config_of(known)).box_usability_notes(["tank", "truck"])
    assert len(notes) == 2
    assert "1 of 26 boxes aren't followed" in notes[0]
    assert "no box of class 'truck'" in notes[1]
    assert {row.target.category for row in plan(config_of(known, 5), ASSETS) if row.like.photograph} == {"tank", "truck"}


def test_changed_photographs_are_refused(tmp_path):
    known = photographed(tmp_path, drawn_boxes(3))
    made = write_plan(config_of(known, 3), ASSETS, tmp_path / "plan.jsonl")
    assert all(row.like.photograph for row in read_plan(made.path))
    assert check_plan(made, ASSETS) == []
    photographed(tmp_path, drawn_boxes(4))
    with pytest.raises(ConfigError, match=r"camera\.like"):
        check_plan(made, ASSETS)


@pytest.mark.parametrize(
    ("beside", "elevation_deg", "level"),
    [(("tank", 1100, 560, 110, 42), [3, 35], LEVEL), (("tank", 1000, 200, 70, 150), [70, 88], FROM_ABOVE)],
)
def test_companions_match_the_number_sizes_and_positions_of_other_boxes(tmp_path, beside, elevation_deg, level):
    boxes = [[("tank", 400, 600, 160, 60), beside], [("tank", 700, 500, 160, 60)]]
    known = photographed(tmp_path, boxes)
    camera = {"like": str(known.path), "like_share": 1.0, "like_spread": 0.0, "visibility_rays": 16}
    config = small_config(
        camera={**camera, "elevation_deg": elevation_deg, "distance_m": [2, 1e5]},
        placement={"vehicles_per_image": [1, 3], "companion_distance": [2, 100]},
        budget={"images_per_class": 30, "images_per_position": 1},
    )
    wanted, found = [], []
    for row in plan(config, ASSETS):
        i = known.file_names.index(row.like.sampled)
        assert len(row.companions) + row.left_out == len(boxes[i]) - 1
        if not row.companions or row.like.photograph != row.like.sampled or row.companions[0].bbox is None:
            continue
        x, y, w, h = row.companions[0].bbox
        target = row.target.bbox
        of_target = int(np.abs(known.center[:2, 0] * 1920 - target.x - target.width / 2).argmin())
        found.append([(x + w / 2) / 1920, (y + h / 2) / 1080, h / 1080])
        wanted.append([*known.center[1 - of_target], known.height[1 - of_target]])
    off = np.median(np.abs(np.array(found) - np.array(wanted)), axis=0)
    assert (off < level).all(), off
