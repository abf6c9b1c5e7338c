"""What a plan holds, in numbers a person can act on: counts, rejections, sizes, histograms; as tables and a picture."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int
from rich.markup import escape
from rich.table import Table

from annotate.sheets import SOFTWARE, refuse_foreign
from camera.weather_kinds import KINDS
from geometry.files import replacing
from placement.rejection import Rejection
from planning.paint import OWN
from planning.row import LeftOut, Row
from planning.tally import AIMING, BY_KEY, PLACING

# COCO's classes of size, by area in square pixels.
SIZES = {"small": 32.0**2, "medium": 96.0**2, "large": math.inf}
_BARS = " ▁▂▃▄▅▆▇█"


@dataclass(eq=False, slots=True)
class Histogram:
    """Counts of one quantity in fixed bins, so that memory does not grow with the plan.

    Parameters
    ----------
    title
        What is counted, with its unit.
    edges
        (b + 1,) of the bins; what lies outside counts in the first or last bin.
    counts
        (b,) values in each bin.
    lowest, highest, total
        Of the values themselves.
    """

    title: str
    edges: Float[np.ndarray, " b_plus_1"]
    counts: Int[np.ndarray, " b"]
    lowest: float = math.inf
    highest: float = -math.inf
    total: float = 0.0

    def add(self, values: Float[np.ndarray, " n"]) -> None:
        """Count some values."""
        if not len(values):
            return
        bins = np.clip(np.searchsorted(self.edges, values, side="right") - 1, 0, len(self.counts) - 1)
        self.counts += np.bincount(bins, minlength=len(self.counts))
        self.lowest = min(self.lowest, float(values.min()))
        self.highest = max(self.highest, float(values.max()))
        self.total += float(values.sum())

    @property
    def mean(self) -> float:
        """Mean of the values; nan without any."""
        n = int(self.counts.sum())
        return self.total / n if n else math.nan

    def bars(self, width: int = 24) -> str:
        """The occupied bins as a line of blocks."""
        used = np.flatnonzero(self.counts)
        if not len(used):
            return ""
        counts = self.counts[used[0] : used[-1] + 1]
        groups = [int(part.sum()) for part in np.array_split(counts, min(width, len(counts)))]
        return "".join(_BARS[math.ceil(8 * n / max(groups))] for n in groups)

    def to_json(self) -> dict[str, Any]:
        """Edges, counts and extremes."""
        some = bool(self.counts.any())
        return {
            "edges": self.edges.tolist(),
            "counts": self.counts.tolist(),
            "lowest": self.lowest if some else None,
            "highest": self.highest if some else None,
            "mean": self.mean if some else None,
        }


def _histogram(title: str, edges: Float[np.ndarray, " b_plus_1"]) -> Histogram:
    return Histogram(title, edges, np.zeros(len(edges) - 1, dtype=np.int64))


def _histograms() -> dict[str, Histogram]:
    return {
        "slope_deg": _histogram("slope of the vehicle (degrees)", np.linspace(0.0, 90.0, 91)),
        "distance_m": _histogram("distance of the camera (m)", np.logspace(0.0, 4.0, 65)),
        "elevation_deg": _histogram("camera above the vehicle's foot (degrees)", np.linspace(-90.0, 90.0, 91)),
        "visible_fraction": _histogram("visible fraction", np.linspace(0.0, 1.0, 21)),
        "truncated_fraction": _histogram("truncated fraction", np.linspace(0.0, 1.0, 21)),
        "exposure_ev": _histogram("exposure (EV)", np.linspace(-32.0, 32.0, 129)),
        "air_contrast": _histogram("contrast that the air leaves, where it is not clear", np.linspace(0.0, 1.0, 21)),
        "box_px": _histogram("box size (root of its area, pixels)", np.logspace(0.0, 4.0, 65)),
    }


@dataclass(eq=False, slots=True)
class Summary:
    """Counts over a plan's images; classes, sizes and histograms are those of targets, which backgrounds have not.

    Parameters
    ----------
    images, positions
        How many.
    vehicles
        Images of each (class, vehicle).
    sizes
        Images of each (class, COCO size).
    backgrounds
        Images without a target, by the distractor that stands in its place; "" where nothing does.
    companions, distractors, sceneries, hdris
        How often each occurs; a distractor in a target's place is counted with the backgrounds.
    paints
        Coats of paint on all vehicles in the images, by colour; "own" where the file's own is kept or turned.
    labels
        Full and ignored labels, those of targets included.
    rejected
        Tries that were not taken, by reason.
    weather
        Images of each kind of weather, "clear" among them.
    open_sky
        Images of rain or snow under an HDRI that the config does not call overcast.
    no_room
        Companions that found no room and were left out, counted once a position.
    left_out
        Vehicles that are not planned on a scenery.
    overcast
        Whether the config says which HDRIs are overcast.
    histograms
        By key of the plan, or of what follows from its poses.
    """

    images: int = 0
    positions: int = 0
    vehicles: Counter[tuple[str, str]] = field(default_factory=Counter)
    sizes: Counter[tuple[str, str]] = field(default_factory=Counter)
    backgrounds: Counter[str] = field(default_factory=Counter)
    companions: Counter[str] = field(default_factory=Counter)
    distractors: Counter[str] = field(default_factory=Counter)
    paints: Counter[str] = field(default_factory=Counter)
    labels: Counter[str] = field(default_factory=Counter)
    sceneries: Counter[str] = field(default_factory=Counter)
    hdris: Counter[str] = field(default_factory=Counter)
    rejected: Counter[Rejection] = field(default_factory=Counter)
    weather: Counter[str] = field(default_factory=Counter)
    open_sky: int = 0
    no_room: int = 0
    left_out: tuple[LeftOut, ...] = ()
    overcast: bool = False
    histograms: dict[str, Histogram] = field(default_factory=_histograms)

    def add(self, rows: list[Row]) -> None:
        """Count some rows."""
        if not rows:
            return
        for row in rows:
            if row.background:
                self.backgrounds["" if row.empty else row.target.vehicle] += 1
            else:
                box, category = row.target.bbox, str(row.target.category)
                assert box is not None  # a target has one
                size = next(name for name, limit in SIZES.items() if box.width * box.height < limit)
                self.vehicles[category, row.target.vehicle] += 1
                self.sizes[category, size] += 1
            self.sceneries[row.scenery] += 1
            self.hdris[row.hdri] += 1
            self.positions += row.shot == 0
            kind = row.weather.kind if row.weather else "clear"
            self.weather[kind] += 1
            self.open_sky += not self.overcast and row.weather is not None and KINDS[kind].overcast
            self.no_room += row.left_out if row.shot == 0 else 0
            self.companions.update(companion.vehicle for companion in row.companions)
            self.distractors.update(distractor.vehicle for distractor in row.distractors)
            self.paints.update(coat.colour or OWN for vehicle in row.vehicles for coat in vehicle.paint)
            self.labels.update(vehicle.label for vehicle in row.labelled)
            for key, n in row.rejected.items():
                self.rejected[BY_KEY[key]] += n
        self.images += len(rows)
        rows = [row for row in rows if not row.background]
        if not rows:
            return
        cameras, vehicles = (
            np.stack([pose[:3, 3] for pose in poses])
            for poses in ([row.world_from_camera for row in rows], [row.target.world_from_vehicle for row in rows])
        )
        away, boxes = cameras - vehicles, np.array([row.target.bbox for row in rows])
        values = {
            "distance_m": np.linalg.norm(away, axis=1),
            "elevation_deg": np.degrees(np.arctan2(away[:, 2], np.hypot(away[:, 0], away[:, 1]))),
            "exposure_ev": np.array([row.exposure_ev for row in rows]),
            "box_px": np.sqrt(boxes[:, 2] * boxes[:, 3]),
            "air_contrast": np.array([row.target.air_contrast for row in rows if row.weather]),
        }
        for key, histogram in self.histograms.items():
            histogram.add(values[key] if key in values else np.array([getattr(row.target, key) for row in rows]))

    def to_json(self) -> dict[str, Any]:
        """Everything as plain numbers."""
        return {
            "images": self.images,
            "positions": self.positions,
            "classes": _nested(self.vehicles),
            "sizes": _nested(self.sizes),
            "backgrounds": dict(self.backgrounds),
            "companions": dict(self.companions),
            "distractors": dict(self.distractors),
            "paints": dict(self.paints),
            "labels": dict(self.labels),
            "sceneries": dict(self.sceneries),
            "hdris": dict(self.hdris),
            "foggy": self.weather["fog"],
            "weather": dict(self.weather),
            "companions_left_out": self.no_room,
            "left_out": [msgspec.structs.asdict(pair) for pair in self.left_out],
            "rejected": {rejection.key: n for rejection, n in sorted(self.rejected.items())},
            "histograms": {key: histogram.to_json() for key, histogram in self.histograms.items()},
        }

    def tables(self) -> list[Table]:
        """Tables for a terminal."""
        return [self._class_table(), self._histogram_table(), self._rejection_table()]

    def notes(self) -> list[str]:
        """A line for each thing that was asked for and is not in the plan."""
        notes = [f"left out: {pair.why}" for pair in self.left_out]
        if self.no_room:
            notes.append(f"left out: {self.no_room:,} companions that found no room at their position")
        if self.open_sky:
            notes.append(
                f"rain or snow fall in {self.open_sky:,} images from any sky: name the overcast HDRIs in light.overcast"
            )
        return notes

    def _class_table(self) -> Table:
        table = Table(title=f"{self.images:,} images at {self.positions:,} positions", title_justify="left")
        for column in ("class", "vehicles", "images", *SIZES):
            table.add_column(column, justify="left" if column in ("class", "vehicles") else "right")
        for category, models in _nested(self.vehicles).items():
            shares = ", ".join(f"{name} {n:,}" for name, n in models.items())
            sizes = [f"{self.sizes[category, size]:,}" for size in SIZES]
            table.add_row(escape(category), escape(shares), f"{sum(models.values()):,}", *sizes)
        if self.backgrounds:
            shares = ", ".join(f"{name or 'empty'} {n:,}" for name, n in sorted(self.backgrounds.items()))
            table.add_row("no target", escape(shares), f"{self.backgrounds.total():,}")
        for kind, counts in (("companions", self.companions), ("distractors", self.distractors)):
            if counts:
                shares = ", ".join(f"{name} {n:,}" for name, n in sorted(counts.items()))
                table.add_row(f"beside: {kind}", escape(shares), f"{counts.total():,}")
        if self.paints:
            shares = ", ".join(f"{colour} {n:,}" for colour, n in self.paints.most_common())
            table.add_row("painted", shares, f"{self.paints.total():,}")
        if self.labels["ignored"]:
            ignored, full = self.labels["ignored"], self.labels["full"]
            table.add_row("labels", f"{full:,} full, {ignored:,} to be ignored: they show too little")
        if self.weather.keys() - {"clear"}:
            table.add_row("weather", ", ".join(f"{kind} {n:,}" for kind, n in sorted(self.weather.items())))
        return table

    def _histogram_table(self) -> Table:
        table = Table(title="how they differ", title_justify="left")
        for column in ("", "lowest", "mean", "highest"):
            table.add_column(column, justify="right" if column else "left")
        table.add_column("histogram", no_wrap=True)
        for histogram in self.histograms.values():
            if histogram.counts.any():
                numbers = (f"{x:.3g}" for x in (histogram.lowest, histogram.mean, histogram.highest))
                table.add_row(histogram.title, *numbers, histogram.bars())
        return table

    def _rejection_table(self) -> Table:
        table = Table(title="what was tried and not taken", title_justify="left")
        for column in ("tries that", "times", "share"):
            table.add_column(column, justify="left" if column == "tries that" else "right")
        for kinds, taken, what in ((PLACING, self.positions, "places"), (AIMING, self.images, "cameras")):
            rejected = {kind: self.rejected[kind] for kind in kinds if self.rejected[kind]}
            total = taken + sum(rejected.values())
            table.add_row(f"{what}: were taken", f"{taken:,}", _share(taken, total))
            for kind, n in sorted(rejected.items(), key=lambda item: -item[1]):
                table.add_row(f"{what}: {kind.phrase}", f"{n:,}", _share(n, total))
        return table

    def draw(self, path: str | Path) -> None:
        """The histograms and counts as a picture."""
        # Slow to import, and of no use to the worker processes.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

        charts = self._bar_charts()
        lines = -(-(len(charts) + len(self.histograms)) // 3)
        figure = Figure(figsize=(12.0, 3.0 * lines), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(lines, 3).ravel()
        for axis in axes[len(charts) + len(self.histograms) :]:
            axis.set_axis_off()
        for axis, (title, counts) in zip(axes, charts.items(), strict=False):
            # Between two dollars matplotlib reads formulae; names have none.
            names = [name.replace("$", r"\$") for name in counts]
            axis.barh(names[::-1], list(counts.values())[::-1], color="#4878a8")
            axis.set_title(title, fontsize=10)
        for axis, histogram in zip(axes[len(charts) :], self.histograms.values(), strict=False):
            used = np.flatnonzero(histogram.counts)
            if len(used):
                part = slice(used[0], used[-1] + 1)
                edges = histogram.edges[used[0] : used[-1] + 2]
                axis.bar(edges[:-1], histogram.counts[part], width=np.diff(edges), align="edge", color="#4878a8")
                if edges[0] > 0 and histogram.edges[0] > 0:
                    axis.set_xscale("log")
                    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                    axis.xaxis.set_major_formatter(ScalarFormatter())
                    axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_title(histogram.title, fontsize=10, wrap=True)
        figure.suptitle(f"{self.images:,} images at {self.positions:,} positions")
        refuse_foreign(Path(path))
        with replacing(Path(path)) as file:
            figure.savefig(file, format="png", dpi=100, metadata=SOFTWARE)

    def _bar_charts(self) -> dict[str, Mapping[str, int]]:
        classes = {category: sum(models.values()) for category, models in _nested(self.vehicles).items()}
        if self.backgrounds:
            classes["no target"] = self.backgrounds.total()
        sizes = {size: sum(n for (_, s), n in self.sizes.items() if s == size) for size in SIZES}
        rejected = {rejection.key.replace("_", " "): n for rejection, n in self.rejected.most_common(8)}
        charts: dict[str, Mapping[str, int]] = {
            "images of each class": classes,
            "boxes by COCO size": sizes,
            "rejected tries": rejected,
        }
        beside = self.companions + self.distractors
        return charts | ({"vehicles beside targets": dict(beside.most_common(12))} if beside else {})


def summarise(rows: Iterable[Row], *, left_out: Sequence[LeftOut] = (), overcast: bool = False) -> Summary:
    """Count over all rows of a plan, holding few of them at a time.

    Parameters
    ----------
    rows
        The plan's.
    left_out
        What its header says of vehicles without a place.
    overcast
        Whether its config says which HDRIs are overcast.
    """
    summary, some = Summary(left_out=tuple(left_out), overcast=overcast), []
    for row in rows:
        some.append(row)
        if len(some) == 4096:
            summary.add(some)
            some = []
    summary.add(some)
    return summary


def _nested(counts: Mapping[tuple[str, str], int]) -> dict[str, dict[str, int]]:
    nested: dict[str, dict[str, int]] = {}
    for (first, second), n in counts.items():
        nested.setdefault(first, {})[second] = n
    return nested


def _share(part: int, total: int) -> str:
    return f"{100 * part / total:.1f} %" if total else ""
