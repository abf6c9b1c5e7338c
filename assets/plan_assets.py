"""The assets of a plan in memory, and the files that they came from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from hulldown.assets.scenery import Scenery
from hulldown.assets.skylight import EVEN_SKYLIGHT, SkyLight
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.uniform import GOLDEN_RATIO

SUM_PARTS_PER_M = 2**32  # each term of the sum is rounded to such a part
MAX_TERM_M = 2.0**30
SHAPE_TOLERANCE_M = 1e-5  # a coordinate that changes by 0.02 mm changes the weighted sum by more


class Fingerprint(msgspec.Struct, frozen=True):
    """Two values that tell whether two readings of a file gave the same geometry, despite rounding (1e-13 m)."""

    topology: str  # SHA-256 of all that isn't a coordinate: faces, parts, textures, and how many of each there are
    shape: float  # weighted sum of all coordinates, in meters

    def agrees_with_other(self, other: Fingerprint) -> bool:
        """Return whether another fingerprint is of the same geometry."""
        return self.topology == other.topology and abs(self.shape - other.shape) <= SHAPE_TOLERANCE_M


def asset_fingerprint(asset: VehicleShape | Scenery) -> Fingerprint:
    """Return the fingerprint of an asset as it was read; names and what follows from its meshes don't count."""
    if isinstance(asset, VehicleShape):
        asset = replace(asset, underside=np.zeros((0, 0)))  # by rays, for which rounding may make the difference
    topology, shape, count = hashlib.sha256(), 0, 0

    def take(array: np.ndarray) -> Any:
        nonlocal shape, count
        topology.update(f"{array.dtype.name} {array.shape}\n".encode())
        if array.dtype.kind == "f":
            weight = np.arange(count, count + array.size) * GOLDEN_RATIO
            weight -= np.floor(weight)  # modulo 1, in a tenth of the time that NumPy's `%` takes
            weight -= 0.5
            weight += np.copysign(0.5, weight)  # no coordinate counts less than half
            values = np.nan_to_num(array.ravel().astype(np.float64), posinf=0.0, neginf=0.0)
            terms = np.clip(weight * values, -MAX_TERM_M, MAX_TERM_M)
            # Whole numbers, since the last digits of a sum of floats depend on its order, which each BLAS chooses.
            shape += int(np.rint(terms * SUM_PARTS_PER_M).astype(np.int64).sum())
            count += array.size
        else:
            topology.update(array.tobytes())
        return None

    msgspec.to_builtins(asset, enc_hook=take)
    return Fingerprint(topology.hexdigest(), shape / SUM_PARTS_PER_M)


def content_key(asset: VehicleShape | Scenery) -> tuple[int, ...]:
    """Return what equal files have in common: the objects in all fields but the name, which must stay alive."""
    return tuple(id(getattr(asset, each.name)) for each in fields(asset) if each.name != "name")


class AssetSource(Struct, frozen=True, kw_only=True):
    """The file of an asset: its path as in the config, and its SHA-256; both empty for an asset made in memory."""

    path: str = ""
    sha256: str = ""


class GeometrySource(AssetSource, frozen=True, kw_only=True):
    """The file of a vehicle or scenery, and what was read from it."""

    # SHA-256 of the textures and libraries that it refers to, by their paths from its folder; None: can't be read
    files: dict[str, str | None] = {}
    geometry: Fingerprint | None = None


class HdriSource(AssetSource, frozen=True, kw_only=True):
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
    files: Mapping[str, Mapping[str, AssetSource]] = field(default_factory=dict)
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

    def hdri_skylight(self, hdri: str) -> SkyLight:
        """Return the light of an HDRI on open land."""
        return self.skies.get(hdri, EVEN_SKYLIGHT)
