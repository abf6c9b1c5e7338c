"""Charts about a dataset, as SVG."""

from __future__ import annotations

from collections import Counter

import numpy as np
from jaxtyping import Float, Shaped
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from dataset.charts import BLUE, INK, RED, axes_of, short, svg

BINS = 24
MOST_NAMES = 12
MOST_PLACES = 2_000  # dots on a map: more cannot be told apart


def histogram(title: str, values: Float[np.ndarray, " n"], *, log: bool = False) -> bytes:
    """How often a number occurs; what is not known is left out."""
    figure, axes = axes_of(3.6, 2.2)
    known = values[np.isfinite(values) & ((values > 0) | (not log))]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    if log and low < high:
        edges = np.geomspace(low, high, BINS + 1)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    axes.hist(np.clip(known, edges[0], edges[-1]), bins=edges.tolist(), color=BLUE)
    axes.set(title=title)
    return svg(figure)


def azimuths(values: Float[np.ndarray, " n"]) -> bytes:
    """From which side targets are seen, in degrees to the left of straight ahead."""
    figure, axes = axes_of(3.6, 2.2)
    axes.hist(values[np.isfinite(values)], bins=np.linspace(-180.0, 180.0, BINS + 1).tolist(), color=BLUE)
    axes.set_xticks([-180, -90, 0, 90, 180], ["rear", "right", "front", "left", "rear"])
    axes.set(title="side seen")
    return svg(figure)


def places_in_pictures(centres: Float[np.ndarray, "n 2"]) -> bytes:
    """Where the middles of labels lie, as shares of width and height."""
    figure, axes = axes_of(3.6, 2.2)
    counts, _, _ = np.histogram2d(centres[:, 1], centres[:, 0], bins=(14, 24), range=((0, 1), (0, 1)))
    axes.imshow(counts, extent=(0, 1, 1, 0), aspect="auto", cmap="Blues", interpolation="nearest")
    axes.set(title="middles of labels in the picture", xticks=[], yticks=[])
    return svg(figure)


def shares(title: str, names: Shaped[np.ndarray, " n"]) -> bytes:
    """How often each name occurs, the most frequent first."""
    counts = Counter(name for name in names.tolist() if name).most_common()
    shown = counts[:MOST_NAMES]
    if rest := counts[MOST_NAMES:]:
        shown.append((f"{len(rest)} others", sum(n for _, n in rest)))
    figure, axes = axes_of(3.6, 0.7 + 0.24 * max(len(shown), 3))
    axes.barh([short(name) for name, _ in shown][::-1], [n for _, n in shown][::-1], color=BLUE, height=0.62)
    axes.set(title=title)
    return svg(figure)


def place_map(name: str, cameras: Float[np.ndarray, "n 2"], vehicles: Float[np.ndarray, "n 2"]) -> bytes:
    """A scenery from above: each camera, and a line to the vehicle that it looks at, in metres."""
    figure, axes = axes_of(4.6, 4.2)
    some = np.unique(np.linspace(0, len(cameras) - 1, min(MOST_PLACES, len(cameras))).astype(int))
    cameras, vehicles = cameras[some], vehicles[some]
    seen = np.isfinite(vehicles).all(axis=1)
    ends = np.stack([cameras[seen], vehicles[seen], np.full((seen.sum(), 2), np.nan)], axis=1).reshape(-1, 2)
    axes.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=0.5, alpha=0.35)
    axes.plot(vehicles[seen, 0], vehicles[seen, 1], "o", color=RED, markersize=2.5)
    axes.plot(cameras[~seen, 0], cameras[~seen, 1], "x", color=INK, markersize=3)
    axes.set(title=f"{short(name)} ({len(cameras):,} images)", aspect="equal")
    return svg(figure)
