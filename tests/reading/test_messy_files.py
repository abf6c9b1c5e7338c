"""Exports of files as people make them, compared with Cycles' pictures."""

import math
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_vehicle
from hulldown.base.errors import AssetError
from hulldown.geometry.transforms import transform_points
from hulldown.placement.footprint import vehicle_underside
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import export_asset
from hulldown.tests.builders.messy_export import SCENERIES, VEHICLES, Messy, iou

pytestmark = pytest.mark.blender


@pytest.mark.parametrize("name", [*VEHICLES, *SCENERIES])
def test_the_exported_silhouette_equals_cycles(messy: Messy, name: str) -> None:
    assert min(map(iou, messy.silhouettes(name), messy.shown(name))) >= 0.99


@pytest.mark.parametrize("name", [*VEHICLES, *SCENERIES, "map_in_mesh", "map_in_object"])
def test_the_tidy_twin_renders_like_the_exported_geometry(messy: Messy, name: str) -> None:
    assert min(map(iou, messy.silhouettes(name), messy.shown(f"{name}.tidy"))) >= 0.99


@pytest.mark.parametrize(
    ("name", "strands"),
    [("hairy", {"Reeds", "Terrain_Fluff", *(f"Reeds.{i:03}" for i in range(6))}), ("furry", {"Terrain_Furry"})],
)
def test_hair_covers_as_much_as_in_cycles(messy: Messy, name: str, strands: set[str]) -> None:
    """Strands are a few pixels wide: edges of their prisms are off by a fifth of a radius, but not the covered area."""
    asset = messy.asset(name)
    assert asset.instance_gives_way.all()
    assert set(asset.instance_names) == strands
    assert asset.ground_names == ("Terrain",)
    for pictures in (name, f"{name}.tidy"):
        for exported, drawn in zip(messy.silhouettes(name), messy.shown(pictures), strict=True):
            assert iou(exported, drawn) >= 0.95
            assert exported.sum() == pytest.approx(drawn.sum(), rel=0.02)


def test_planned_angles_turn_parts_as_blender_does(messy: Messy) -> None:
    turned, shown = {"turret": math.radians(70), "gun": math.radians(12)}, messy.shown("keyframes_turned")
    assert min(map(iou, messy.silhouettes("keyframes", turned), shown)) >= 0.99
    assert min(map(iou, messy.silhouettes("keyframes"), shown)) < 0.93, "the angles have no effect"


@pytest.mark.parametrize("name", ["keyframes", "linked", "centimeters", "y_up", "faces_minus_y", "glb", "fbx"])
def test_parts_pivots_and_axes_survive_parents_units_and_formats(messy: Messy, name: str) -> None:
    shape = messy.asset(name)
    report = messy.exported[name].report
    assert shape.part_names == ("hull", "turret", "gun")
    assert shape.part_parent.tolist() == [-1, 0, 1]
    assert shape.part_axis[1].tolist() == [0.0, 0.0, 1.0]
    # Modeled pivots: turret (0.5, 0.1, 1.5), gun (1, 0, 0.4) from it, underside 0.5.
    stretch = {"keyframes": 1.1, "linked": 1.5}.get(name, 1.0)
    low, high = shape.part_pivot[1, 2], shape.part_pivot[2, 2]
    assert low == pytest.approx(1.0 * stretch, abs=1e-5)
    assert high == pytest.approx(1.4 * stretch, abs=1e-5)
    apart = shape.part_pivot[2] - shape.part_pivot[1]
    assert math.hypot(*apart[:2]) == pytest.approx(stretch, abs=1e-5)
    # The gun rises about the horizontal axis across its direction.
    assert np.cross(shape.part_axis[2], apart / stretch)[2] == pytest.approx(1.0, abs=1e-3)
    assert [p.why for p in report.parts] == ["origin of the empty 'Turret'", "origin of the empty 'Gun'"]


@pytest.mark.parametrize("name", ["centimeters", "y_up", "faces_minus_y", "glb", "fbx", "obj"])
def test_units_and_axes_give_the_same_vehicle(messy: Messy, name: str) -> None:
    shape, plain = messy.asset(name), messy.asset("library_vehicle")
    assert np.allclose(shape.size_xyz, plain.size_xyz, atol=2e-5)
    assert np.allclose(shape.mesh.bounds, plain.mesh.bounds, atol=2e-5)
    assert np.allclose(_sorted(shape.mesh.triangles.mean(axis=1)), _sorted(plain.mesh.triangles.mean(axis=1)), atol=2e-5)


def _sorted(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(np.round(points, 3).T)]


def test_an_export_in_a_separate_process(messy: Messy, tmp_path: Path) -> None:
    exported = export_asset(messy.folder / "clutter.blend", tmp_path)
    assert exported.report.kind == "vehicle", "the kind is detected"
    shape = load_vehicle(exported.bundle)
    assert shape.name == "clutter"
    assert np.array_equal(shape.mesh.vertices, messy.asset("clutter").mesh.vertices)
    assert np.allclose(transform_points(np.linalg.inv(shape.vehicle_from_file), [[0.0, 0.0, 0.0]])[0, 2], 0.5)
    assert np.array_equal(shape.underside, vehicle_underside(shape.mesh).heights), "stored for planning"
    with pytest.raises(AssetError, match=r"turret = 'Turm' matches nothing"):
        export_asset(messy.folder / "clutter.blend", tmp_path, options=Options(turret="Turm"))
