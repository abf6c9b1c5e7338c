"""Read outlines of buildings from a GeoJSON file, on a terrain's map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from hulldown.base.errors import AssetError
from hulldown.base.outside import read_json, typed
from hulldown.reading.scenery.geotiff import on_map

# Keys of OpenStreetMap, Overture, and OpenMapTiles, with meters to one unit.
HEIGHTS = {"height": 1.0, "building:height": 1.0, "render_height": 1.0, "building:levels": 3.0, "num_floors": 3.0}
USUAL = 6.0  # meters, for files without these keys
MOST_BUILDINGS = 20_000  # each is an object in Blender


# An outline and those of its courtyards, (n, 2) meters each, and a height in meters.
Building = tuple[list[Float[np.ndarray, "_ 2"]], float]

_Coordinate = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Point = Annotated[list[_Coordinate], Meta(min_length=2)]
_Rings = list[list[_Point]]


class _MapName(Struct):
    name: str


class _Crs(Struct):
    properties: _MapName


class _GeoJson(Struct):
    """A feature, a geometry, or a collection of them."""

    type: str
    features: list[_GeoJson] = []
    geometries: list[_GeoJson] = []
    geometry: _GeoJson | None = None
    properties: dict[str, object] | None = None
    coordinates: list[object] = []
    crs: _Crs | None = None


def read_buildings(path: Path, crs: str) -> list[Building]:
    """Read the polygons of a GeoJSON file, transformed to a terrain's map.

    `crs`: the terrain's; "" if unknown: the file's coordinates are then the terrain's.

    References
    ----------
    RFC 7946. `crs` is of the GeoJSON of 2008, which GIS programs still write.
    """
    refuse = partial(AssetError, path=path, remedy="export polygons as GeoJSON in WGS 84")
    data = read_json(path, _GeoJson, refuse, what="GeoJSON")
    there = data.crs.properties.name if data.crs else "OGC:CRS84"
    try:
        buildings = list(_buildings(data, USUAL))
        if not 0 < len(buildings) <= MOST_BUILDINGS:
            problem = f"has {len(buildings):,} polygons, expected 1 to {MOST_BUILDINGS:,}"
            raise AssetError(problem, path=path, remedy="export the outlines of buildings in the terrain's area")
        rings = [ring for outlines, _ in buildings for ring in outlines]
        points = on_map(np.concatenate(rings), there, crs or there)
    except ValueError as error:
        raise refuse(f"isn't GeoJSON ({error})") from None
    if not np.isfinite(points).all():
        raise refuse(f"has polygons outside of its map {there!r:.60}")
    moved = iter(np.split(points, np.cumsum([len(ring) for ring in rings])[:-1]))
    return [([next(moved) for _ in outlines], height) for outlines, height in buildings]


def _buildings(record: _GeoJson, height: float) -> Iterator[Building]:
    for each in (*record.features, *record.geometries):
        yield from _buildings(each, height)
    if record.geometry is not None:
        yield from _buildings(record.geometry, _height(record.properties or {}))
    if record.type in ("Polygon", "MultiPolygon"):
        polygons = record.coordinates if record.type == "MultiPolygon" else [record.coordinates]
        for rings in typed(polygons, list[_Rings]):
            closed = [np.array([point[:2] for point in ring[:-1]], dtype=np.float64) for ring in rings]
            if outlines := [outline for outline in closed if len(outline) >= 3]:
                yield outlines, height


def _height(properties: Mapping[str, object]) -> float:
    """Meters, from numbers or texts such as "12.5 m"."""
    for key, unit in HEIGHTS.items():
        with suppress(ValueError):
            height = float(str(properties.get(key)).removesuffix("m")) * unit
            if 0.0 < height < 1000.0:
                return height
    return USUAL
