"""The assets of a plan in memory, and the files that they came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from hulldown.assets.fingerprint import Fingerprint
from hulldown.assets.photographs import Photographs
from hulldown.assets.scenery import Scenery
from hulldown.assets.skylight import EVEN, SkyLight
from hulldown.assets.vehicle import VehicleShape


class Source(Struct, frozen=True, kw_only=True):
    """The file of an asset: its path as in the config, and its SHA-256; both empty for an asset made in memory."""

    path: str = ""
    sha256: str = ""


class GeometrySource(Source, frozen=True, kw_only=True):
    """The file of a vehicle or scenery, and what was read from it."""

    geometry: Fingerprint | None = None


class HdriSource(Source, frozen=True, kw_only=True):
    """The file of an HDRI, and the SHA-256 of the mended pixels that are rendered, or empty."""

    mended_sha256: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class Assets:
    """All assets of a plan; mappings are by the asset's name in the config.

    Parameters
    ----------
    vehicles
        Shape of each vehicle, in the order of the config.
    categories
        Class of each vehicle.
    sceneries
        Geometry of each scenery, in the order of the config.
    hdris
        Names of the HDRIs, in the order of the config.
    distractors
        Shape of each distractor, in the order of the config.
    skies
        Light of HDRIs on open land; those without an entry are even skies of radiance 1, made in memory.
    files
        The files they came from, by "vehicles", "distractors", "sceneries", or "hdris", then by name; assets without an
        entry were made in memory.
    without_material
        Names of vehicles and distractors whose files have no material, so that they can't be painted.
    photographs
        Photographs that cameras follow; None: the planner reads those that the config names.

    Raises
    ------
    ValueError
        If there is no vehicle, scenery or HDRI, or a vehicle has no class.
    """

    vehicles: Mapping[str, VehicleShape]
    categories: Mapping[str, str]
    sceneries: Mapping[str, Scenery]
    hdris: tuple[str, ...]
    files: Mapping[str, Mapping[str, Source]] = field(default_factory=dict)
    distractors: Mapping[str, VehicleShape] = field(default_factory=dict)
    skies: Mapping[str, SkyLight] = field(default_factory=dict)
    without_material: frozenset[str] = frozenset()
    photographs: Photographs | None = None

    def __post_init__(self) -> None:
        for name in ("vehicles", "sceneries", "hdris"):
            if not getattr(self, name):
                raise ValueError(f"{name}: expected at least one, got none")
        if lacking := [name for name in self.vehicles if name not in self.categories]:
            raise ValueError(f"categories: expected one for every vehicle, got none for {lacking}")

    def sky(self, hdri: str) -> SkyLight:
        """Light of an HDRI on open land."""
        return self.skies.get(hdri, EVEN)
