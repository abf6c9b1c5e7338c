"""The report about an asset file or an HDRI, as data that prints as a table or JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Literal

import numpy as np
from jaxtyping import Float
from rich.markup import escape
from rich.table import Table

from hulldown.base.errors import AssetError
from hulldown.reading.pieces.doubt import Doubt, DoubtKind

MIN_FAMILY_COPIES = 6  # this many numbered copies or more share a row
MIN_SHARED_ROW_OBJECTS = 3  # objects left out for one reason share a row of the table, which names the first
MAX_LISTED_ROWS = 12


class By(StrEnum):
    """What decided the use of an object: the config, the file's own settings, a name, a shape, or nothing."""

    CONFIG = "config"
    FILE = "file"
    HIDDEN = "hidden"  # the file hides it from renders
    NAME = "name"
    SHAPE = "shape"
    DEFAULT = "default"


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """One object of the file, or all instances of it."""

    name: str
    kind: str
    use: str  # a part's name ("hull", "turret", "gun"), "ground", "obstacle", "backdrop" or "dropped"
    why: str
    count: int = 1  # number of times it's drawn
    triangles: int = 0  # triangles of one of them, as rendered
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)  # extents in meters of the largest of them along x, y, z
    by: By = By.FILE


def merge_copy_rows(rows: Sequence[ObjectRow]) -> tuple[ObjectRow, ...]:
    """Return the rows; many copies of the same kind and use (Tree.001, Tree.002, ...) share a row."""
    families: dict[tuple[str, str, str], list[ObjectRow]] = {}
    for row in rows:
        families.setdefault((_unnumbered_name(row.name), row.kind, row.use), []).append(row)
    return tuple(
        row
        for (stem, _, _), family in families.items()
        for row in ([_row_for_family(family, f"{stem}*", family[0].why)] if len(family) >= MIN_FAMILY_COPIES else family)
    )


def _unnumbered_name(name: str) -> str:
    stem = name.rstrip("0123456789")
    return stem.rstrip(" ._-") if stem != name else name


def _merge_dropped_rows(rows: Sequence[ObjectRow]) -> list[ObjectRow]:
    families: dict[str, list[ObjectRow]] = {}
    for row in rows:
        if row.use == "dropped":
            families.setdefault(row.why.replace(repr(row.name), "its name"), []).append(row)
    result = [row for row in rows if row.use != "dropped"]
    for why, family in families.items():
        names = ", ".join(row.name for row in family[:MAX_LISTED_ROWS])
        more = f" and {len(family) - MAX_LISTED_ROWS} more" if len(family) > MAX_LISTED_ROWS else ""
        result += [_row_for_family(family, names + more, why)] if len(family) >= MIN_SHARED_ROW_OBJECTS else family
    return result


def _row_for_family(family: Sequence[ObjectRow], name: str, why: str) -> ObjectRow:
    x, y, z = (max(lengths) for lengths in zip(*(row.size for row in family), strict=True))
    count, triangles = sum(row.count for row in family), max(row.triangles for row in family)
    return replace(family[0], name=name, why=why, count=count, triangles=triangles, size=(x, y, z))


def xyz_tuple(vector: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Format a vector for reports."""
    return float(vector[0]), float(vector[1]), float(vector[2])


@dataclass(frozen=True, slots=True)
class PartRow:
    """A moving part: pivot, axis, limits, and the reasons. Meters and radians."""

    name: str
    parent: str
    pivot: tuple[float, float, float]
    axis: tuple[float, float, float]
    limits: tuple[float, float]
    why: str


@dataclass(frozen=True, slots=True)
class MaterialRow:
    """A material of a vehicle."""

    name: str
    share: float  # of the vehicle's surface
    clear: bool = False  # whether it's transparent, like glass
    alpha: float = 1.0  # the least alpha of its shaders that isn't a texture's; 1 if it's opaque
    color: tuple[float, float, float] | None = None  # of its only shader, linear; None if it has textures
    metal: bool = False  # whether that shader is all metal


@dataclass(frozen=True, slots=True)
class Missing:
    """A file, or a material's picture, that is missing or unreadable."""

    path: str
    wanted_by: tuple[str, ...]
    problem: str = "missing"


@dataclass(frozen=True, slots=True)
class Thing:
    """A vehicle, one of several things in a file, as an entry of a config."""

    name: str  # name of the entry; "" for the file's own
    size: tuple[float, float, float]  # extents in meters
    keep: tuple[str, ...] = ()  # keep, drop: patterns that leave nothing else
    drop: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TopView:
    """Shares of what a scenery shows from straight above, within the bounds of its ground."""

    ground: float
    obstacle: float
    water: float
    nothing: float


@dataclass(frozen=True, slots=True)
class FileReport:
    """The report about a file with a vehicle or scenery."""

    kind: str
    path: str
    # extents in meters: of the vehicle, or of the ground (of everything if there is none)
    size: tuple[float, float, float]
    triangles: int  # drawn triangles of used objects, each instance counted
    unit: float  # meters to one unit of the file
    up: str  # the axis of the file that points up: "z", "y", "-y", .
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # meters subtracted from a scenery's coordinates
    rows: tuple[ObjectRow, ...] = ()  # every object and its use
    parts: tuple[PartRow, ...] = ()  # moving parts of a vehicle
    missing: tuple[Missing, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    written_by: str = ""  # the version of Blender that wrote the file, or the format
    axes: str = ""  # directions of a vehicle's up and nose in the file, with reasons
    materials: tuple[MaterialRow, ...] = ()  # materials of a vehicle's surface, largest share first
    things: tuple[Thing, ...] = ()  # entries to list a vehicle's file by, if several things are in it
    top_view: TopView | None = None  # of a scenery

    def table(self) -> Table:
        """Return a table of every object and its use, for a terminal."""
        table = Table(title=escape(f"{self.path}: {self.kind}"), title_justify="left")
        for column in ("object", "used as", "why", "count", "triangles", "size (m)"):
            justify: Literal["left", "right"] = "right" if column in ("count", "triangles", "size (m)") else "left"
            # A name goes on in the next line: half of one is of no use for `keep` and `drop`.
            table.add_column(column, justify=justify, overflow="fold")
        for row in _merge_dropped_rows(self.rows):
            size = " x ".join(f"{x:.2f}" for x in row.size)
            table.add_row(escape(row.name), row.use, escape(row.why), str(row.count), f"{row.triangles:,}", size)
        return table

    def lines(self) -> list[str]:
        """Return lines below the table: size, moving parts, doubts."""
        size = " x ".join(f"{x:.2f}" for x in self.size)
        lines = [f"size {size} m, {self.triangles:,} triangles, {self.up} up, 1 unit = {self.unit:g} m"]
        lines += [self.axes] if self.axes else []
        for part in self.parts:
            low, high = (f"{math.degrees(angle):.0f}" for angle in part.limits)
            pivot, axis = (", ".join(f"{x:.2f}" for x in vector) for vector in (part.pivot, part.axis))
            turns = f"pivot ({pivot}), axis ({axis}), {low} to {high} degrees"
            lines.append(f"{part.name} on {part.parent}: {turns}; {part.why}")
        if self.top_view:
            shares = ", ".join(f"{100 * share:.0f} % {what}" for what, share in asdict(self.top_view).items() if share)
            lines.append(f"from above: {shares}")
        if self.materials:
            lines.append(f"materials: {', '.join(f'{row.name} ({100 * row.share:.0f} %)' for row in self.materials)}")
        # Names may break lines.
        return [line.replace("\n", "\\n") for line in (*lines, *(f"doubt: {doubt}" for doubt in self.doubts))]


@dataclass(frozen=True, slots=True)
class SkyReport:
    """The report about an HDRI."""

    path: str
    irradiance: tuple[float, float, float]  # of level ground, linear Rec. 709.
    exposure_ev: float  # exposure at which a gray card on open land is mid-gray, at a strength of 1
    horizon_deg: float  # elevation up to which it shows something other than sky
    notes: tuple[str, ...]
    doubts: tuple[Doubt, ...]  # why it doesn't fit open land or has odd light, and what to do
    kind: str = "hdri"  # "hdri", beside those of `FileReport`

    def table(self) -> Table:
        """Return its figures, for a terminal."""
        table = Table(title=escape(f"{self.path}: HDRI"), title_justify="left", show_header=False)
        red, green, blue = self.irradiance
        for what, value in (
            ("irradiance of level ground", f"{red:.4g}, {green:.4g}, {blue:.4g}"),
            ("exposure for a gray card", f"{self.exposure_ev:+.2f} EV"),
            ("only sky is seen above", f"{self.horizon_deg:.1f} degrees"),
        ):
            table.add_row(what, value)
        return table

    def lines(self) -> list[str]:
        """Return lines below the table."""
        return [*self.notes, *(f"doubt: {doubt}" for doubt in self.doubts)]


def refuse_lost_geometry(reports: Sequence[FileReport]) -> None:
    """Refuse files of which Blender draws something that wasn't read."""
    lost = ((report, doubt) for report in reports for doubt in report.doubts if doubt.kind == DoubtKind.LOST)
    for report, doubt in lost:
        raise AssetError(str(doubt), path=report.path, remedy="hulldown inspect -o shows both pictures")


def refuse_missing_files(reports: Sequence[FileReport], *, strict: bool) -> None:
    """Refuse files that lack a texture or a library."""
    for report in reports:
        if report.missing:
            first, more = report.missing[0], len(report.missing) - 1
            raise AssetError(
                f"{first.path} is {first.problem}, used by {', '.join(first.wanted_by) or 'the file'}"
                + (f" (and {more} more)" if more else ""),
                path=report.path,
                remedy="put the file there, or pack it into the .blend"
                + (", or go on without --strict" if strict else ", or set allow_missing = true, which renders it magenta"),
            )
