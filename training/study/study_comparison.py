"""The comparison of a study's finished runs: the contents of report.json, rounded; undefined values are None."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec import Struct

from hulldown.base.errors import HulldownError
from hulldown.base.terminal import track_items
from hulldown.training.detectors.detector import read_run
from hulldown.training.evaluation.detector_report import Ends, rounded_json
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.study.results import (
    COUNT_MEASURES,
    MEASURE_TITLES,
    RATIO_MEASURES,
    Cell,
    Equivalent,
    Estimate,
    cell_pairs_to_compare,
    equivalent_photographs,
    estimate_measure,
    evaluate_run,
    group_runs_into_cells,
    interval_ends_or_none,
)
from hulldown.training.study.study_folder import RUNS_NAME, Study, is_run_finished, planned_study_runs, read_study

WORTH_BY = ("ap50", "f1", "recall")


class StudyFacts(Struct, frozen=True, kw_only=True):
    """What a study compared; `datasets` and `train` are parts of study.json."""

    classes: list[str]
    datasets: dict[str, dict[str, object]]
    arms: list[str]
    fractions: list[float]
    seeds: list[int]
    iou: float
    threshold: float | str  # a score, or how each run's is chosen
    train: dict[str, object]
    runs: int


class ReportedCell(Struct, frozen=True, kw_only=True):
    """A `Cell` in report.json: means over seeds, and each measure's interval and values."""

    arm: str
    fraction: float | None = None
    name: str = ""
    photographs: float = 0.0
    seeds: list[int] = []
    tp: float | None = None
    fp: float | None = None
    fn: float | None = None
    precision: float | None = None
    recall: float | None = None
    f1: float | None = None
    mean_iou: float | None = None
    mean_confidence: float | None = None
    ap50: float | None = None
    ap: float | None = None
    intervals: dict[str, list[float] | None] = {}
    of_seeds: dict[str, list[float | None]] = {}


class ReportedDifference(Struct, frozen=True):
    """The difference of two cells by a measure."""

    difference: float | None
    interval: list[float] | None
    words: str


class ReportedPair(Struct, frozen=True):
    """A pair of cells, compared by each measure."""

    first: str
    second: str
    fraction: float | None
    measures: dict[str, ReportedDifference]


class ReportedWorth(Struct, frozen=True):
    """The worth of a cell's synthetic images; None: more photographs than there are."""

    arm: str
    name: str
    fraction: float | None
    measure: str
    photographs: float | None
    interval: Ends
    words: str


class ReportedRun(Struct, frozen=True, kw_only=True):
    """A finished run in report.json, and its figures."""

    name: str
    arm: str
    fraction: float | None
    seed: int
    photographs: int
    drawn: dict[str, int]
    threshold: float
    tp: float
    fp: float
    fn: float
    precision: float | None
    recall: float | None
    f1: float | None
    mean_iou: float | None
    mean_confidence: float | None
    ap50: float | None
    ap: float | None


class StudyReport(Struct, frozen=True, kw_only=True):
    """The contents of report.json. All but `missing` and `times` is reproducible from detections and labels."""

    study: StudyFacts
    summary: list[str]
    sureness: str
    cells: list[ReportedCell]
    pairs: list[ReportedPair]
    worth: list[ReportedWorth]
    runs: list[ReportedRun]
    missing: list[str]  # runs that aren't finished
    times: dict[str, float | None]  # seconds


def compare_study_runs(study: Path | str) -> StudyReport:
    """Compare the finished runs of a study."""
    study = Path(study)
    known = read_study(study)
    planned = planned_study_runs(known.config)
    finished = [run for run in planned if is_run_finished(study, known, run)]
    if not finished:
        raise HulldownError("no run is finished", path=study, remedy="run `hulldown study run` first")
    config, folders = known.config, {run.name: study / RUNS_NAME / run.name for run in finished}
    trained = {name: read_run(folder) for name, folder in folders.items()}
    drawn = {name: {key: source.drawn for key, source in run.sources.items()} for name, run in trained.items()}
    labels = {which: read_labels(known.datasets[which].folder) for which in known.judged_dataset_names}
    runs = [
        evaluate_run(
            run, labels, {which: folders[run.name] / f"{which}.json" for which in labels},
            photographs=trained[run.name].sources["real"].images if "real" in drawn[run.name] else 0,
            threshold=config.threshold, iou=config.iou,
        )
        for run in track_items("evaluating", finished, len(finished))
    ]  # fmt: skip
    found = group_runs_into_cells(runs)
    compared, real = cell_pairs_to_compare(found), [cell for cell in found if cell.arm == "real"]
    records = [_pair_for_report(first, second) for first, second in compared]
    summary = [record.measures["ap50"].words for record in records]
    largest = max(real, key=lambda cell: cell.photographs, default=None)
    if largest is not None and (reached := estimate_measure(largest, "ap50").value) < 0.5:
        summary.append(
            f"{largest.name} reaches an AP50 of {reached:.2f} only. A study whose best photographs teach "
            "so little can't show the worth of synthetic images. Use a larger budget, or clearer pictures."
        )
    return StudyReport(
        study=_study_facts(known, len(planned)),
        summary=summary,
        sureness=interval_note(known, len(records) * len(RATIO_MEASURES)),
        cells=[_cell_for_report(cell) for cell in found],
        pairs=records,
        worth=[
            ReportedWorth(
                cell.arm, cell.name, rounded_json(cell.fraction), measure, rounded_json(one.photographs),
                rounded_json(one.interval),
                worth_words(cell.name, measure, one),
            )
            for cell in found
            for measure in WORTH_BY
            if cell.arm != "real" and (one := equivalent_photographs(real, cell, measure)) is not None
        ],
        runs=[
            ReportedRun(
                name=one.run.name, arm=one.run.arm, fraction=rounded_json(one.run.fraction), seed=one.run.seed,
                photographs=one.photographs, drawn=drawn[one.run.name],
                threshold=rounded_json(one.evaluation.threshold.value), **rounded_json(one.values),
            )
            for one in runs
        ],
        missing=[run.name for run in planned if run not in finished],
        times={name: rounded_json(run.figures.seconds) for name, run in trained.items()},
    )  # fmt: skip


def _study_facts(study: Study, runs: int) -> StudyFacts:
    config = study.config
    return StudyFacts(
        classes=list(study.classes),
        datasets={name: one.model_dump(mode="json", exclude={"folder"}) for name, one in study.datasets.items()},
        arms=[arm.name for arm in config.named_arms],
        **rounded_json(config.model_dump(include={"fractions", "seeds", "iou"})),
        threshold=rounded_json(config.threshold or ("count" if config.valid is None else "validation")),
        train=rounded_json(config.train.model_dump(mode="json", exclude={"seed", "weights"})),
        runs=runs,
    )


def _cell_for_report(cell: Cell) -> ReportedCell:
    seeds, estimates = sorted(cell.judged), {key: estimate_measure(cell, key) for key in RATIO_MEASURES}
    return ReportedCell(
        arm=cell.arm,
        fraction=rounded_json(cell.fraction),
        name=cell.name,
        photographs=rounded_json(cell.photographs),
        seeds=seeds,
        **{key: rounded_json(np.mean([cell.judged[seed].values[key] for seed in seeds])) for key in COUNT_MEASURES},
        **{key: rounded_json(one.value) for key, one in estimates.items()},
        intervals={key: rounded_json(interval_ends_or_none(one.ends)) for key, one in estimates.items()},
        of_seeds={key: [rounded_json(cell.judged[seed].values[key]) for seed in seeds] for key in RATIO_MEASURES},
    )


def _pair_for_report(first: Cell, second: Cell) -> ReportedPair:
    measures = {
        key: ReportedDifference(
            rounded_json(one.value), rounded_json(interval_ends_or_none(one.ends)), difference_words(first, second, key, one)
        )
        for key, one in ((key, estimate_measure(second, key, minus=first)) for key in RATIO_MEASURES)
    }
    return ReportedPair(first.name, second.name, rounded_json(second.fraction), measures)


def difference_words(first: Cell, second: Cell, measure: str, found: Estimate) -> str:
    """Return a sentence about a pair of arms by one measure; `found` is second minus first."""
    title = MEASURE_TITLES[measure]
    if np.isnan(found.value):
        return f"{second.name} minus {first.name}: {title} is undefined without detections."
    if np.isnan(found.ends).any():
        return f"{second.name} minus {first.name}: {title} {found.value:+.3f}, with too few test positions for an interval."
    ends = f"{found.value:+.3f} ({found.ends[0]:+.3f} to {found.ends[1]:+.3f})"
    if found.excludes_zero:
        how = "higher" if found.ends[0] > 0 else "lower"
        return f"{second.name} has a {how} {title} than {first.name}: {ends}."
    return (
        f"Between {second.name} and {first.name} no difference of {title} is shown: {ends}. {second.name} may "
        f"be {abs(found.ends[0]):.3f} worse or {abs(found.ends[1]):.3f} better."
    )


def worth_words(name: str, measure: str, found: Equivalent) -> str:
    """Return a sentence about the worth of a cell's synthetic images in photographs."""
    title = MEASURE_TITLES[measure]
    if np.isinf(found.photographs) and found.most <= 0:
        return f"By {title}, {name} is better than all photographs alone, so its worth has no upper bound."
    if np.isinf(found.photographs):
        much = f"more than the {found.most:.0f} further photographs"
    elif found.photographs < 0:
        much = f"minus {-found.photographs:.0f} photographs: fewer photographs alone are as good"
    else:
        much = f"{found.photographs:.0f} photographs"
    ends = [f"{end:.0f}" if np.isfinite(end) else f"more than {found.most:.0f}" for end in found.interval]
    interval = " to ".join(dict.fromkeys(ends))
    return f"By {title} the synthetic images of {name} are worth {much} (95 % interval: {interval})."


def interval_note(study: Study, compared: int) -> str:
    """Return a note on the intervals' meaning; `compared` intervals are of differences."""
    seeds, images = len(study.config.seeds), study.datasets["test"].images
    trainings = (
        "With one seed, they don't cover other trainings." if seeds == 1 else f"They include the spread of the {seeds} seeds."
    )
    note = f"Intervals have 95 % confidence, from resampling the positions in the {images} test pictures. {trainings}"
    if not compared:
        return note
    return (
        f"{note} Of {compared} differences with such intervals, about {max(1, round(0.05 * compared))} would exclude "
        "0 by chance alone."
    )
