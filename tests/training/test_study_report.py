"""A study's report: figures compared with hand counts, sentences, charts, and its page in a real browser."""

import json
import shutil

import numpy as np
import pytest
from selenium.webdriver.common.by import By

from hulldown.base.errors import HulldownError
from hulldown.cli import main
from hulldown.dataset.reports.charts import chart_svg
from hulldown.tests.builders.training_pictures import make_dataset, make_datasets
from hulldown.tests.training.test_study import config_of, pretend
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.study.results import Estimate, photographs_needed
from hulldown.training.study.study_comparison import ReportedCell, compare_study_runs
from hulldown.training.study.study_folder import planned_study_runs, prepare_study
from hulldown.training.study.study_page import (
    PAPER_COLORS,
    PAPER_FIGURES,
    arm_bar_chart,
    figure_png,
    photograph_count_chart,
    study_page,
    write_study_report,
)

ARMS = ("real", "mixed", "synthetic")
# Share of a hundred labels that the detectors of these tests find.
SKILL = {("real", 1.0): 80, ("real", 0.5): 50, ("real", 0.25): 20, ("mixed", 1.0): 80, ("mixed", 0.5): 75,
         ("mixed", 0.25): 60, ("synthetic", None): 40}  # fmt: skip


def looked(labels, share, *, seed):
    """Detections of a share of the labels, and a false positive in every eighth image."""
    rng = np.random.default_rng(seed)
    order = np.random.default_rng(5).permutation(len(labels.class_index))  # hard labels are hard for every detector
    found = [
        {"image_id": labels.images[labels.image[k]].id, "category_id": int(labels.class_id[labels.class_index[k]]),
         "bbox": labels.xywh[k].tolist(), "score": 0.6 + 0.3 * float(rng.random())}
        for k in order[: round(share / 100 * len(order))]
    ]  # fmt: skip
    alarms = [
        {"image_id": image.id, "category_id": 1, "bbox": [1.0, 1.0, 5.0, 5.0], "score": 0.55} for image in labels.images[::8]
    ]
    return found + alarms


def finished_study(pictures, folder, *, skill=SKILL, **keys):
    """Return a study's folder as `run` leaves it, with detectors that need no training."""
    out = folder / "out"
    study = prepare_study(config_of(pictures, folder, **({"arms": ARMS, "fractions": [1.0, 0.5, 0.25]} | keys)), out)
    judged = {which: read_labels(study.datasets[which].folder) for which in study.judged_dataset_names}
    for run in planned_study_runs(study.config):
        share = skill[run.arm, run.fraction] + 2 * run.seed
        pretend(out, run, {which: looked(labels, share, seed=run.seed) for which, labels in judged.items()})
    return out


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_datasets(tmp_path_factory.mktemp("pictures"), real=16, synthetic=12, test=80)


@pytest.fixture(scope="module")
def study(pictures, tmp_path_factory):
    out = finished_study(pictures, tmp_path_factory.mktemp("study"), seeds=[0, 1])
    return out, write_study_report(out)


def test_figures_equal_those_of_the_detections(study):
    _, report = study
    cells = {(cell.arm, cell.fraction): cell for cell in report.cells}
    assert len(cells) == 7
    assert len(report.runs) == 14
    for key, cell in cells.items():
        tp = [round((SKILL[key] + 2 * seed) / 100 * 60) for seed in (0, 1)]
        assert (cell.tp, cell.fp, cell.fn) == (np.mean(tp), 10, 60 - np.mean(tp))
        assert cell.recall == pytest.approx(np.mean(tp) / 60, abs=1e-6)
        assert cell.of_seeds["recall"] == pytest.approx([n / 60 for n in tp], abs=1e-6)
        low, high = cell.intervals["recall"]
        assert low < cell.recall < high


def test_a_difference_is_claimed_only_if_its_interval_excludes_0(study):
    _, report = study
    pairs = {(pair.first, pair.second): pair.measures["f1"] for pair in report.pairs}
    assert pairs["real at 25 %", "mixed at 25 %"].words.startswith("mixed at 25 % has a higher F1 than real at 25 %")
    assert pairs["real at 100 %", "synthetic"].words.startswith("synthetic has a lower F1 than real at 100 %")
    same = pairs["real at 100 %", "mixed at 100 %"]
    assert same.words.startswith("Between mixed at 100 % and real at 100 % no difference of F1 is shown")
    assert same.difference == 0


def test_worth_is_read_from_the_real_curve(study):
    _, report = study
    worth = {(one.name, one.measure): one for one in report.worth}
    # Recall of mixed at 25 % (4 photographs): 0.61; real has 0.51 with 8 and 0.81 with 16.
    found = worth["mixed at 25 %", "recall"]
    assert 4 < found.photographs < 12
    assert found.interval[0] <= found.photographs <= found.interval[1]
    assert "are worth" in found.words
    # At 100 % the two arms are equal, so nothing is claimed.
    assert not [key for key in worth if key[0] == "mixed at 100 %"]


@pytest.mark.parametrize(("real", "mixed"), [(0, 0), (50, 95)])
def test_without_a_shown_gain_of_photographs_there_is_no_worth(pictures, tmp_path, real, mixed):
    skill = {(arm, share): {"real": real, "mixed": mixed}[arm] for arm in ("real", "mixed") for share in (1.0, 0.25)}
    keys = {"seeds": [0], "arms": ["real", "mixed"], "fractions": [1.0, 0.25]}
    assert compare_study_runs(finished_study(pictures, tmp_path, skill=skill, **keys)).worth == []


def test_results_beyond_all_photographs_are_worth_an_open_number(pictures, tmp_path):
    skill = SKILL | {("real", 1.0): 55, ("mixed", 1.0): 98}
    keys = {"seeds": [0], "arms": ["real", "mixed"], "fractions": [1.0, 0.25]}
    found = compare_study_runs(finished_study(pictures, tmp_path, skill=skill, **keys)).worth
    (open_above,) = [one for one in found if (one.name, one.measure) == ("mixed at 100 %", "recall")]
    assert open_above.photographs is None
    assert "no upper bound" in open_above.words


def test_the_same_study_gives_the_same_report(pictures, tmp_path, capsys):
    reports = []
    for name in ("once", "again"):
        (tmp_path / name).mkdir()
        keys = {"seeds": [0, 1], "arms": ["real", "mixed"], "fractions": [1.0]}
        out = finished_study(pictures, tmp_path / name, **keys)
        assert main(["study", "report", str(out), "--json"]) == 0
        reports.append(json.loads(capsys.readouterr().out) | {"times": {}})
    assert reports[0] == reports[1]
    for name in ("over_photographs.png", "real_100.png"):
        assert len({(tmp_path / which / "out" / name).read_bytes() for which in ("once", "again")}) == 1


def test_an_unfinished_study_lists_what_is_missing(pictures, study, tmp_path):
    out = tmp_path / "part"
    shutil.copytree(study[0], out)
    gone = ["mixed-25-seed1", "synthetic-seed0", "synthetic-seed1"]
    for name in gone:
        (out / "runs" / name / "weights.pt").unlink()
    report = compare_study_runs(out)
    assert sorted(report.missing) == gone
    assert "synthetic-seed0</li>" in study_page(report, {})
    with pytest.raises(HulldownError, match=r"study\.json: no such file; name a folder of `hulldown study run`"):
        compare_study_runs(tmp_path)


def test_validation_photographs_choose_each_threshold_of_a_study_with_one_seed(pictures, tmp_path):
    make_dataset(tmp_path / "valid", 8, seed=7)
    keys = {"seeds": [0], "arms": ["real"], "fractions": [1.0, 0.5]}
    report = compare_study_runs(finished_study(pictures, tmp_path, valid=str(tmp_path / "valid"), **keys))
    assert report.study.threshold == "validation"
    # False positives have a score of 0.55 and true detections more, so the best threshold excludes the former.
    assert all(run.threshold > 0.55 and run.fp == 0 for run in report.runs)
    assert "With one seed" in report.sureness
    assert "best F1 on the validation photographs" in study_page(report, {})


def test_the_page_has_every_chart_and_fetches_nothing(study, browser):
    out, _ = study
    browser.get((out / "report.html").as_uri())
    headings = [one.text for one in browser.find_elements(By.TAG_NAME, "h2")]
    assert headings[0] == "Summary"
    assert {"Worth in photographs", "Pairs of arms", "Comparison with the paper"} <= set(headings)
    widths = browser.execute_script("return [...document.querySelectorAll('img.chart')].map((i) => i.naturalWidth)")
    assert len(widths) == len(list(out.glob("*.png")))
    assert min(widths) > 100
    folded = browser.find_element(By.TAG_NAME, "details")
    assert not folded.find_element(By.TAG_NAME, "table").is_displayed()
    folded.find_element(By.TAG_NAME, "summary").click()
    assert folded.find_element(By.TAG_NAME, "table").is_displayed()
    wide = browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")
    assert wide
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []


def test_charts_of_the_papers_own_figures():
    """This test checks that all is drawn, and the same twice; people looked at the charts."""
    for fraction, arms in PAPER_COLORS.items():
        cells = [ReportedCell(arm=arm, **dict(zip(PAPER_FIGURES, found, strict=True))) for arm, found in arms.items()]
        figure = arm_bar_chart(f"{100 * fraction:g} %", cells)
        bars = [bar.get_height() for axis in figure.axes for bar in axis.patches]
        assert [*arms["real"], *arms["mixed"]] == bars[6:12]
    assert chart_svg(figure) == chart_svg(arm_bar_chart(f"{100 * fraction:g} %", cells))
    f1 = {arm: [PAPER_COLORS[fraction][arm][2] for fraction in sorted(PAPER_COLORS)] for arm in ("real", "mixed")}
    cells = [
        ReportedCell(arm=arm, photographs=420 * fraction, f1=value, intervals={"f1": None}, of_seeds={"f1": [value]})
        for arm, values in f1.items()
        for fraction, value in zip(sorted(PAPER_COLORS), values, strict=True)
    ]
    figure = photograph_count_chart(cells, ["f1"])
    assert [line.get_ydata().tolist() for line in figure.axes[0].lines] == list(f1.values())
    assert figure_png(figure).startswith(b"\x89PNG")


def test_worth_of_the_papers_synthetic_images():
    """At 10 % (42 photographs) mixed reaches an F1 that real reaches between 42 and 105."""
    counts = np.array([21.0, 42, 105, 210, 420])
    curve = np.array([[0.32], [0.35], [0.70], [0.64], [0.76]])
    # Where the curve falls, it's taken as constant: 0.70 is reached with 105, 0.73 halfway to 420.
    wanted = {0.53: 42 * (105 / 42) ** (0.18 / 0.35), 0.70: 105, 0.73: 210 * 2**0.5, 0.80: np.inf, 0.16: 10.5, 0.0: 0}
    assert photographs_needed(counts, np.tile(curve, len(wanted)), np.array([*wanted])) == pytest.approx([*wanted.values()])


def test_an_interval_that_touches_0_shows_nothing():
    assert Estimate(0.1, np.array([0.01, 0.2])).excludes_zero
    assert not Estimate(0.1, np.array([0.0, 0.2])).excludes_zero
    assert not Estimate(0.1, np.array([np.nan, np.nan])).excludes_zero
