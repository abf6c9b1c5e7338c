"""What charts of reports share: their colours, their axes, and SVG that is the same for the same chart."""

from __future__ import annotations

import io

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, SOFT, BLUE, RED, GREEN = "#1d2126", "#9aa3ab", "#0072b2", "#d55e00", "#009e73"
COLOURS = (BLUE, RED, GREEN, "#cc79a7", "#e69f00", "#56b4e9")
LONGEST = 24  # characters of a name beside an axis


def axes_of(width: float, height: float) -> tuple[Figure, Axes]:
    """A chart of so many inches, at 100 pixels an inch."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.tick_params(labelsize=8, colors=INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(SOFT)
    return figure, axes


def colours(count: int) -> list[str]:
    """So many colours, told apart by colour-blind readers too."""
    return [COLOURS[k % len(COLOURS)] for k in range(count)]


def short(name: str) -> str:
    """A name that leaves room for the chart, and is drawn as it is: no mathematics between dollars."""
    return (name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…").replace("$", r"\$")


def svg(figure: Figure) -> bytes:
    """The same bytes for the same chart."""
    file = io.BytesIO()
    for axes in figure.axes:
        axes.title.set_fontsize(9)
        axes.xaxis.label.set_fontsize(8)
        axes.yaxis.label.set_fontsize(8)
    with rc_context({"svg.hashsalt": "hulldown", "svg.fonttype": "path"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return file.getvalue()
