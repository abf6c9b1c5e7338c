"""Options of reading a file, from the config."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_TEXTURE_SIZE = 1024  # texels of the longer side


@dataclass(frozen=True, slots=True)
class Options:
    """Options of reading a file; None: as in the file."""

    up: str | None = None  # the file's axis that points up: "z", "y", "x", or one of them with a minus
    scale: float | None = None  # meters to one unit of the file
    # direction of a vehicle's nose once z is up: "+x", "-x", "+y", "-y", degrees counterclockwise from +x, or a vector
    forward: str | float | tuple[float, ...] | None = None
    # keep, drop: patterns of objects that belong to a vehicle, and that don't; a scenery's `drop` isn't planned or
    # rendered
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    turret: str | None = None  # turret, gun: pattern of a vehicle's turret and gun; "" for none
    gun: str | None = None
    # turret_pivot, gun_pivot: their pivots: a point in the file's axes and units, or the name of an object
    turret_pivot: str | tuple[float, float, float] | None = None
    gun_pivot: str | tuple[float, float, float] | None = None
    # ground, not_ground, water: the same in this scenery, and its water; None: found by name, material, and shape
    ground: tuple[str, ...] = ()
    not_ground: tuple[str, ...] = ()
    water: tuple[str, ...] | None = None
    texture_size: int = DEFAULT_TEXTURE_SIZE  # texels on the longer side of stored alpha textures
    # west, south, east, and north bound of the read part of a GeoTIFF, in its own coordinates
    area: tuple[float, float, float, float] | None = None
    texture: str | None = None  # a GeoTIFF's orthophoto, relative to its folder


DEFAULT_OPTIONS = Options()
