"""A study's report for people, from the contents of report.json: charts, and a page."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from itertools import chain, groupby
from operator import attrgetter
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hulldown.base.arguments import AnyPath
from hulldown.base.files import replace_file
from hulldown.dataset.reports.charts import INK, SERIES_COLORS, SOFT, tidy_axes
from hulldown.dataset.reports.page import format_interval, format_number, render_page
from hulldown.training.study.arms import ARM_KINDS
from hulldown.training.study.results import COUNT_MEASURES, MEASURE_TITLES, RATIO_MEASURES
from hulldown.training.study.study_comparison import ReportedCell, StudyReport, compare_study_runs
from hulldown.training.subset import subset_name

CHART_MEASURES = ("ap50", "f1", "recall", "precision")
# The paper's precision, recall, and F1 (sections 3 and 4) by fraction and arm.
PAPER_COLORS = {
    0.05: {"real": (0.88, 0.20, 0.32), "mixed": (0.91, 0.41, 0.57)},
    0.1: {"real": (0.81, 0.23, 0.35), "mixed": (0.86, 0.38, 0.53)},
    0.25: {"real": (0.95, 0.55, 0.70), "mixed": (0.88, 0.74, 0.80)},
    0.5: {"real": (0.98, 0.47, 0.64), "mixed": (0.96, 0.53, 0.69)},
    1.0: {"real": (0.93, 0.64, 0.76), "mixed": (0.97, 0.48, 0.65)},
}
PAPER_FIGURES = ("precision", "recall", "f1")
SPARE_COLORS = ("#8c564b", "#7f7f7f", "#17becf", "#bcbd22")  # of named arms
CHART_PANELS = (("tp", "fp", "fn"), ("precision", "recall", "f1"), ("mean_iou",), ("mean_confidence",))
BARS_WIDTH_SHARE = 0.8  # for the bars of one measure


def study_charts(report: StudyReport) -> dict[str, tuple[str, Figure]]:
    """Return the charts of a report by name, with descriptions."""
    found = {}
    of_shares = sorted((cell for cell in report.cells if cell.fraction is not None), key=attrgetter("fraction"))
    for fraction, group in groupby(of_shares, attrgetter("fraction")):
        cells = list(group)
        title = f"{100 * fraction:.10g} % of the photographs ({cells[0].photographs:.0f})"
        words = f"{', '.join(cell.arm for cell in cells)} at {100 * fraction:g} % of the photographs"
        found[f"real_{subset_name(fraction)}"] = words, arm_bar_chart(title, cells)
    if report.cells:
        words = "AP50, F1, recall and precision of each arm over the number of photographs, with bands"
        found["over_photographs"] = words, photograph_count_chart(report.cells, CHART_MEASURES)
    return found


def study_page(report: StudyReport, charts: Mapping[str, tuple[str, Figure]]) -> str:
    """Return the report as HTML, with the charts of `study_charts`."""
    data = {
        "report": report,
        "charts": charts,
        "titles": MEASURE_TITLES,
        "figures": [
            [cell.name, *(format_number(getattr(cell, key), digits=0) for key in COUNT_MEASURES),
             *(format_interval(getattr(cell, key), cell.intervals[key]) for key in RATIO_MEASURES)]
            for cell in report.cells
        ],
        "pairs": [[pair.measures[key].words for key in CHART_MEASURES] for pair in report.pairs],
        "paper": _paper_rows(report),
    }  # fmt: skip
    return render_page("training/study/page.html", data)


def _paper_rows(report: StudyReport) -> list[list[str]]:
    cell_of = {(cell.fraction, cell.arm): cell for cell in report.cells}
    rows = []
    for fraction, arms in PAPER_COLORS.items():
        for arm, figures in arms.items():
            cell = cell_of.get((fraction, arm))
            own = (getattr(cell, key, None) for key in PAPER_FIGURES)
            pairs = [(format_number(value), format_number(here)) for value, here in zip(figures, own, strict=True)]
            rows.append([f"{arm} at {100 * fraction:g} %", *chain(*pairs)])
    return rows


def arm_color(arm: str) -> str:
    """Return an arm's color, the same in every chart; a named arm's is by its name."""
    return dict(zip(ARM_KINDS, SERIES_COLORS, strict=False)).get(arm, SPARE_COLORS[sum(arm.encode()) % len(SPARE_COLORS)])


def arm_bar_chart(title: str, cells: Sequence[ReportedCell]) -> Figure:
    """Draw bars of arms in four panels, as in the paper's Figures 5 to 9."""
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    axes = figure.subplots(1, len(CHART_PANELS), width_ratios=[len(keys) + 0.6 for keys in CHART_PANELS])
    for axis, keys in zip(axes, CHART_PANELS, strict=True):
        for k, cell in enumerate(cells):
            width = BARS_WIDTH_SHARE / len(cells)
            _draw_bars(axis, cell, keys, shift=(k - (len(cells) - 1) / 2) * width, width=width)
        axis.set_xticks(range(len(keys)), [MEASURE_TITLES[key] for key in keys])
        tidy_axes(axis)
        axis.set_ylim(0.0, None if keys == CHART_PANELS[0] else 1.09)
        axis.set_xlim(-0.6, len(keys) - 0.4)
        axis.margins(y=0.12)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside upper right", ncols=len(cells))
    figure.suptitle(title, fontsize=10, color=INK)
    return figure


def _draw_bars(axis: Axes, cell: ReportedCell, keys: Sequence[str], *, shift: float, width: float) -> None:
    places = np.arange(len(keys)) + shift
    heights = [getattr(cell, key) or 0.0 for key in keys]
    axis.bar(places, heights, width * 0.92, color=arm_color(cell.arm), label=cell.arm)
    for place, key in zip(places, keys, strict=True):
        value, ends = getattr(cell, key), cell.intervals.get(key)
        top = value
        if value is not None and ends is not None:
            axis.plot([place, place], ends, color=INK, linewidth=0.9)
            top = max(value, ends[1])
        text = "not\ngiven" if value is None else f"{value:.0f}" if axis.get_ylim()[1] > 2 else f"{value:.2f}"
        axis.annotate(
            text, (place, top or 0.0), (0, 2), textcoords="offset points", ha="center", va="bottom", fontsize=7,
            color=SOFT if value is None else INK,
        )  # fmt: skip


def photograph_count_chart(cells: Sequence[ReportedCell], measures: Sequence[str]) -> Figure:
    """Draw each measure over photographs: bands are intervals, dots seeds, level lines arms without photographs."""
    figure = Figure(figsize=(3.9 * len(measures), 3.7), layout="constrained")
    axes = figure.subplots(1, len(measures), squeeze=False)[0]
    for axis, measure in zip(axes, measures, strict=True):
        for arm in dict.fromkeys(cell.arm for cell in cells):
            color = arm_color(arm)
            own = sorted((cell for cell in cells if cell.arm == arm), key=attrgetter("photographs"))
            counts = np.array([cell.photographs for cell in own])
            values = np.array([getattr(cell, measure) for cell in own], dtype=float)
            low, high = np.array([cell.intervals[measure] or [np.nan, np.nan] for cell in own]).T
            if counts[0] == 0:
                axis.axhspan(low[0], high[0], color=color, alpha=0.12, linewidth=0)
                axis.axhline(values[0], color=color, linestyle="--", linewidth=1.2, label=f"{arm} alone")
                continue
            axis.fill_between(counts, low, high, color=color, alpha=0.18, linewidth=0)
            axis.plot(counts, values, "o-", color=color, markersize=4, linewidth=1.5, label=arm)
            for cell in own:
                points = np.array(cell.of_seeds[measure], dtype=float)
                if len(points) > 1:
                    places = [cell.photographs] * len(points)
                    axis.plot(places, points, ".", color=color, markersize=3, alpha=0.6)
        shown = sorted({float(cell.photographs) for cell in cells if cell.photographs > 0})
        axis.set_xscale("log")
        axis.set_xticks(shown, [f"{n:.0f}" for n in shown])
        axis.minorticks_off()
        axis.set(xlabel="photographs", title=MEASURE_TITLES[measure], ylim=(0.0, 1.0))
        axis.grid(axis="y", color="#e6e9ec", linewidth=0.7)
        tidy_axes(axis)
    axes[0].legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def figure_png(figure: Figure) -> bytes:
    """Return a figure as PNG; equal figures have equal bytes."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=150, metadata={"Software": None})
    return file.getvalue()


def write_study_report(study: AnyPath) -> StudyReport:
    """Compare the arms of a study.

    Reads a study, finished or not; writes report.html, report.json, and charts into it.

    Parameters
    ----------
    study
        The folder of `hulldown study run`.
    """
    study = Path(study)
    report = compare_study_runs(study)
    charts = study_charts(report)
    for name, (_, figure) in charts.items():
        replace_file(study / f"{name}.png", figure_png(figure))
    text = json.dumps(msgspec.to_builtins(report), indent=2, ensure_ascii=False)
    replace_file(study / "report.json", text.encode() + b"\n")
    replace_file(study / "report.html", study_page(report, charts).encode())
    return report
