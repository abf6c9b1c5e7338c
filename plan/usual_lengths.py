"""Usual lengths of vehicles, by words in their classes and names, which reveal a wrong scale."""

from __future__ import annotations

from collections.abc import Sequence

from hulldown.base.errors import AssetError
from hulldown.plan.config.asset_sections import ModelEntry
from hulldown.reading.doubts import format_length, likely_scale
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.naming import first_match

USUAL_LENGTHS = {  # meters, up to the longest with gun or trailer
    ("car", "suv", "sedan", "jeep", "hatchback", "pickup", "van", "taxi"): (2.0, 9.0),
    ("truck", "lorry", "bus", "launcher", "howitzer", "artillery"): (3.0, 30.0),
    ("tank", "mbt", "apc", "ifv"): (3.0, 16.0),
}
ANY_VEHICLE, ANY_LENGTH = ("vehicle",), (0.2, 100.0)


def refuse_odd_lengths(vehicles: Sequence[tuple[ModelEntry, FileReport]]) -> None:
    """Refuse vehicles of unusual length for their class, unless the config gives their scale."""
    refused = [(e, odd, r) for e, r in vehicles if e.scale is None and (odd := odd_length(e, r)) is not None]
    if refused:
        others = [f"{entry.name} ({format_length(max(report.size))})" for entry, _, report in refused[1:]]
        _, (kind, lengths), report = refused[0]
        several = next((str(doubt) for doubt in report.doubts if doubt.kind == DoubtKind.SEVERAL), "")
        raise AssetError(
            f"is {format_length(max(report.size))} long, and {usual_text(kind, lengths)}"
            + (f"; of unusual length are also {', '.join(others)}" if others else ""),
            path=report.path,
            remedy=several
            or f"set scale{likely_scale(max(report.size), report.unit, lengths)}, also to the value that "
            "it has now if the size is right",
        )


def odd_length(entry: ModelEntry, report: FileReport) -> tuple[str, tuple[float, float]] | None:
    """Return a vehicle's class and its usual lengths, if it doesn't have them."""
    name = f"{getattr(entry, 'category', None) or ''} {entry.name}"
    kind = next((kind for kind in USUAL_LENGTHS if first_match(name, kind)), ANY_VEHICLE)
    low, high = USUAL_LENGTHS.get(kind, ANY_LENGTH)
    return None if low <= max(report.size) <= high else (kind[0], (low, high))


def usual_text(kind: str, usual: tuple[float, float]) -> str:
    """Return the usual lengths of a class as the end of a sentence."""
    return f"a {kind} has {usual[0]:g} to {usual[1]:g} m"
