"""Options of reading a file, from the config."""

from __future__ import annotations

from dataclasses import dataclass

TEXTURE_SIZE = 1024  # texels of the longer side, by default


@dataclass(frozen=True, slots=True)
class Options:
    """Options of reading a file; None: as in the file.

    Parameters
    ----------
    up
        The file's axis that points up: "z", "y", "x", or one of them with a minus.
    scale
        Meters to one unit of the file.
    forward
        Direction of a vehicle's nose once z is up: "+x", "-x", "+y", "-y", degrees counterclockwise from +x,
        or a vector.
    yaw_deg
        Degrees counterclockwise from there to its true direction.
    keep, drop
        Patterns of objects that belong to a vehicle, and that don't; a scenery's `drop` isn't planned or rendered.
    turret, gun
        Pattern of a vehicle's turret and gun; "" for none.
    turret_pivot, gun_pivot
        Their pivots: a point in the file's axes and units, or the name of an object.
    include, exclude
        Patterns of ground, and of other objects, in all sceneries.
    ground, not_ground, water
        The same in this scenery, and its water; None: found by name, material, and shape.
    texture_size
        Texels on the longer side of stored alpha textures.
    area
        West, south, east, and north bound of the read part of a GeoTIFF, in its own coordinates.
    texture
        A GeoTIFF's orthophoto, relative to its folder.
    buildings
        Outlines of buildings on a GeoTIFF, relative to its folder.
    """

    up: str | None = None
    scale: float | None = None
    forward: str | float | tuple[float, ...] | None = None
    yaw_deg: float = 0.0
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    turret: str | None = None
    gun: str | None = None
    turret_pivot: str | tuple[float, float, float] | None = None
    gun_pivot: str | tuple[float, float, float] | None = None
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    ground: tuple[str, ...] = ()
    not_ground: tuple[str, ...] = ()
    water: tuple[str, ...] | None = None
    texture_size: int = TEXTURE_SIZE
    area: tuple[float, float, float, float] | None = None
    texture: str | None = None
    buildings: str | None = None


DEFAULTS = Options()
