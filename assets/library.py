"""The assets of a plan in memory, and the files that they came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from msgspec import Struct

from hulldown.assets.fingerprint import Fingerprint
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
    """All assets of a plan; mappings are by the asset's name in the config."""

    vehicles: Mapping[str, VehicleShape]  # shape of each vehicle, in the order of the config
    categories: Mapping[str, str]
    sceneries: Mapping[str, Scenery]  # geometry of each scenery, in the order of the config
    hdris: tuple[str, ...]  # names of the HDRIs, in the order of the config
    # the files they came from, by "vehicles", "distractors", "sceneries", or "hdris", then by name; assets without an
    # entry were made in memory
    files: Mapping[str, Mapping[str, Source]] = field(default_factory=dict)
    # shape of each distractor, in the order of the config
    distractors: Mapping[str, VehicleShape] = field(default_factory=dict)
    # light of HDRIs on open land; those without an entry are even skies of radiance 1, made in memory
    skies: Mapping[str, SkyLight] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("vehicles", "sceneries", "hdris"):
            if not getattr(self, name):
                raise ValueError(f"{name}: expected at least one, got none")
        if lacking := [name for name in self.vehicles if name not in self.categories]:
            raise ValueError(f"categories: expected one for every vehicle, got none for {lacking}")

    def sky(self, hdri: str) -> SkyLight:
        """Light of an HDRI on open land."""
        return self.skies.get(hdri, EVEN)
