"""Files as people bring them: what is exported of them is what Cycles shows of them."""

import json
import math
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from assets.bundle import load_scenery, load_vehicle
from assets.scenery import Scenery
from assets.vehicle import VehicleShape
from geometry.errors import AssetError
from geometry.instances import InstancedScene
from geometry.meshes import Mesh
from geometry.rays import RayCaster
from geometry.transforms import apply
from render.reading.build import Options
from render.reading.export import Exported, export, export_vehicle, exported_by, job_for

pytestmark = pytest.mark.blender
HERE = Path(__file__).resolve().parent
SIZE, FOV = 160, math.radians(40)  # of messy_blends.py
VEHICLES = [
    *("modifiers", "clutter", "instances", "keyframes", "keyframes_turned", "collections", "no_origins", "surfaces"),
    *("centimetres", "y_up", "faces_minus_y", "armature", "linked", "textured", "lost_library", "malicious"),
    "nodes",
]
SCENERIES = ["scattered", "unnamed"]
DAMAGED = {
    "truncated": "Blender cannot read it (Missing DNA block)",
    "scrambled": "Blender cannot read it",
    "newer": "was written by Blender 9.1, newer than the 5.",
    "newer_compressed": "was written by Blender 9.1, newer than the 5.",
}


@dataclass
class Messy:
    """The built files, what was made of them, and Cycles' view of them."""

    folder: Path
    cases: dict
    exported: dict[str, Exported]
    errors: dict[str, AssetError]

    def asset(self, name: str) -> VehicleShape | Scenery:
        exported = self.exported[name]
        return (load_vehicle if exported.report.kind == "vehicle" else load_scenery)(exported.bundle)

    def vehicle(self, name: str) -> VehicleShape:
        return load_vehicle(self.exported[name].bundle)

    def scenery(self, name: str) -> Scenery:
        return load_scenery(self.exported[name].bundle)

    def cameras(self, name: str) -> list[np.ndarray]:
        return [np.array(c) for c in self.cases[name]["cameras"]]

    def shown(self, name: str) -> list[np.ndarray]:
        return [_alpha(self.folder / f"{name}.{i}.png") for i in range(2)]

    def uses(self, name: str) -> dict[str, set[str]]:
        uses: dict[str, set[str]] = {}
        for row in self.exported[name].report.rows:
            uses.setdefault(row.name, set()).add(row.use)
        return uses


def _alpha(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)[..., 3] > 127


def _python(*arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.fixture(scope="module")
def messy(tmp_path_factory: pytest.TempPathFactory) -> Messy:
    folder = tmp_path_factory.mktemp("messy")
    builder = str(HERE / "messy_blends.py")
    _python(builder, str(folder), "build")
    cases = json.loads((folder / "cases.json").read_text())
    jobs = {}

    def add(name: str, file: str, **about: object) -> None:
        (folder / f"out_{name}").mkdir()
        jobs[name] = job_for(folder / file, folder / f"out_{name}", **about)
        (folder / f"{name}.job").write_text(json.dumps(jobs[name]))

    for name, about in cases.items():
        add(name, f"{name}.blend", kind=about["kind"], options=Options(**about["options"]))
    for suffix in ("glb", "fbx", "obj"):
        # The first two were made of a model that lies on its side in Blender; OBJ files are y up by themselves.
        add(suffix, f"imported.{suffix}", kind="vehicle", options=Options(up=None if suffix == "obj" else "y"))
    for name, content in _damaged((folder / "malicious.blend").read_bytes()).items():
        (folder / f"{name}.blend").write_bytes(content)
        add(name, f"{name}.blend", kind="vehicle")
    # One process for all of them, which is not how it is done in earnest but starts Blender once.
    _python("-m", "render.reading.reader", *(str(folder / f"{name}.job") for name in jobs))
    exported, errors = {}, {}
    for name, job in jobs.items():
        try:
            exported[name] = exported_by(job, json.loads(Path(job["answer"]).read_text()))
        except AssetError as error:
            errors[name] = error
    made = Messy(folder, cases, exported, errors)
    twins = {
        name: {
            "kind": exported[name].report.kind,
            "path": str(exported[name].tidy),
            "hide": cases[name]["hide"],
            "cameras": [_into_asset(made.asset(name), c).tolist() for c in made.cameras(name)],
        }
        for name in [*VEHICLES, *SCENERIES, "map_in_mesh", "map_in_object"]
    }
    (folder / "tidy.json").write_text(json.dumps(twins))
    _python(builder, str(folder), "tidy")
    return made


def _damaged(sound: bytes) -> dict[str, bytes]:
    import gzip

    rng = np.random.default_rng(7)
    scrambled = np.frombuffer(sound, np.uint8).copy()
    scrambled[200:] = rng.integers(0, 256, len(sound) - 200)
    newer = sound[:13] + b"0901" + sound[17:]
    return {
        "truncated": sound[: len(sound) // 2],
        "scrambled": scrambled.tobytes(),
        "newer": newer,
        "newer_compressed": gzip.compress(newer),
    }


def _into_asset(asset: VehicleShape | Scenery, camera: np.ndarray) -> np.ndarray:
    """A camera of the file's world in the asset's frame."""
    into = asset.vehicle_from_file if isinstance(asset, VehicleShape) else asset.scenery_from_file
    return into @ camera


def _silhouette(asset: VehicleShape | Scenery, camera: np.ndarray, articulation: dict | None = None) -> np.ndarray:
    """What a camera in the asset's frame sees of the exported geometry, by one ray through each pixel's middle."""
    focal = SIZE / 2 / math.tan(FOV / 2)
    across = (np.arange(SIZE) + 0.5 - SIZE / 2) / focal
    x, y = np.meshgrid(across, -across)
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ camera[:3, :3].T
    origins = np.repeat(camera[None, :3, 3], len(directions), axis=0)
    if isinstance(asset, VehicleShape):
        posed = Mesh(asset.vertices_at(articulation or {}), asset.mesh.faces)
        return RayCaster(posed).cast(origins, directions).hit.reshape(SIZE, SIZE)
    seen = InstancedScene(asset.obstacle_meshes, asset.instance_mesh, asset.world_from_instance)
    hit = seen.cast(origins, directions).hit
    if asset.ground is not None:
        hit |= RayCaster(asset.ground).cast(origins, directions).hit
    return hit.reshape(SIZE, SIZE)


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    assert min(a.sum(), b.sum()) > 500, "a silhouette that small shows nothing"
    return float((a & b).sum() / (a | b).sum())


@pytest.mark.parametrize("name", [*VEHICLES, *SCENERIES])
def test_the_exported_silhouette_is_what_cycles_shows(messy: Messy, name: str) -> None:
    asset = messy.asset(name)
    for camera, shown in zip(messy.cameras(name), messy.shown(name), strict=True):
        assert _iou(_silhouette(asset, _into_asset(asset, camera)), shown) >= 0.99


@pytest.mark.parametrize("name", [*VEHICLES, *SCENERIES, "map_in_mesh", "map_in_object"])
def test_the_tidy_twin_renders_as_the_exported_geometry(messy: Messy, name: str) -> None:
    asset = messy.asset(name)
    for i, camera in enumerate(messy.cameras(name)):
        tidy = _alpha(messy.folder / f"{name}.tidy.{i}.png")
        assert _iou(_silhouette(asset, _into_asset(asset, camera)), tidy) >= 0.99


def test_planned_angles_turn_what_blender_would_turn(messy: Messy) -> None:
    shape = messy.vehicle("keyframes")
    turned = {"turret": math.radians(70), "gun": math.radians(12)}
    at_rest = []
    for camera, shown in zip(messy.cameras("keyframes"), messy.shown("keyframes_turned"), strict=True):
        seen = _into_asset(shape, camera)
        assert _iou(_silhouette(shape, seen, turned), shown) >= 0.99
        at_rest.append(_iou(_silhouette(shape, seen), shown))
    assert min(at_rest) < 0.93, "the angles do not show"


@pytest.mark.parametrize("name", ["keyframes", "linked", "centimetres", "y_up", "faces_minus_y", "glb", "fbx"])
def test_parts_pivots_and_axes_survive_parents_units_and_formats(messy: Messy, name: str) -> None:
    shape = messy.vehicle(name)
    report = messy.exported[name].report
    assert shape.part_names == ("hull", "turret", "gun")
    assert shape.part_parent.tolist() == [-1, 0, 1]
    assert shape.part_axis[1].tolist() == [0.0, 0.0, 1.0]
    # Modelled pivots: turret (0.5, 0.1, 1.5), gun (1, 0, 0.4) from it, underside 0.5.
    stretch = {"keyframes": 1.1, "linked": 1.5}.get(name, 1.0)
    low, high = shape.part_pivot[1, 2], shape.part_pivot[2, 2]
    assert low == pytest.approx(1.0 * stretch, abs=1e-5)
    assert high == pytest.approx(1.4 * stretch, abs=1e-5)
    apart = shape.part_pivot[2] - shape.part_pivot[1]
    assert math.hypot(*apart[:2]) == pytest.approx(stretch, abs=1e-5)
    # The gun rises about the horizontal across its own direction.
    assert np.cross(shape.part_axis[2], apart / stretch)[2] == pytest.approx(1.0, abs=1e-3)
    assert [p.why for p in report.parts] == ["origin of the empty 'Turret'", "origin of the empty 'Gun'"]


@pytest.mark.parametrize("name", ["centimetres", "y_up", "faces_minus_y", "glb", "fbx", "obj"])
def test_units_and_axes_are_made_alike(messy: Messy, name: str) -> None:
    shape, plain = messy.vehicle(name), messy.vehicle("library_vehicle")
    assert np.allclose(shape.size_xyz, plain.size_xyz, atol=2e-5)
    assert np.allclose(shape.mesh.bounds, plain.mesh.bounds, atol=2e-5)
    assert np.allclose(
        _sorted(shape.mesh.triangles.mean(axis=1)), _sorted(plain.mesh.triangles.mean(axis=1)), atol=2e-5
    )


def _sorted(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(np.round(points, 3).T)]


def test_what_is_not_the_vehicle_is_dropped_and_the_reason_is_given(messy: Messy) -> None:
    rows = {row.name: row for row in messy.exported["clutter"].report.rows}
    reasons = {
        "Floor": "says 'floor' and reaches",
        "Object_17": "a flat sheet",
        "shadowCatcher.002": "says 'shadow catcher'",
        "UCX_Hull_01": "says 'ucx'",
        "Backdrop": "says 'backdrop'",
        "ground": "lies at the underside",
        "ref_side": "says 'ref' and reaches",
        "Catcher": "a shadow catcher",
        "Ghost": "invisible to the camera",
        "Key": "type light",
        "Camera": "type camera",
    }
    for name, why in reasons.items():
        assert rows[name].use == "dropped"
        assert why in rows[name].why
    assert {n for n, row in rows.items() if row.use != "dropped"} == {
        *("Hull", "Nose", "Dome", "Tube", "Cabin_Floor", "Plane.004")
    }


def test_hidden_from_render_is_out_and_hidden_from_view_is_in(messy: Messy) -> None:
    uses = messy.uses("modifiers")
    assert uses["EyeHidden"] == {"hull"}
    assert messy.uses("instances")["MonitorHidden"] == {"hull"}
    for name in ("RenderHidden", "InHidden", "InExcluded", "InIndirect", "InHoldout"):
        assert uses[name] == {"dropped"}


def test_loose_vertices_do_not_count(messy: Messy) -> None:
    assert messy.vehicle("surfaces").mesh.vertices[:, 2].max() < 4


def test_origins_left_at_zero_are_not_believed(messy: Messy) -> None:
    shape = messy.vehicle("no_origins")
    reports = messy.exported["no_origins"].report
    inside = shape.mesh.vertices[shape.vertex_part == 1]
    assert np.allclose(shape.part_pivot[1, :2], (inside.min(axis=0) + inside.max(axis=0))[:2] / 2)
    assert all("is not where" in part.why for part in reports.parts)
    assert sum("turns about" in doubt for doubt in reports.doubts) == 2


def test_a_turret_may_be_a_collection_or_a_bone(messy: Messy) -> None:
    report = messy.exported["collections"].report
    assert report.parts[0].why == "origin of 'pivot', named pivot"
    assert messy.uses("collections") == {"Body": {"hull"}, "a": {"turret"}, "b": {"turret"}, "c": {"gun"}}
    assert messy.exported["armature"].report.parts[0].why == "origin of 'turret'"


def test_scenery_ground_and_obstacles(messy: Messy) -> None:
    scenery = messy.scenery("scattered")
    assert sorted(scenery.ground_names) == ["Cube.001", "Ground_cubes", "Ground_spread"]
    names = list(scenery.instance_names)
    assert (names.count("Oak"), names.count("Pebble"), names.count("Ground_cubes")) == (12 + 3, 9 + 3, 4)
    # Oak, pebble, and the cube of the geometry nodes: one mesh each, however often they stand there.
    assert len(scenery.obstacle_meshes) == 3
    assert messy.uses("scattered")["Skydome"] == {"backdrop"}
    for name in ("Volume", "Terrain_LOD1", "Terrain_LOD2"):
        assert messy.uses("scattered")[name] == {"dropped"}
    assert sum(row.count for row in messy.exported["scattered"].report.rows if row.name == "Oak") == 15


def test_no_ground_is_said_with_the_names_that_are_there(messy: Messy) -> None:
    assert messy.scenery("unnamed").ground is None
    (doubt,) = [d for d in messy.exported["unnamed"].report.doubts if d.startswith("NO GROUND")]
    assert "'Mesh', 'Thing'" in doubt


def test_map_coordinates_in_the_object_keep_what_hangs_on_it(messy: Messy) -> None:
    scenery = messy.scenery("map_in_object")
    assert scenery.origin.tolist() == [500_000.0, 5_400_000.0, 0.0]
    assert scenery.ground is not None
    assert np.allclose(scenery.ground.bounds[:, :2], [[-32, -32], [32, 32]], atol=1e-5)
    # In float32, Blender's own matrices, this would be 3.0 or 3.03125 and 2.5 or 3.0.
    assert np.allclose(scenery.world_from_instance[0, :3, 3], [3.14159, 2.71828, 201.41421], atol=1e-6)


def test_map_coordinates_in_the_mesh_are_those_of_the_file(messy: Messy) -> None:
    scenery = messy.scenery("map_in_mesh")
    assert scenery.origin.tolist() == [500_000.0, 5_400_000.0, 0.0]
    assert scenery.ground is not None
    held = np.unique(np.float32(np.linspace(-32, 32, 5) + 5_400_000.0).astype(float) - 5_400_000.0)
    assert np.unique(scenery.ground.vertices[:, 1]).tolist() == held.tolist()


def test_missing_files_are_named_with_who_wants_them(messy: Messy) -> None:
    missing = {Path(m.path).name: m.wanted_by for m in messy.exported["textured"].report.missing}
    assert missing == {"gone.png": ("Turret",), "nested_gone.exr": ("Turret",)}
    assert [Path(m.path).name for m in messy.exported["lost_library"].report.missing] == ["soon_gone.blend"]
    assert any("gone.png, which 'Turret' wants" in doubt for doubt in messy.exported["textured"].report.doubts)
    files = {Path(f).name for f in messy.exported["textured"].files}
    assert {"there.png", "gone.png"} <= files
    assert {Path(f).name for f in messy.exported["linked"].files} == {"library_vehicle.blend"}


def test_a_file_never_runs_its_scripts_and_drivers(messy: Messy) -> None:
    assert not (messy.folder / "ran").exists()


@pytest.mark.parametrize(("name", "problem"), DAMAGED.items())
def test_a_damaged_file_is_one_clear_line(messy: Messy, name: str, problem: str) -> None:
    text = str(messy.errors[name])
    assert text.startswith(f"{messy.folder / name}.blend: {problem}")
    assert "\n" not in text
    assert messy.errors[name].remedy


def test_a_mesh_without_numbers_is_named(messy: Messy) -> None:
    text = str(messy.errors["no_numbers"])
    assert text.startswith(f"{messy.folder / 'no_numbers.blend'}: object 'Hull': mesh 'Hull': vertex 3 is [")
    assert "nan" in text


def test_nothing_that_is_rendered_is_no_vehicle(messy: Messy) -> None:
    assert "no vehicle is left after clean-up; in it is nothing that is rendered" in str(messy.errors["nothing"])


def test_what_is_read_otherwise_than_rendered_is_said(messy: Messy) -> None:
    doubts = "\n".join(messy.exported["odd_ones"].report.doubts)
    for said in (
        "only the scene 'Scene' is read, not 'Other'",
        "only the view layer 'ViewLayer' is read, not 'Second'",
        "'Hull' is subdivided adaptively",
        "'Rough' is displaced by its material 'rough'",
        "the hair 'p' of 'Furry' is left out",
    ):
        assert said in doubts
    rows = {row.name: row for row in messy.exported["odd_ones"].report.rows}
    assert rows["Strands"].why == "hair curves have no faces"


def test_what_nodes_make_belongs_to_the_part_that_carries_it(messy: Messy) -> None:
    uses = messy.uses("nodes")
    assert uses["Knob"] == {"hull"}
    assert uses["Turret"] == {"turret"}
    assert messy.vehicle("nodes").mesh.bounds[1, 0] > 3.1


@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("no.blend", None, "does not exist"),
        (f"{'x' * 300}.blend", None, "cannot be read (File name too long)"),
        ("empty.blend", b"", "is empty"),
        ("cipher.blend", bytes(range(7, 256)), "is no .blend file: it does not begin like one"),
        ("model.max", b"anything", "is of a format that is not read; expected one of .blend, .glb"),
        ("lfs.blend", b"version https://git-lfs.github.com/spec/v1\n", "is only a pointer to a file in Git LFS"),
        ("old.fbx", b"; FBX 6.1.0 project file\n", "is an ASCII FBX file"),
        ("scene.gltf", b"{]", "is no .gltf file"),
        ("model.glb", b"BLENDER17-01v0500", "is no .glb file"),
    ],
)
def test_refused_without_asking_blender(tmp_path: Path, file: str, content: bytes | None, problem: str) -> None:
    if content is not None:
        (tmp_path / file).write_bytes(content)
    with pytest.raises(AssetError) as caught:
        export_vehicle(tmp_path / file)
    assert str(caught.value).startswith(f"{tmp_path / file}: {problem}")
    assert "\n" not in str(caught.value)


def test_an_export_in_its_own_process(messy: Messy, tmp_path: Path) -> None:
    exported = export(messy.folder / "clutter.blend", tmp_path, name="leopard")
    assert exported.report.kind == "vehicle", "judged by what is in it"
    shape = load_vehicle(exported.bundle)
    assert shape.name == "leopard"
    assert np.array_equal(shape.mesh.vertices, messy.vehicle("clutter").mesh.vertices)
    assert np.allclose(apply(np.linalg.inv(shape.vehicle_from_file), [[0.0, 0.0, 0.0]])[0, 2], 0.5)
    with pytest.raises(AssetError, match=r"turret = 'Turm' matches nothing"):
        export(messy.folder / "clutter.blend", tmp_path, options=Options(turret="Turm"))
