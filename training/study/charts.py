"""Charts of a study: the paper's Figures 5 to 9, and curves over the number of photographs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import BLUE, GREEN, INK, RED, SOFT, tidy
from hulldown.training.study.words import TITLES

COLORS = {
    "real": BLUE,
    "mixed": RED,
    "synthetic": GREEN,
    "matched": "#cc79a7",
    "balanced": "#e69f00",
    "pretrain": "#56b4e9",
    "loop": "#9467bd",
}
SPARE = ("#8c564b", "#7f7f7f", "#17becf", "#bcbd22")  # of named arms
PANELS = (("tp", "fp", "fn"), ("precision", "recall", "f1"), ("mean_iou",), ("mean_confidence",))
BARS = 0.8  # share of the width for the bars of one measure


def color_of(arm: str) -> str:
    """The color of an arm, the same in every chart; of a named arm by its name."""
    return COLORS.get(arm, SPARE[sum(arm.encode()) % len(SPARE)])


def beside(title: str, cells: Sequence[Mapping[str, Any]]) -> Figure:
    """Bars of arms in four panels, as in the paper's Figures 5 to 9.

    `cells` has a cell of report.json for each arm; missing values and None are unknown.
    """
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    axes = figure.subplots(1, len(PANELS), width_ratios=[len(keys) + 0.6 for keys in PANELS])
    for axis, keys in zip(axes, PANELS, strict=True):
        for k, cell in enumerate(cells):
            width = BARS / len(cells)
            _bars(axis, cell, keys, shift=(k - (len(cells) - 1) / 2) * width, width=width)
        axis.set_xticks(range(len(keys)), [TITLES[key] for key in keys])
        tidy(axis)
        axis.set_ylim(0.0, None if keys == PANELS[0] else 1.09)
        axis.set_xlim(-0.6, len(keys) - 0.4)
        axis.margins(y=0.12)
    figure.legend(
        *axes[0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside upper right", ncols=len(cells)
    )
    figure.suptitle(title, fontsize=10, color=INK)
    return figure


def _bars(axis: Axes, cell: Mapping[str, Any], keys: Sequence[str], *, shift: float, width: float) -> None:
    places = np.arange(len(keys)) + shift
    heights = [cell.get(key) or 0.0 for key in keys]
    axis.bar(places, heights, width * 0.92, color=color_of(cell["arm"]), label=cell["arm"])
    for place, key in zip(places, keys, strict=True):
        value, ends = cell.get(key), cell["intervals"].get(key)
        top = value
        if value is not None and ends is not None:
            axis.plot([place, place], ends, color=INK, linewidth=0.9)
            top = max(value, ends[1])
        text = "not\ngiven" if value is None else f"{value:.0f}" if axis.get_ylim()[1] > 2 else f"{value:.2f}"
        axis.annotate(
            text, (place, top or 0.0), (0, 2), textcoords="offset points", ha="center", va="bottom", fontsize=7,
            color=SOFT if value is None else INK,
        )  # fmt: skip


def over_photographs(cells: Sequence[Mapping[str, Any]], measures: Sequence[str]) -> Figure:
    """Each measure over the number of photographs, for every arm in cells of report.json.

    Bands are intervals, dots are seeds. An arm without photographs is a level line.
    """
    figure = Figure(figsize=(3.9 * len(measures), 3.7), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(measures)))
    for axis, measure in zip(axes, measures, strict=True):
        for arm in dict.fromkeys(cell["arm"] for cell in cells):
            color = color_of(arm)
            own = sorted((cell for cell in cells if cell["arm"] == arm), key=lambda cell: cell["photographs"])
            if not own:
                continue
            counts, values = (np.array([cell[key] for cell in own], dtype=float) for key in ("photographs", measure))
            low, high = np.array([cell["intervals"][measure] or [np.nan, np.nan] for cell in own]).T
            if counts[0] == 0:
                axis.axhspan(low[0], high[0], color=color, alpha=0.12, linewidth=0)
                axis.axhline(values[0], color=color, linestyle="--", linewidth=1.2, label=f"{arm} alone")
                continue
            axis.fill_between(counts, low, high, color=color, alpha=0.18, linewidth=0)
            axis.plot(counts, values, "o-", color=color, markersize=4, linewidth=1.5, label=arm)
            for cell in own:
                points = np.array(cell["of_seeds"][measure], dtype=float)
                if len(points) > 1:
                    places = [cell["photographs"]] * len(points)
                    axis.plot(places, points, ".", color=color, markersize=3, alpha=0.6)
        shown = sorted({float(cell["photographs"]) for cell in cells if cell["photographs"] > 0})
        axis.set_xscale("log")
        axis.set_xticks(shown, [f"{n:.0f}" for n in shown])
        axis.minorticks_off()
        axis.set(xlabel="photographs", title=TITLES[measure], ylim=(0.0, 1.0))
        axis.grid(axis="y", color="#e6e9ec", linewidth=0.7)
        tidy(axis)
    axes[0].legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def png(figure: Figure) -> bytes:
    """A figure as PNG, with the same bytes each time."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=150, metadata={"Software": None})
    return file.getvalue()
