"""Charts of a study: the paper's Figures 5 to 9, and the one that they lack, over how many photographs there are."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import BLUE, GREEN, INK, RED, SOFT, tidy
from hulldown.training.study.words import TITLES

COLOURS = {
    "real": BLUE,
    "mixed": RED,
    "synthetic": GREEN,
    "matched": "#cc79a7",
    "balanced": "#e69f00",
    "pretrain": "#56b4e9",
}
PANELS = (("tp", "fp", "fn"), ("precision", "recall", "f1"), ("mean_iou",), ("mean_confidence",))
BARS = 0.8  # of the room that the bars of one measure may take
Value = float | int | None
Ends = Sequence[float | None] | None


@dataclass(frozen=True, eq=False, slots=True)
class Line:
    """An arm over the number of photographs.

    Parameters
    ----------
    arm
        Which.
    photographs
        (k,) rising; one that is 0 is of an arm that uses none, and is drawn as a level line.
    values, low, high
        (k,) a measure and its interval; nan where there is none.
    points
        Of each, the values of its seeds.
    """

    arm: str
    photographs: Float[np.ndarray, " k"]
    values: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    points: Sequence[Sequence[float]]


def beside(title: str, arms: Mapping[str, Mapping[str, tuple[Value, Ends]]]) -> Figure:
    """Arms beside each other in four panels, as the paper's Figures 5 to 9.

    Parameters
    ----------
    title
        Of the figure.
    arms
        Arm -> measure -> its value and its interval, None where it is not known.
    """
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    axes = figure.subplots(1, len(PANELS), width_ratios=[len(keys) + 0.6 for keys in PANELS])
    for axis, keys in zip(axes, PANELS, strict=True):
        for k, (arm, found) in enumerate(arms.items()):
            width = BARS / len(arms)
            values = [found.get(key, (None, None)) for key in keys]
            _bars(axis, arm, values, shift=(k - (len(arms) - 1) / 2) * width, width=width)
        axis.set_xticks(range(len(keys)), [TITLES[key] for key in keys])
        tidy(axis)
        axis.set_ylim(0.0, None if keys == PANELS[0] else 1.09)
        axis.set_xlim(-0.6, len(keys) - 0.4)
        axis.margins(y=0.12)
    figure.legend(
        *axes[0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside upper right", ncols=len(arms)
    )
    figure.suptitle(title, fontsize=10, color=INK)
    return figure


def _bars(axis: Axes, arm: str, values: Sequence[tuple[Value, Ends]], *, shift: float, width: float) -> None:
    places = np.arange(len(values)) + shift
    heights = [0.0 if value is None else value for value, _ in values]
    axis.bar(places, heights, width * 0.92, color=COLOURS[arm], label=arm)
    for place, (value, ends) in zip(places, values, strict=True):
        top = value
        if value is not None and ends is not None and ends[0] is not None and ends[1] is not None:
            axis.plot([place, place], [ends[0], ends[1]], color=INK, linewidth=0.9)
            top = max(value, ends[1])
        said = "not\ngiven" if value is None else f"{value:.0f}" if axis.get_ylim()[1] > 2 else f"{value:.2f}"
        axis.annotate(
            said, (place, top or 0.0), (0, 2), textcoords="offset points", ha="center", va="bottom", fontsize=7,
            color=SOFT if value is None else INK,
        )  # fmt: skip


def over_photographs(panels: Mapping[str, Sequence[Line]]) -> Figure:
    """Each measure over the number of photographs, for every arm, with bands.

    Parameters
    ----------
    panels
        Measure -> its lines.
    """
    figure = Figure(figsize=(3.9 * len(panels), 3.7), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(panels)))
    for axis, (measure, lines) in zip(axes, panels.items(), strict=True):
        for line in lines:
            colour = COLOURS[line.arm]
            if line.photographs[0] == 0:
                axis.axhspan(line.low[0], line.high[0], color=colour, alpha=0.12, linewidth=0)
                axis.axhline(line.values[0], color=colour, linestyle="--", linewidth=1.2, label=f"{line.arm} alone")
                continue
            axis.fill_between(line.photographs, line.low, line.high, color=colour, alpha=0.18, linewidth=0)
            axis.plot(line.photographs, line.values, "o-", color=colour, markersize=4, linewidth=1.5, label=line.arm)
            for count, points in zip(line.photographs, line.points, strict=True):
                if len(points) > 1:
                    axis.plot([count] * len(points), points, ".", color=colour, markersize=3, alpha=0.6)
        counts = sorted({float(n) for line in lines for n in line.photographs if n > 0})
        axis.set_xscale("log")
        axis.set_xticks(counts, [f"{n:.0f}" for n in counts])
        axis.minorticks_off()
        axis.set(xlabel="photographs", title=TITLES[measure], ylim=(0.0, 1.0))
        axis.grid(axis="y", color="#e6e9ec", linewidth=0.7)
        tidy(axis)
    axes[0].legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def png(figure: Figure) -> bytes:
    """The same bytes for the same chart."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=150, metadata={"Software": None})
    return file.getvalue()
