"""Statistics of a plan: counts, rejections, sizes, and histograms, as tables."""

from __future__ import annotations

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float, Int
from rich.markup import escape
from rich.table import Table
from scipy.special import chdtrc

from hulldown.camera.shell import shell_coordinates
from hulldown.geometry.transforms import transform_points
from hulldown.plan.config.asset_sections import OWN_COLOR
from hulldown.plan.rejection import BY_KEY, CAMERA_REJECTIONS, PLACE_REJECTIONS
from hulldown.plan.row import LeftOut, Row
from hulldown.weather.kinds import WEATHER_KINDS

# COCO's classes of size, by area in square pixels.
SIZE_CLASSES_PX2 = {"small": 32.0**2, "medium": 96.0**2, "large": math.inf}
COUNTED_FIELDS = (
    *("backgrounds", "companions", "distractors", "paints", "labels", "sceneries", "hdris", "weather", "rejected"),
    "like",
)
# Title and edges of the bins of each quantity of targets.
HISTOGRAM_QUANTITIES: Mapping[str, tuple[str, Float[np.ndarray, " b"]]] = {
    "slope_deg": ("slope of the vehicle (degrees)", np.linspace(0.0, 90.0, 91)),
    "distance_m": ("distance of the camera (m)", np.logspace(0.0, 4.0, 65)),
    "elevation_deg": ("elevation of the camera (degrees)", np.linspace(-90.0, 90.0, 91)),
    "visible_fraction": ("visible fraction", np.linspace(0.0, 1.0, 21)),
    "truncated_fraction": ("truncated fraction", np.linspace(0.0, 1.0, 21)),
    "exposure_ev": ("exposure (EV)", np.linspace(-32.0, 32.0, 129)),
    "air_contrast": ("contrast after haze, images with weather only", np.linspace(0.0, 1.0, 21)),
    "box_px": ("box size (root of its area, pixels)", np.logspace(0.0, 4.0, 65)),
}
_BAR_CHARACTERS = " ▁▂▃▄▅▆▇█"
MIN_EXPECTED_IMAGES = 5.0  # values of a class with fewer are merged
FALSE_POSITIVE_RATE = 1e-4  # for one variable
MIN_CRAMERS_V = 0.1  # a weaker dependency doesn't help a detector
REJECTION_REMEDIES = {
    "box height": 'camera.size_measure = "height" gives all classes the same',
    "scenery": "let all classes be planned on all sceneries",
    "paint": "give all classes the same paints",
}
Counts = Mapping[str, Mapping[str, Counter[str]]]


@dataclass(frozen=True, eq=False, slots=True)
class Histogram:
    """Counts of a quantity's values in bins."""

    title: str  # name and unit
    edges: Float[np.ndarray, " b_plus_1"]  # edges of the bins; values outside count in the first or last bin
    values: Float[np.ndarray, " n"]

    @property
    def bin_counts(self) -> Int[np.ndarray, " b"]:
        """Number of values in each bin."""
        return np.histogram(np.clip(self.values, self.edges[0], self.edges[-1]), self.edges)[0]

    @property
    def used_bin_slice(self) -> slice:
        """The bins from the first to the last that has a value."""
        bins = np.flatnonzero(self.bin_counts)
        return slice(bins[0], bins[-1] + 1) if len(bins) else slice(0, 0)

    @property
    def lowest_mean_and_highest(self) -> dict[str, float | None]:
        """Lowest, mean, and highest value; None without values."""
        values = self.values
        if not len(values):
            return {"lowest": None, "mean": None, "highest": None}
        return {"lowest": float(values.min()), "mean": float(values.mean()), "highest": float(values.max())}

    def bars_text(self, width: int = 24) -> str:
        """Return the used bins as a line of blocks."""
        counts = self.bin_counts[self.used_bin_slice]
        groups = [int(part.sum()) for part in np.array_split(counts, min(width, len(counts)) or 1)]
        return "".join(_BAR_CHARACTERS[math.ceil(8 * n / max(*groups, 1))] for n in groups)


@dataclass(frozen=True, eq=False, slots=True)
class Summary:
    """Counts over a plan's images; classes, sizes, and histograms are of targets, backgrounds left out."""

    images: int
    positions: int
    classes: Mapping[str, Counter[str]]  # classes, sizes: images of each class, by vehicle and by COCO size
    sizes: Mapping[str, Counter[str]]
    # occurrences of each name, by `COUNTED_FIELDS`. A background counts as the distractor in its target's place, or "".
    # Paints are those of all vehicles, by color. Rejections are tries.
    counts: Mapping[str, Counter[str]]
    open_sky: int  # images of rain or snow while the config names no overcast HDRIs
    no_room: int  # companions and distractors without room, counted once per position
    left_out: tuple[LeftOut, ...]  # vehicles that aren't planned on a scenery
    histograms: Mapping[str, Histogram]  # by the keys of `HISTOGRAM_QUANTITIES`
    shortcuts: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Return all statistics as plain numbers."""
        return {
            "images": self.images,
            "positions": self.positions,
            "classes": self.classes,
            "sizes": self.sizes,
            **self.counts,
            "foggy": self.counts["weather"]["fog"],
            "companions_left_out": self.no_room,
            "shortcuts": list(self.shortcuts),
            "left_out": [msgspec.structs.asdict(pair) for pair in self.left_out],
            "histograms": {
                key: {
                    "edges": histogram.edges.tolist(),
                    "counts": histogram.bin_counts.tolist(),
                    **histogram.lowest_mean_and_highest,
                }
                for key, histogram in self.histograms.items()
            },
        }

    def tables(self) -> list[Table]:
        """Return tables for a terminal."""
        return [self._class_table(), self._histogram_table(), self._rejection_table()]

    def unmet_wish_notes(self) -> list[str]:
        """Return a line for each request of the config that the plan doesn't meet."""
        notes = [f"left out: {pair.why}" for pair in self.left_out] + list(self.shortcuts)
        if self.no_room:
            notes.append(f"left out: {self.no_room:,} companions and distractors without room at their position")
        like = self.counts["like"]
        if like["another"] or like["none"]:
            notes.append(
                f"limits won over {like['another'] + like['none']:,} of {like.total():,} sampled photographs: "
                f"cameras follow another one in {like['another']:,} images, the configured ranges in {like['none']:,}"
            )
        if len(self.classes) == 1 and not self.counts["backgrounds"]:
            notes.append(
                "no backgrounds: a detector of one class will find it in other vehicles; list distractors, and set "
                "budget.background_share, for example to 0.25"
            )
        if self.open_sky:
            notes.append(
                f"rain or snow fall in {self.open_sky:,} images from any sky: name the overcast HDRIs in light.overcast"
            )
        return notes

    def _class_table(self) -> Table:
        table = _empty_table(
            f"{self.images:,} images at {self.positions:,} positions", "class", "vehicles", "images", *SIZE_CLASSES_PX2
        )
        for category, models in self.classes.items():
            sizes = [f"{self.sizes[category][size]:,}" for size in SIZE_CLASSES_PX2]
            table.add_row(escape(category), _counts_line(models.items()), f"{models.total():,}", *sizes)
        for title, key in (
            ("no target", "backgrounds"),
            ("beside: companions", "companions"),
            ("beside: distractors", "distractors"),
            ("painted", "paints"),
        ):
            if counts := self.counts[key]:
                table.add_row(title, _counts_line(counts.most_common()), f"{counts.total():,}")
        labels, weather = self.counts["labels"], self.counts["weather"]
        if ignored := labels["ignored"]:
            table.add_row("labels", f"{labels['full']:,} full, {ignored:,} ignored, which show too little")
        if like := self.counts["like"]["followed"] + self.counts["like"]["another"]:
            table.add_row("like photographs", "", f"{like:,}")
        if weather.keys() - {"clear"}:
            table.add_row("weather", _counts_line(sorted(weather.items())))
        return table

    def _histogram_table(self) -> Table:
        table = _empty_table("quantities", "", "lowest", "mean", "highest")
        table.add_column("histogram", no_wrap=True)
        for histogram in self.histograms.values():
            if len(histogram.values):
                table.add_row(
                    histogram.title, *(f"{x:.3g}" for x in histogram.lowest_mean_and_highest.values()), histogram.bars_text()
                )
        return table

    def _rejection_table(self) -> Table:
        table = _empty_table("rejected tries", "tries that", "times", "share")
        for kinds, taken, what in ((PLACE_REJECTIONS, self.positions, "places"), (CAMERA_REJECTIONS, self.images, "cameras")):
            rejected = {kind.phrase: n for kind in kinds if (n := self.counts["rejected"][kind.key])}
            total = taken + sum(rejected.values())
            for phrase, n in [("were taken", taken), *sorted(rejected.items(), key=lambda item: -item[1])]:
                table.add_row(f"{what}: {phrase}", f"{n:,}", f"{100 * n / total:.1f} %" if total else "")
        return table


def summarize_plan(rows: Iterable[Row], *, left_out: Sequence[LeftOut] = (), overcast: bool = False) -> Summary:
    """Count over all rows of a plan, in about 64 bytes per row; `overcast` tells whether overcast HDRIs are named."""
    images = positions = open_sky = no_room = 0
    classes, sizes = defaultdict[str, Counter[str]](Counter), defaultdict[str, Counter[str]](Counter)
    counts: dict[str, Counter[str]] = {key: Counter() for key in COUNTED_FIELDS}
    values = {key: array("d") for key in HISTOGRAM_QUANTITIES}
    nuisance: dict[str, dict[str, Counter[str]]] = {}
    for row in rows:
        images += 1
        positions += row.shot == 0
        no_room += row.left_out if row.shot == 0 else 0
        open_sky += not overcast and row.weather is not None and WEATHER_KINDS[row.weather.kind].overcast
        counts["sceneries"][row.scenery] += 1
        counts["hdris"][row.hdri] += 1
        counts["weather"][row.weather.kind if row.weather else "clear"] += 1
        counts["companions"].update(companion.vehicle for companion in row.companions)
        counts["distractors"].update(distractor.vehicle for distractor in row.distractors)
        counts["paints"].update(coat.color or OWN_COLOR for vehicle in row.vehicles for coat in vehicle.paint)
        counts["labels"].update(vehicle.label for vehicle in row.labeled)
        counts["rejected"].update(row.rejected)
        target = row.target
        if row.like is not None:
            same = row.like.photograph == row.like.sampled
            counts["like"]["followed" if same else "none" if row.like.photograph is None else "another"] += 1
        if row.background:
            counts["backgrounds"]["" if row.hides_target else target.vehicle] += 1
            continue
        assert target.bbox is not None  # a target has one
        area, category = target.bbox.width * target.bbox.height, str(target.category)
        classes[category][target.vehicle] += 1
        for variable, value in nuisance_values(row).items():
            nuisance.setdefault(variable, {}).setdefault(category, Counter())[value] += 1
        sizes[category][next(name for name, limit in SIZE_CLASSES_PX2.items() if area < limit)] += 1
        center = np.mean([target.bounds.low, target.bounds.high], axis=0)
        center = transform_points(target.world_from_vehicle, center[None])[0]
        distance, _, elevation = shell_coordinates(row.world_from_camera[:3, 3] - center)
        derived = {
            "distance_m": float(distance),
            "elevation_deg": math.degrees(elevation),
            "exposure_ev": row.exposure_ev,
            "box_px": math.sqrt(area),
        }
        for key, column in values.items():
            if key != "air_contrast" or row.weather:
                column.append(derived[key] if key in derived else getattr(target, key))
    counts["rejected"] = Counter({key: counts["rejected"][key] for key in BY_KEY if counts["rejected"][key]})
    histograms = {key: Histogram(*HISTOGRAM_QUANTITIES[key], np.array(column)) for key, column in values.items()}
    warnings = tuple(shortcut_notes(nuisance))
    return Summary(images, positions, classes, sizes, counts, open_sky, no_room, tuple(left_out), histograms, warnings)


def _empty_table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, justify="left" if column in ("", "class", "vehicles", "tries that") else "right")
    return table


def _counts_line(counts: Iterable[tuple[str, int]]) -> str:
    return escape(", ".join(f"{name or 'empty'} {n:,}" for name, n in counts))


def nuisance_values(row: Row) -> dict[str, str]:
    """Return an image's nuisance variables; those that a position's images share only for the first image."""
    target = row.target
    assert target.bbox is not None  # a target has one
    step = math.floor(2.0 * math.log2(max(target.bbox.height, 1.0)))
    of_image = {
        "HDRI": row.hdri,
        "weather": row.weather.kind if row.weather else "clear",
        "box height": f"{2 ** (step / 2):.0f} to {2 ** ((step + 1) / 2):.0f} pixels",
        "exposure": f"{math.floor(row.exposure_ev)} to {math.floor(row.exposure_ev) + 1} EV",
    }
    if row.shot:
        return of_image
    paint = ", ".join(coat.color or OWN_COLOR for coat in target.paint)
    return of_image | {
        "scenery": row.scenery,
        "number of companions": str(len(row.companions)),
        "number of distractors": str(len(row.distractors)),
        "paint": paint or "none",
    }


def shortcut_notes(counts: Counts) -> list[str]:
    """Return a line for each variable with a significant dependency on the class, from counts by variable and class."""
    lines = []
    for variable, by_class in counts.items():
        if dependency := _describe_dependency(by_class):
            remedy = f"; {REJECTION_REMEDIES[variable]}" if variable in REJECTION_REMEDIES else ""
            lines.append(f"{variable} tells classes apart: {dependency}{remedy}")
    return lines


def _describe_dependency(by_class: Mapping[str, Counter[str]]) -> str:
    """Describe the value and class that deviate most from independence; empty if chance explains them."""
    classes, total = list(by_class), sum(by_class.values(), Counter[str]())
    smallest, n = min(counts.total() for counts in by_class.values()), total.total()
    common = {value for value, count in total.items() if count * smallest / n >= MIN_EXPECTED_IMAGES}
    merged: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for category, counts in by_class.items():
        for value, count in counts.items():
            merged[value if value in common else "another"][category] += count
    table = np.array([[merged[value][category] for value in merged] for category in classes], dtype=np.float64)
    if min(table.shape) < 2:
        return ""
    # Pearson's chi-squared test; importing scipy.stats for it would take a third of a second.
    expected = np.outer(table.sum(axis=1), table.sum(axis=0)) / n
    statistic = float(((table - expected) ** 2 / expected).sum())
    likelihood = chdtrc(math.prod(side - 1 for side in table.shape), statistic)
    strength = math.sqrt(statistic / n / (min(table.shape) - 1))
    if likelihood >= FALSE_POSITIVE_RATE or strength < MIN_CRAMERS_V:
        return ""
    row, column = np.unravel_index(((table - expected) / np.sqrt(expected)).argmax(), table.shape)
    share, others = table[row, column] / table[row].sum(), np.delete(table, row, 0)
    rest = others[:, column].sum() / others.sum()
    return f"{list(merged)[column]} for {share:.0%} of {classes[row]} and {rest:.0%} of the others"
