"""Charts of an evaluation, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hulldown.dataset.reports.charts import BLUE, COLORS, GREEN, INK, RED, axes_of, colors, short, svg
from hulldown.training.evaluation.bins import BinFigures
from hulldown.training.evaluation.evaluate import Evaluation


def precision_recall(evaluations: Sequence[Evaluation]) -> bytes:
    """Precision over recall, with the operating points."""
    figure, axes = axes_of(5.4, 3.6)
    for one, color in zip(evaluations, colors(len(evaluations)), strict=True):
        name = short(one.predictions.name) if len(evaluations) > 1 else "all classes"
        axes.plot(one.curves.recall, one.curves.precision, marker_of(one.curves.recall), color=color, label=name)
        if len(evaluations) == 1:
            for c, (label, curve) in enumerate(zip(one.predictions.class_names, one.class_curves, strict=True)):
                color_c = COLORS[(c + 1) % len(COLORS)]
                line = marker_of(curve.recall)
                axes.plot(curve.recall, curve.precision, line, color=color_c, linewidth=0.9, label=short(label))
        at = np.searchsorted(-one.curves.threshold, -one.threshold.value, side="right") - 1
        if at >= 0:
            axes.plot(one.curves.recall[at], one.curves.precision[at], "o", color=color)
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02), title="precision over recall")
    axes.legend(fontsize=7, loc="lower left")
    return svg(figure)


def marker_of(values: np.ndarray) -> str:
    """The marker of a curve: a dot if it has one point."""
    return "-" if len(values) > 1 else "."


def over_thresholds(one: Evaluation) -> bytes:
    """Precision, recall and F1 over the confidence from which detections count."""
    figure, axes = axes_of(5.4, 3.6)
    for key, color in (("precision", BLUE), ("recall", GREEN), ("f1", RED)):
        label, values = "F1" if key == "f1" else key, getattr(one.curves, key)
        axes.plot(one.curves.threshold, values, marker_of(values), color=color, label=label)
    axes.axvline(one.threshold.value, color=INK, linewidth=0.8, linestyle=":")
    axes.set(xlabel="confidence threshold", ylim=(0, 1.02), title="figures over the threshold (dotted: as evaluated)")
    axes.legend(fontsize=7, loc="lower center")
    return svg(figure)


def losses(loss: Mapping[str, float]) -> bytes:
    """AP50 that fixing each cause alone would gain."""
    figure, axes = axes_of(5.4, 2.4)
    names = list(loss)[::-1]
    axes.barh(names, [100.0 * loss[name] for name in names], color=RED, height=0.6)
    axes.set(xlabel="gain of AP50 from fixing it alone, points", title="loss of AP50 by cause")
    return svg(figure)


def recall_bins(found: BinFigures, overall: float) -> bytes:
    """Recall in the bins of a field, with intervals and numbers of labels."""
    rows = np.flatnonzero(found.labels > 0)[::-1]
    figure, axes = axes_of(3.75, 0.7 + 0.24 * len(rows))
    places = np.arange(len(rows))
    recall, ends = found.recall[rows], found.recall_interval[:, rows]
    axes.barh(places, recall, color=BLUE, height=0.62, alpha=0.75)
    axes.errorbar(
        recall, places, xerr=np.clip(np.stack([recall - ends[0], ends[1] - recall]), 0, None),
        fmt="none", ecolor=INK, elinewidth=1, capsize=2,
    )  # fmt: skip
    axes.axvline(overall, color=RED, linewidth=0.9, linestyle="--")
    axes.set_yticks(places, [f"{short(found.field.bins[b])} (n {found.labels[b]})" for b in rows])
    axes.set(xlim=(0, 1.02), title=f"recall by {found.field.title}")
    return svg(figure)
