"""The assets of a plan in memory: vehicles, sceneries, and HDRIs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hulldown.assets.photographs import Photographs
from hulldown.assets.scenery import Scenery
from hulldown.assets.skylight import EVEN, SkyLight
from hulldown.assets.vehicle import VehicleShape


@dataclass(frozen=True, slots=True)
class AssetFile:
    """An asset's file, as in the plan's header.

    Parameters
    ----------
    path
        As the config gave it: relative to the config's folder, or absolute.
    sha256
        Hexadecimal digest of the file's bytes; empty if the asset was made in memory.
    mended_sha256
        Digest of the repaired copy that is rendered; empty if the file is used unchanged.
    """

    path: str
    sha256: str = ""
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
    vehicle_files, scenery_files, hdri_files, distractor_files
        The files they came from; assets without an entry were made in memory.
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
    vehicle_files: Mapping[str, AssetFile] = field(default_factory=dict)
    scenery_files: Mapping[str, AssetFile] = field(default_factory=dict)
    hdri_files: Mapping[str, AssetFile] = field(default_factory=dict)
    distractors: Mapping[str, VehicleShape] = field(default_factory=dict)
    distractor_files: Mapping[str, AssetFile] = field(default_factory=dict)
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
