"""Terrain from GeoTIFFs, compared with rasterio: heights in any encoding, and map coordinates."""

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine, from_origin
from rasterio.vrt import WarpedVRT

from hulldown.assets.bundle import load_scenery
from hulldown.base.errors import AssetError, ConfigError
from hulldown.placement.terrain import Terrain
from hulldown.plan.config.schema import Config
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.formats import file_format
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import export_asset
from hulldown.reading.scenery.geotiff import read_elevations, read_orthophoto, transform_map_points

UTM = "EPSG:32632"
CORNER = 447000.0, 5412000.0
LAYOUTS = {
    "striped": {},
    "tiled": {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate", "predictor": 2},
    "big-endian": {"endianness": "big"},
    "big": {"bigtiff": "yes"},
}


def heights(shape=(40, 50), seed=0):
    rng = np.random.default_rng(seed)
    return np.round(300.0 + 60.0 * np.sin(np.arange(shape[1]) / 9.0) + rng.uniform(0, 4, shape))


def write(path, z, *, crs=UTM, transform=None, unit="", scale=None, **profile):
    """A GeoTIFF with cells of 2 m, perhaps with several bands."""
    bands = z if z.ndim == 3 else z[None]
    transform = transform or from_origin(*CORNER, 2.0, 2.0)
    size = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    with rasterio.open(path, "w", driver="GTiff", dtype=z.dtype, crs=crs, transform=transform, **size, **profile) as out:
        out.write(bands)
        out.units = (unit,) * len(bands)
        if scale:
            out.scales, out.offsets = (scale[0],) * len(bands), (scale[1],) * len(bands)
    return path


def elevations(path, area=None, scale=None):
    return read_elevations(path, area=area, scale=scale)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("kind", ["int16", "uint16", "int32", "uint32", "float32", "float64"])
def test_heights_equal_those_of_rasterio(tmp_path, kind, holes, layout):
    options = dict(LAYOUTS[layout])
    if kind.startswith("float") and "predictor" in options:
        options["predictor"] = 3
    z = heights().astype(kind)
    if kind.startswith("float"):
        z += np.float32(0.123)
    if holes:
        options["nodata"] = float((np.finfo if kind.startswith("float") else np.iinfo)(kind).min)
        z[5:9, 30:33] = options["nodata"]
    path = write(tmp_path / "dem.tif", z, scale=(0.25, -10.0), **options)
    assert file_format(path) == "geotiff"
    read = elevations(path)
    assert np.array_equal(read.anchor, np.round(read.anchor / 1000) * 1000)
    assert (read.crs, read.doubts) == (UTM, ())
    with rasterio.open(path) as raster:
        row, column = np.mgrid[: raster.height, : raster.width]
        x, y = (np.array(side) for side in rasterio.transform.xy(raster.transform, row.ravel(), column.ravel()))
        wanted = raster.read(1).ravel().astype(np.float64) * 0.25 - 10.0
        known = raster.read_masks(1).ravel() > 0
    tops = Terrain(read.mesh).top_hits(np.stack([x, y], 1) - read.anchor[:2])
    assert np.array_equal(tops.hit, known)
    assert np.abs(tops.z + read.anchor[2] - wanted)[known].max() < 1e-9
    assert (_normals(read)[:, 2] > 0).all()
    # Two triangles at the hole's corners remain.
    assert len(read.mesh.faces) == 2 * 39 * 49 - (2 * 5 * 4 - 2 if holes else 0)


def _normals(read):
    return read.mesh.normals(np.arange(len(read.mesh.faces)))


@pytest.mark.parametrize(
    ("transform", "upright"),
    [
        (Affine(2, 0, CORNER[0], 0, 2, CORNER[1]), "south up"),
        (Affine(1.6, 1.2, CORNER[0], 1.2, -1.6, CORNER[1]), "rotated"),
        (Affine(2, 0, CORNER[0], 0, -5, CORNER[1]), "cells that aren't square"),
    ],
)
def test_turned_and_flipped_rasters(tmp_path, transform, upright):
    path = write(tmp_path / "dem.tif", heights(), transform=transform)
    read = elevations(path)
    middle = np.array(rasterio.transform.xy(transform, 17, 31))
    top = Terrain(read.mesh).top_hits((middle - read.anchor[:2])[None])
    assert top.z[0] + read.anchor[2] == pytest.approx(heights()[17, 31], abs=1e-6), upright
    assert (_normals(read)[:, 2] > 0).all()


def test_geographic_and_stretched_grids_are_projected_to_utm(tmp_path):
    for crs, transform in (
        ("EPSG:4326", from_origin(8.2, 48.9, 1e-4, 1e-4)),
        ("EPSG:3857", from_origin(912_000.0, 6_250_000.0, 10.0, 10.0)),
        ("EPSG:2225", from_origin(6_000_000.0, 2_000_000.0, 10.0, 10.0)),  # California, in feet
        ("EPSG:4326", from_origin(-70.0, -33.0, 1e-4, 1e-4)),
        ("EPSG:4326", from_origin(179.998, 10.0, 1e-4, 1e-4)),  # across the antimeridian
    ):
        path = write(tmp_path / "dem.tif", heights(), crs=crs, transform=transform)
        read = elevations(path)
        assert read.crs.startswith(("EPSG:326", "EPSG:327"))
        points = read.mesh.vertices + read.anchor
        wanted = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(
            *(np.array(side) for side in rasterio.transform.xy(transform, [0, 39], [0, 49]))
        )
        found = transform_map_points(points[[0, -1], :2], read.crs, "EPSG:4326").T
        assert np.abs((found - wanted + 180) % 360 - 180).max() < 1e-8
        assert points[-1, 2] == heights()[-1, -1]


@pytest.mark.parametrize(
    ("options", "meters"),
    [
        *(({"unit": "m"}, 1.0), ({"unit": "ft"}, 0.3048), ({"unit": "US survey foot"}, 1200 / 3937), ({}, 1.0)),
        ({"crs": "EPSG:32612+6360"}, 1200 / 3937),  # the unit of its datum, NAVD88 height (ftUS)
    ],
)
def test_heights_are_converted_to_meters(tmp_path, options, meters):
    path = write(tmp_path / "dem.tif", heights(), **options)
    read = elevations(path)
    assert read.mesh.vertices[0, 2] + read.anchor[2] == pytest.approx(heights()[0, 0] * meters, abs=1e-9)
    read = elevations(path, scale=2.0)
    assert read.mesh.vertices[0, 2] + read.anchor[2] == 2.0 * heights()[0, 0]


@pytest.mark.parametrize("value", [-9999.0, -32768.0])
def test_undeclared_nodata_is_a_doubt_and_no_pit(tmp_path, value):
    z = heights()
    z[5:9, 30:33] = value
    read = elevations(write(tmp_path / "dem.tif", z))
    assert (read.mesh.vertices + read.anchor)[:, 2].min() == heights().min()
    assert [doubt.kind for doubt in read.doubts] == [DoubtKind.COORDINATES]
    sea = np.linspace(-9999.0, 0.0, 2000).reshape(40, 50)  # a trench has a slope
    assert not elevations(write(tmp_path / "sea.tif", sea)).doubts


def test_an_area_selects_cells_by_their_centers(tmp_path):
    path = write(tmp_path / "dem.tif", heights())
    west, north = CORNER
    read = elevations(path, area=(west + 10, north - 40, west + 31, north - 20))
    points = read.mesh.vertices + read.anchor
    assert points[:, :2].min(axis=0).tolist() == [west + 11, north - 39]
    assert points[:, :2].max(axis=0).tolist() == [west + 31, north - 21]
    assert np.array_equal(points[:, 2], heights()[10:20, 5:16].ravel())
    with pytest.raises(AssetError, match=r"all of it is area = \[447000.0, 5411920.0, 447100.0, 5412000.0\]"):
        elevations(path, area=(8.2, 48.8, 8.3, 48.9))


@pytest.mark.parametrize(
    ("z", "options", "problem"),
    [
        (np.zeros((3, 8, 8), np.uint8), {"photometric": "rgb"}, "3 bands"),
        (np.zeros((8, 8), np.complex64), {}, "complex64"),
        (np.zeros((8, 8), np.int16), {"nodata": 0}, "only nodata"),
        (np.full((8, 8), np.nan), {}, "only nodata"),
        (np.zeros((1, 1), np.int16), {}, "only nodata"),
        (np.zeros((8, 8), np.int16), {"unit": "furlong per fortnight"}, "furlong"),
        (np.zeros((8, 8), np.int16), {"crs": "EPSG:4326", "transform": from_origin(7, 89.9, 0.01, 0.01)}, "pole"),
    ],
)  # fmt: skip
def test_files_without_heights_are_refused(tmp_path, z, options, problem):
    with pytest.raises(AssetError, match=problem):
        elevations(write(tmp_path / "dem.tif", z, **options))


def test_damaged_files_and_other_formats_are_refused(tmp_path):
    whole = write(tmp_path / "dem.tif", heights((200, 200))).read_bytes()
    for size in (20, 200, len(whole) // 2):
        (tmp_path / "cut.tif").write_bytes(whole[:size])
        with pytest.raises(AssetError, match="GeoTIFF"):
            elevations(tmp_path / "cut.tif")


def test_orthophotos_cover_the_terrain_in_any_map_projection(tmp_path):
    west, north = CORNER
    columns = np.tile(np.arange(100, dtype=np.uint8), (80, 1))
    picture = np.stack([columns, columns.T[:80, :1].repeat(100, 1), np.full((80, 100), 200, np.uint8)])
    write(tmp_path / "ortho.tif", picture, transform=from_origin(west, north, 1.0, 1.0), photometric="rgb")
    low, high = np.array([west + 10, north - 60]), np.array([west + 130, north - 20])
    seen = read_orthophoto(tmp_path / "ortho.tif", crs=UTM, low=low, high=high)
    assert seen.shape == (40, 120, 4)
    assert np.array_equal(seen[:, :90, :3], np.moveaxis(picture[:, 20:60, 10:], 0, -1))
    assert (seen[:, :90, 3] == 255).all()
    assert not seen[:, 90:, 3].any()
    cubic = {"crs": "EPSG:3857", "resampling": rasterio.enums.Resampling.cubic}
    with rasterio.open(tmp_path / "ortho.tif") as raster, WarpedVRT(raster, **cubic) as warped:
        colors = warped.read()[:3]
        write(tmp_path / "warped.tif", colors, crs="EPSG:3857", transform=warped.transform, photometric="rgb")
    again = read_orthophoto(tmp_path / "warped.tif", crs=UTM, low=low, high=low + np.array([60, 20]))
    there = np.moveaxis(picture[:, 40:60, 10:70], 0, -1).astype(float)
    shown = again[np.linspace(0, len(again) - 1, 20).astype(int)][:, np.linspace(0, again.shape[1] - 1, 60).astype(int)]
    assert np.abs(shown[..., :3] - there).max() <= 2.0
    with pytest.raises(AssetError, match="doesn't show any"):
        read_orthophoto(tmp_path / "ortho.tif", crs=UTM, low=low + 1e4, high=high + 1e4)


@pytest.mark.blender
def test_a_scenery_is_read_from_a_geotiff_with_its_orthophoto(tmp_path):
    z = heights() + 0.0123456789
    path = write(tmp_path / "dem.tif", z)
    write(tmp_path / "ortho.tif", np.full((4, 8, 8), 90, np.uint8), transform=from_origin(*CORNER, 20.0, 20.0),
          photometric="rgb", alpha="yes")  # fmt: skip
    read = export_asset(path, tmp_path, options=Options(texture="ortho.tif"))
    scenery = load_scenery(read.bundle)
    assert (read.report.kind, scenery.crs, read.files) == ("scenery", UTM, (str(tmp_path / "ortho.tif"),))
    assert scenery.origin.tolist() == [447000.0, 5412000.0, 0.0]
    center = np.array([[1.0, -1.0], [1.0 + 2 * 31, -1.0 - 2 * 17]])
    assert Terrain(scenery.ground).top_hits(center).z.tolist() == [z[0, 0], z[17, 31]]
    with pytest.raises(AssetError, match="folder"):
        export_asset(path, tmp_path, options=Options(texture="../../../../../etc/ortho.tif"))


@pytest.mark.parametrize("keys", [{"area": [0, 0, 0, 1]}, {"area": [0, 1]}, {"path": "hills.blend", "texture": "a.tif"}])
def test_keys_of_geotiffs_are_checked(keys):
    scenery = {"path": "dem.tif", **keys}
    with pytest.raises(ConfigError, match=r"assets\.sceneries"):
        Config.of({"assets": {"vehicles": [{"path": "a.blend", "category": "a"}], "sceneries": [scenery]}})
