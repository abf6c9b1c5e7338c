"""What the config says about how a file is to be read."""

from __future__ import annotations

from dataclasses import dataclass

from hulldown.assets.textures import TEXTURE_SIZE


@dataclass(frozen=True, slots=True)
class Options:
    """How to read a file; None leaves it to the file.

    Parameters
    ----------
    up
        The file's axis that points up: "z", "y", "x", or one of them with a minus.
    scale
        Meters to one unit of the file.
    forward
        Where a vehicle's nose points once z is up: "+x", "-x", "+y", "-y", degrees counter-clockwise from +x,
        or a vector.
    yaw_deg
        Degrees counter-clockwise from there to where it really points.
    keep, drop
        Patterns of what belongs to a vehicle and what does not; of a scenery, `drop` is in neither plan nor picture.
    turret, gun
        Pattern of a vehicle's turret and gun; "" for none.
    turret_pivot, gun_pivot
        About what they turn: a point in the file's axes and units, or the name of an object.
    include, exclude
        Patterns of what is ground and what is not in all sceneries.
    ground, not_ground, water
        The same of this scenery; and all of its water, or None to find it by name, material and shape.
    texture_size
        Texels of the longer side that a texture which cuts out is kept at.
    area
        West, south, east, and north end of what is read of a GeoTIFF, in its own coordinates.
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
