"""Colors and axes that all charts share, and the charts of a dataset."""

from __future__ import annotations

import io
from collections import Counter

import numpy as np
from jaxtyping import Float, Shaped
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from hulldown.base.indices import even_sample

INK, SOFT, BLUE, RED, GREEN = "#1d2126", "#9aa3ab", "#0072b2", "#d55e00", "#009e73"
SERIES_COLORS = (BLUE, RED, GREEN, "#cc79a7", "#e69f00", "#56b4e9")  # color-blind readers can tell them apart
MAX_NAME_CHARACTERS = 24  # beside an axis
HISTOGRAM_BINS = 24
MAX_CHART_NAMES = 12
MAX_MAP_DOTS = 2_000  # more would overlap


def make_figure_and_axes(title: str, width: float = 3.6, height: float = 2.2) -> tuple[Figure, Axes]:
    """Return the axes of a chart; its size is in inches of 100 pixels."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.set_title(title)
    tidy_axes(axes)
    return figure, axes


def tidy_axes(axes: Axes) -> None:
    """Remove the top and right side and lighten the lines of a chart."""
    axes.tick_params(labelsize=8, colors=INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(SOFT)


def shorten_and_escape_name(name: str) -> str:
    """Shorten a name, and escape dollar signs, which would start mathematics."""
    return (name if len(name) <= MAX_NAME_CHARACTERS else f"{name[: MAX_NAME_CHARACTERS - 1]}…").replace("$", r"\$")


def chart_svg(figure: Figure) -> bytes:
    """Return a chart as SVG; equal charts have equal bytes."""
    file = io.BytesIO()
    for axes in figure.axes:
        axes.title.set_fontsize(9)
        axes.xaxis.label.set_fontsize(8)
        axes.yaxis.label.set_fontsize(8)
    with rc_context({"svg.hashsalt": "hulldown", "svg.fonttype": "path"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return file.getvalue()


def histogram_chart(title: str, values: Float[np.ndarray, " n"], *, log: bool = False) -> Figure:
    """Draw a histogram of the known numbers."""
    figure, axes = make_figure_and_axes(title)
    known = values[np.isfinite(values) & ((values > 0) | (not log))]
    axes.hist(known, bins=_set_x_scale_and_bin_edges(axes, known, log=log), color=BLUE)
    return figure


def comparison_histogram_chart(
    title: str, own: Float[np.ndarray, " n"], photographs: Float[np.ndarray, " m"], *, log: bool = False
) -> Figure:
    """Draw histograms of a dataset (filled) and of photographs (a line) in the same bins."""
    figure, axes = make_figure_and_axes(title)
    edges = _set_x_scale_and_bin_edges(axes, np.concatenate([own, photographs]), log=log)
    weights = [np.full(len(values), 100.0 / len(values)) for values in (own, photographs)]
    axes.hist(own, edges, weights=weights[0], color=BLUE, alpha=0.55, label="this dataset")
    axes.hist(photographs, edges, weights=weights[1], histtype="step", color=RED, linewidth=1.6, label="photographs")
    axes.set(ylabel="%")
    axes.legend(fontsize=7, frameon=False)
    return figure


def _set_x_scale_and_bin_edges(axes: Axes, values: Float[np.ndarray, " n"], *, log: bool) -> list[float]:
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if log and 0.0 < low < high:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        return [low, *np.geomspace(low, high, HISTOGRAM_BINS + 1)[1:-1].tolist(), high]
    return np.linspace(low, high if high > low else low + 1.0, HISTOGRAM_BINS + 1).tolist()


def azimuth_chart(values: Float[np.ndarray, " n"]) -> Figure:
    """Draw a histogram of the side that targets are seen from, in degrees counterclockwise from straight ahead."""
    figure, axes = make_figure_and_axes("side seen")
    axes.hist(values[np.isfinite(values)], bins=np.linspace(-180.0, 180.0, HISTOGRAM_BINS + 1).tolist(), color=BLUE)
    axes.set_xticks([-180, -90, 0, 90, 180], ["rear", "right", "front", "left", "rear"])
    return figure


def label_position_chart(centers: Float[np.ndarray, "n 2"]) -> Figure:
    """Draw the centers of labels, in shares of width and height."""
    figure, axes = make_figure_and_axes("label positions")
    counts, _, _ = np.histogram2d(centers[:, 1], centers[:, 0], bins=(14, 24), range=((0, 1), (0, 1)))
    axes.imshow(counts, extent=(0, 1, 1, 0), aspect="auto", cmap="Blues", interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    return figure


def name_count_chart(title: str, names: Shaped[np.ndarray, " n"]) -> Figure:
    """Draw the frequency of each name, most frequent on top."""
    counts = Counter(name for name in names.tolist() if name).most_common()
    if rest := counts[MAX_CHART_NAMES:]:
        counts[MAX_CHART_NAMES:] = [(f"{len(rest)} others", sum(n for _, n in rest))]
    figure, axes = make_figure_and_axes(title, 3.6, 0.7 + 0.24 * max(len(counts), 3))
    axes.barh(range(len(counts)), [n for _, n in counts], color=BLUE, height=0.62)
    axes.set_yticks(range(len(counts)), [shorten_and_escape_name(name) for name, _ in counts])
    axes.invert_yaxis()
    return figure


def camera_map_chart(name: str, cameras: Float[np.ndarray, "n 2"], vehicles: Float[np.ndarray, "n 2"]) -> Figure:
    """Draw a map of a scenery: each camera with a line to its target, in meters."""
    figure, axes = make_figure_and_axes(f"{shorten_and_escape_name(name)} ({len(cameras):,} images)", 4.6, 4.2)
    some = even_sample(len(cameras), MAX_MAP_DOTS)
    cameras, vehicles = cameras[some], vehicles[some]
    seen = np.isfinite(vehicles).all(axis=1)
    ends = np.stack([cameras[seen], vehicles[seen], np.full((seen.sum(), 2), np.nan)], axis=1).reshape(-1, 2)
    axes.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=0.5, alpha=0.35)
    axes.plot(vehicles[seen, 0], vehicles[seen, 1], "o", color=RED, markersize=2.5)
    axes.plot(cameras[~seen, 0], cameras[~seen, 1], "x", color=INK, markersize=3)
    axes.set_aspect("equal")
    return figure
