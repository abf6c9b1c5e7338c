"""The report about an HDRI, as data that prints as a table or JSON."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from hulldown.camera.response import ALBEDO, metered
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.skies.hdri import Hdri, read_hdris

REMEDY = '`light.backdrop` other than "hdri" hides it and keeps its light'


@dataclass(frozen=True, slots=True)
class SkyReport:
    """The report about an HDRI.

    Parameters
    ----------
    path
        The file.
    irradiance
        Of level ground, linear Rec. 709.
    exposure_ev
        Exposure at which a gray card on open land is mid-gray, at a strength of 1.
    horizon_deg
        Elevation up to which it shows something other than sky.
    notes
        Repairs, a sentence each.
    doubts
        Sentences about why it doesn't fit open land or has odd light, and what to do.
    kind
        "hdri", beside those of `reading.report.FileReport`.
    """

    path: str
    irradiance: tuple[float, float, float]
    exposure_ev: float
    horizon_deg: float
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    kind: str = "hdri"

    def table(self) -> Table:
        """Its figures, for a terminal."""
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
        """Lines below the table."""
        return [*self.notes, *(f"doubt: {doubt}" for doubt in self.doubts)]

    def to_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        return asdict(self)


def sky_report(path: Path, hdri: Hdri) -> SkyReport:
    """The report of an HDRI that was read from `path`."""
    light = hdri.light
    ev = float(metered(np.array([light.irradiance]) * (ALBEDO / np.pi))[0])
    doubts = (*(f"{misfit}; {REMEDY}" for misfit in light.misfits), *hdri.doubts)
    return SkyReport(str(path), light.irradiance, round(ev, 4), light.horizon_deg, hdri.notes, doubts)


def inspect_sky(path: Path, *, limits: ReadLimits = DEFAULT_LIMITS) -> SkyReport:
    """Inspect an HDRI, read without the cache.

    Raises
    ------
    AssetError
        If it's unusable.
    """
    with tempfile.TemporaryDirectory(prefix="hulldown-") as cache:
        return sky_report(path, read_hdris([path], Path(cache), limits=limits)[0])
