"""Read outlines of buildings from a GeoJSON file, on a terrain's map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular
from hulldown.reading.scenery.geotiff import on_map

# Keys of OpenStreetMap, Overture, and OpenMapTiles, with meters to one unit.
HEIGHTS = {"height": 1.0, "building:height": 1.0, "render_height": 1.0, "building:levels": 3.0, "num_floors": 3.0}
USUAL = 6.0  # meters, for files without these keys
MOST = 20_000  # each is an object in Blender


# An outline and those of its courtyards, (n, 2) meters each, and a height in meters.
Building = tuple[list[Float[np.ndarray, "_ 2"]], float]


def read_buildings(path: Path, crs: str) -> list[Building]:
    """Read the polygons of a GeoJSON file, transformed to a terrain's map.

    Parameters
    ----------
    path
        The file: longitudes and latitudes, unless its `crs` names another map.
    crs
        The terrain's; "" if unknown: the file's coordinates are then the terrain's.

    Raises
    ------
    AssetError
        If it isn't GeoJSON, or has no polygons or too many.

    References
    ----------
    RFC 7946. `crs` is of the GeoJSON of 2008, which GIS programs still write.
    """
    try:
        with open_regular(path) as file:
            data = msgspec.json.decode(file.read(), type=dict[str, Any])
        there = ((data.get("crs") or {}).get("properties") or {}).get("name", "OGC:CRS84")
        found = _buildings(data, USUAL)
        buildings = [([on_map(ring, there, crs or there) for ring in rings], height) for rings, height in found]
    except OSError as error:
        raise AssetError(f"cannot be read ({error.strerror})", path=path, remedy="check its name") from None
    except (msgspec.MsgspecError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise AssetError(f"isn't GeoJSON ({error})", path=path, remedy="export polygons as GeoJSON in WGS 84") from None
    if not 0 < len(buildings) <= MOST:
        problem = f"has {len(buildings):,} polygons, expected 1 to {MOST:,}"
        raise AssetError(problem, path=path, remedy="export the outlines of buildings in the terrain's area")
    return buildings


def _buildings(record: Mapping[str, Any], height: float) -> Iterator[Building]:
    match record.get("type"):
        case "FeatureCollection" | "GeometryCollection" as kind:
            for each in record["features" if kind == "FeatureCollection" else "geometries"]:
                yield from _buildings(each, height)
        case "Feature":
            yield from _buildings(record.get("geometry") or {}, _height(record.get("properties") or {}))
        case "Polygon" | "MultiPolygon" as kind:
            for rings in record["coordinates"] if kind == "MultiPolygon" else [record["coordinates"]]:
                closed = [np.array([point[:2] for point in ring[:-1]], dtype=np.float64) for ring in rings]
                if outlines := [outline for outline in closed if len(outline) >= 3]:
                    yield outlines, height


def _height(properties: Mapping[str, Any]) -> float:
    """Meters, from numbers or texts such as "12.5 m"."""
    for key, unit in HEIGHTS.items():
        with suppress(ValueError):
            height = float(str(properties.get(key)).removesuffix("m")) * unit
            if 0.0 < height < 1000.0:
                return height
    return USUAL
