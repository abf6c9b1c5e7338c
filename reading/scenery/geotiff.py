"""Elevations and orthophotos of GeoTIFF files in meters; the one owner of rasterio and pyproj (the extra `geo`)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from hulldown.base.errors import AssetError, HulldownError
from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.doubt import Doubt, DoubtKind

MAX_ORTHOPHOTO_PIXELS = 1 << 28  # a band is read at a time
MAX_CELLS = 9_000_000  # reading each takes about 0.7 KB of memory; docs/terrain.md
MAX_PICTURE_SIDE_PX = 8192
MAX_AREA_ERROR_SHARE = 0.01  # of a map's areas against the ground's
MAX_COORDINATE = 1e9  # also of the scale of elevations
MIN_ELEVATION = -400.0  # meters or feet: no land is lower, and nodata is -9999, -32768, or -3.4e38
MIN_NODATA_GAP_SHARE = 0.5  # of the other elevations' range; nodata is farther below them
KILOMETER_M = 1000.0
NO_GEO = "pip install 'hulldown[geo]'"


@dataclass(frozen=True, eq=False, slots=True)
class Elevations:
    """A raster as a mesh: a vertex at the center of each cell that has a value, two triangles between four of them."""

    mesh: Mesh  # in meters, x east, y north, relative to `anchor`; counterclockwise seen from above
    anchor: Float[np.ndarray, "3"]  # whole kilometers
    crs: str  # coordinate reference system of `anchor` and `mesh`: "EPSG:32632", or WKT; "" if unknown
    doubts: tuple[Doubt, ...]


def read_elevations(path: Path, *, area: Sequence[float] | None, scale: float | None) -> Elevations:
    """Read the elevations in a GeoTIFF.

    `area`: west, south, east, and north bound in the raster's own coordinates; None for all of it.
    `scale`: meters per unit of elevation; None to take it from the file.
    """
    with _open_geotiff(path) as raster:
        bands = [i for i, kind in enumerate(raster.colorinterp, 1) if kind.name != "alpha"]
        if len(bands) != 1 or raster.dtypes[bands[0] - 1].startswith("complex"):
            kinds = ", ".join(raster.dtypes)
            raise AssetError(f"isn't a raster of elevations: it has {raster.count} bands ({kinds})", path=path)
        band = bands[0]
        (top, bottom), (left, right) = _area_window(raster, area, path)
        if (cells := (bottom - top) * (right - left)) > MAX_CELLS:
            raise AssetError(f"has {cells:,} cells, more than {MAX_CELLS:,}", path=path, remedy="give a smaller `area`")
        stored = raster.read(band, window=((top, bottom), (left, right)), masked=True)
        z = stored.astype(np.float64).filled(np.nan) * raster.scales[band - 1] + raster.offsets[band - 1]
        row, column = np.mgrid[top:bottom, left:right] + 0.5
        x, y = raster.transform * (column, row)
        south_up = raster.transform.determinant > 0
        wkt, unit = raster.crs.to_wkt() if raster.crs else "", raster.units[band - 1]
    doubts = _remove_undeclared_nodata(z)
    x, y, crs = _coordinates_and_crs_in_meters(x, y, wkt, path, doubts)
    z = z * (scale or _elevation_meters_per_unit(unit, wkt, path))
    with np.errstate(invalid="ignore"):
        known = np.isfinite(x) & np.isfinite(y) & (np.abs(z) < 1e6)
    number = np.cumsum(known, dtype=np.int64).reshape(known.shape).astype(np.int32) - 1
    number[~known] = -1
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    faces = faces[(faces >= 0).all(axis=1)]
    if not len(faces):
        raise AssetError("has no elevations here, only nodata", path=path, remedy="give another `area`")
    vertices = np.stack([x[known], y[known], z[known]], axis=1)
    anchor = np.round((vertices.min(axis=0) + vertices.max(axis=0)) / 2 / KILOMETER_M) * KILOMETER_M + 0.0
    return Elevations(Mesh(vertices - anchor, faces[:, ::-1] if south_up else faces), anchor, crs, tuple(doubts))


def _remove_undeclared_nodata(z: Float[np.ndarray, "m n"]) -> list[Doubt]:
    """Remove undeclared nodata values, far below all others (coasts have many zeros); return a doubt about them."""
    known = z[np.isfinite(z)]
    if not len(known) or (lowest := float(known.min())) > MIN_ELEVATION:
        return []
    others = known[known > lowest]
    if not len(others) or float(others.min()) - lowest < MIN_NODATA_GAP_SHARE * max(float(np.ptp(others)), 1.0):
        return []
    z[z == lowest] = np.nan
    share = 100 * (len(known) - len(others)) / len(known)
    text = (
        f"{share:.2g} % of its elevations are {lowest:g}, far below all others; they're taken for nodata, though the "
        "file declares none"
    )
    return [Doubt(DoubtKind.COORDINATES, text)]


def read_orthophoto(
    path: Path, *, crs: str, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> UInt8[np.ndarray, "h w 4"]:
    """Read an orthophoto, resampled to a rectangle of a map in `crs` ("": the file's); transparent without pixels."""
    with _open_geotiff(path) as raster:
        import rasterio.transform
        import rasterio.warp
        from rasterio.enums import Resampling

        if raster.width * raster.height > MAX_ORTHOPHOTO_PIXELS:
            raise AssetError(
                f"has {raster.width} x {raster.height} pixels, more than {MAX_ORTHOPHOTO_PIXELS:,}",
                path=path,
                remedy="cut out the terrain's area by `gdalwarp -te`",
            )
        if any(kind.startswith("complex") for kind in raster.dtypes):
            raise AssetError(f"isn't a picture: its samples are {raster.dtypes[0]}", path=path)
        kinds = [kind.name for kind in raster.colorinterp]
        if "palette" in kinds:
            raise AssetError("has a palette", path=path, remedy="convert it by `gdal_translate -expand rgb`")
        colors = [i for i, name in enumerate(kinds, 1) if name != "alpha"][:3]
        colors = colors if len(colors) == 3 else colors[:1] * 3
        there = raster.crs or crs or "EPSG:32631"  # without any, both have the same coordinates
        here = crs or there
        steps = rasterio.warp.calculate_default_transform(there, here, raster.width, raster.height, *raster.bounds)[0]
        extent = high - low
        size = max(abs(steps.a), float(extent.max()) / MAX_PICTURE_SIDE_PX)
        width, height = (max(1, int(np.ceil(side / size))) for side in extent)
        grid = rasterio.transform.from_bounds(*low, *high, width, height)
        shown = np.zeros((4, height, width), dtype=raster.dtypes[0])
        how = {"src_transform": raster.transform, "src_crs": there, "dst_transform": grid, "dst_crs": here}
        for i, band in enumerate(colors):
            rasterio.warp.reproject(raster.read(band), shown[i], resampling=Resampling.bilinear, **how)
        mask = np.zeros((height, width), dtype=np.uint8)
        rasterio.warp.reproject(raster.dataset_mask(), mask, resampling=Resampling.nearest, **how)
    seen = mask > 0
    if not seen.any():
        raise AssetError("doesn't show any of the terrain", path=path, remedy="check its coordinates and the `area`")
    if shown.dtype != np.uint8:
        dark, light = np.percentile(shown[:3, seen], (0.5, 99.5))
        shown = np.clip((shown.astype(np.float64) - dark) / max(light - dark, 1e-9) * 255, 0, 255).astype(np.uint8)
    shown[3] = mask
    return np.moveaxis(shown, 0, -1)


def transform_map_points(points: Float[np.ndarray, "n 2"], crs: str, other: str) -> Float[np.ndarray, "n 2"]:
    """Transform points from one map to another; x is east and y is north on both."""
    try:
        import pyproj
    except ModuleNotFoundError:
        raise HulldownError("a scenery from a GeoTIFF needs pyproj", remedy=NO_GEO) from None
    try:
        transformer = pyproj.Transformer.from_crs(crs, other, always_xy=True)
    except pyproj.exceptions.ProjError:
        raise ValueError(f"unknown coordinate reference system {crs!r:.60}") from None
    return np.stack(transformer.transform(points[:, 0], points[:, 1]), axis=1)


@contextmanager
def _open_geotiff(path: Path) -> Iterator[Any]:
    """Open a GeoTIFF, and none of the other formats that GDAL reads."""
    try:
        import rasterio
        from rasterio._err import CPLE_BaseError  # GDAL's own, which some functions pass on
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ModuleNotFoundError:
        raise AssetError("needs rasterio and pyproj to be read", path=path, remedy=NO_GEO) from None
    try:
        unplaced = warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning)
        with unplaced, rasterio.open(path, driver="GTiff") as raster:
            numbers = np.array([*raster.transform[:6], *(raster.scales or ()), *(raster.offsets or ())])
            if not (np.abs(numbers) <= MAX_COORDINATE).all() or raster.transform.determinant == 0.0:
                problem = f"its cells have no place: {raster.transform[:6]}"
                raise AssetError(problem, path=path, remedy="georeference it again")
            yield raster
    except (RasterioError, CPLE_BaseError, ValueError) as error:  # ValueError: maps, and text that isn't UTF-8
        raise AssetError(f"can't be read as a GeoTIFF ({error})", path=path, remedy="copy it again") from None


def _area_window(raster: Any, area: Sequence[float] | None, path: Path) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the first row and column with centers in the area, and those after the last."""
    if area is None:
        return (0, raster.height), (0, raster.width)
    west, south, east, north = area
    corners = np.array([west, west, east, east]), np.array([south, north, south, north])
    cells = np.stack(~raster.transform * corners)
    low = np.maximum(np.ceil(cells.min(axis=1) - 0.5), 0)
    high = np.minimum(np.floor(cells.max(axis=1) + 0.5), (raster.width, raster.height))
    if (high - low < 2).any():
        west, south, east, north = (float(f"{end:.10g}") for end in raster.bounds)
        raise AssetError(
            f"area {list(area)} covers fewer than 2 x 2 of its cells",
            path=path,
            remedy=f"all of it is area = [{west}, {south}, {east}, {north}]",
        )
    return (int(low[1]), int(high[1])), (int(low[0]), int(high[0]))


def _coordinates_and_crs_in_meters(
    x: Float[np.ndarray, "h w"], y: Float[np.ndarray, "h w"], wkt: str, path: Path, doubts: list[Doubt]
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], str]:
    """Return coordinates on a map in meters, and that map: the raster's own if it's true to scale, or UTM."""
    import pyproj
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_utm_crs_info

    if not wkt:
        doubts.append(Doubt(DoubtKind.COORDINATES, "has no coordinate reference system; its coordinates are taken for meters"))
        return x, y, ""
    crs = pyproj.CRS.from_wkt(wkt).to_2d()
    try:
        to_degrees = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError:
        doubts.append(
            Doubt(DoubtKind.COORDINATES, f"has the local coordinate system {crs.name!r}; its coordinates are taken for meters")
        )
        return x, y, ""
    middle = tuple(side.shape[i] // 2 for i, side in enumerate((x, y)))
    longitude, latitude = to_degrees.transform(x[middle], y[middle])
    longitude = (longitude + 180.0) % 360.0 - 180.0
    if not np.isfinite([longitude, latitude]).all():
        raise AssetError(f"has coordinates outside of its map {crs.name!r}", path=path)
    if crs.is_projected and all(axis.unit_conversion_factor == 1.0 for axis in crs.axis_info):
        factors = pyproj.Proj(crs).get_factors(longitude, latitude)
        if abs(factors.areal_scale - 1.0) < MAX_AREA_ERROR_SHARE:
            authority = crs.to_authority()
            return x, y, ":".join(authority) if authority else str(crs.to_wkt())
    spot = AreaOfInterest(longitude, latitude, longitude, latitude)
    zones = query_utm_crs_info(datum_name="WGS 84", area_of_interest=spot)
    if not zones:
        raise AssetError("is too near to a pole for UTM", path=path, remedy="reproject it to a map in meters")
    utm = f"EPSG:{zones[0].code}"
    x, y = pyproj.Transformer.from_crs(crs, utm, always_xy=True).transform(x, y)
    return x, y, utm


def _elevation_meters_per_unit(unit: str | None, wkt: str, path: Path) -> float:
    import pyproj
    from pyproj.database import get_units_map

    if unit:
        known = {"meter": 1.0, "meters": 1.0, "metres": 1.0, "feet": 0.3048}
        for name, linear in get_units_map(category="linear").items():
            known |= {key.lower(): linear.conv_factor for key in (name, linear.proj_short_name) if key}
        if unit.lower() not in known:
            raise AssetError(f"has elevations in {unit!r}", path=path, remedy="set `scale` to meters per unit of them")
        return known[unit.lower()]
    crs = pyproj.CRS.from_wkt(wkt) if wkt else None
    heights = [axis for axis in (crs.axis_info if crs else ()) if axis.direction == "up"]
    return float(heights[0].unit_conversion_factor) if heights else 1.0
