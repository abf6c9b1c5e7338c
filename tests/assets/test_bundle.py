import io
import resource
import zipfile
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import BUNDLE_FORMAT, load_scenery, load_vehicle, save_asset
from hulldown.assets.plan_assets import asset_fingerprint
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError
from hulldown.geometry.alpha import TEXEL_GRADES, AlphaMap, Cutouts, Extension
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.tests.builders.shapes import scenery_of, vehicle_of

TRIANGLES = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1 / 3, 1e-17, 5.4e6 + 1 / 7]]), np.array([[0, 1, 2], [1, 2, 3]]))


def vehicle() -> VehicleShape:
    shape = vehicle_of(TRIANGLES, TRIANGLES, name="Škoda 7·ü", pivots=[[0, 0, 0], [0.1, 0.2, 0.3]])
    return replace(
        shape,
        mesh=replace(shape.mesh, name="a mesh"),
        vehicle_from_file=np.diag([0.01, 0.01, 0.01, 1]),
        underside=np.array([[0.1, np.inf], [0.0, 1 / 3]]),
    )


def scenery(*, ground: bool = True, obstacles: bool = True) -> Scenery:
    which = [0, 0, 1] if obstacles else []
    made = scenery_of(
        "field",
        TRIANGLES if ground else None,
        origin=(5e5, 5.4e6, 0.0),
        obstacles=[replace(TRIANGLES, name="tree", extreme=np.array([0, 2, 3])), TRIANGLES] if obstacles else (),
        which=which,
        poses=[np.eye(4)] * len(which),
    )
    return replace(made, instance_gives_way=np.array(which, bool), instance_is_water=~np.array(which, bool))


def content(value: object) -> object:
    """A value in a form that's equal only if all types and bits are."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return [content(each) for each in value]
    if is_dataclass(value):
        return type(value), {field.name: content(getattr(value, field.name)) for field in fields(value)}
    return type(value), value


def test_a_vehicle_round_trips_bit_for_bit(tmp_path: Path) -> None:
    save_asset(tmp_path / "v.npz", vehicle())
    assert content(load_vehicle(tmp_path / "v.npz")) == content(vehicle())


@pytest.mark.parametrize(("ground", "obstacles"), [(True, True), (False, True), (True, False), (False, False)])
def test_a_scenery_round_trips_bit_for_bit(tmp_path: Path, ground: bool, obstacles: bool) -> None:
    made = scenery(ground=ground, obstacles=obstacles)
    save_asset(tmp_path / "s.npz", made)
    assert content(load_scenery(tmp_path / "s.npz")) == content(made)


def test_a_fingerprint_tells_a_moved_vertex_and_a_turned_face_from_rounding() -> None:
    shape = vehicle()
    corners, faces = shape.mesh.vertices, shape.mesh.faces

    def agrees(**changes: np.ndarray) -> bool:
        other = replace(shape, name="other", mesh=replace(shape.mesh, **changes), underside=np.full((1, 1), np.inf))
        return asset_fingerprint(shape).agrees_with_other(asset_fingerprint(other))

    assert agrees(vertices=corners * (1 + 1e-13))
    moves = 1e-3 * np.eye(corners.size).reshape(-1, *corners.shape)
    assert not any(agrees(vertices=corners + move) for move in moves)
    assert not agrees(faces=faces[:, ::-1])


def test_holes_round_trip_and_each_texture_is_stored_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    curve = (TEXEL_GRADES > 0.4).astype(np.float32)
    soft = AlphaMap(rng.integers(0, 256, (8, 8)).astype(np.uint8))
    stepped = AlphaMap(soft.texels, Extension.CLIP, smooth=False, curve=curve)
    floats = AlphaMap(np.full((2, 3), 0.25, dtype=np.float32))
    uv = rng.random((2, 3, 2)).astype(np.float32)
    one, two = (Cutouts(np.arange(2), uv, np.array([0, 1]), maps) for maps in ((soft, stepped), (floats, soft)))
    made = scenery_of(
        "leaves",
        replace(TRIANGLES, cutouts=one),
        obstacles=[replace(TRIANGLES, cutouts=two), TRIANGLES],
        which=[0],
        poses=[np.eye(4)],
    )
    save_asset(tmp_path / "s.npz", made)
    found = load_scenery(tmp_path / "s.npz")
    assert content(found) == content(made)
    ground, card = found.ground.cutouts, found.obstacle_meshes[0].cutouts
    assert np.shares_memory(ground.maps[0].texels, ground.maps[1].texels)
    assert np.shares_memory(ground.maps[0].texels, card.maps[1].texels)
    with np.load(tmp_path / "s.npz") as file:
        assert len(file["uint8"]) == 64, "stored once"
    both, _ = merge_meshes_with_sources([found.ground, found.obstacle_meshes[0]])
    assert len(both.cutouts.maps) == 3, "the same texture, looked up alike, is one again"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A vehicle's bundle."""
    save_asset(tmp_path / "v.npz", vehicle())
    return tmp_path / "v.npz"


def zip_again(path: Path, method: int = zipfile.ZIP_STORED, **changed: bytes) -> None:
    with zipfile.ZipFile(path) as bundle:
        arrays = {name: bundle.read(name) for name in bundle.namelist()}
    with zipfile.ZipFile(path, "w", method) as bundle:
        for name, data in arrays.items():
            bundle.writestr(name, changed.get(name.removesuffix(".npy"), data))


def test_an_interrupted_save_keeps_the_old_bundle(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def no_room(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", no_room)
    with pytest.raises(OSError, match="no space left"):
        save_asset(path, replace(vehicle(), name="new"))
    assert list(path.parent.iterdir()) == [path]
    assert path.read_bytes() == before


def test_a_file_that_is_not_a_bundle_is_a_one_line_error(path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    np.savez(tmp_path / "future.npz", hulldown_bundle=np.int64(99), kind=np.str_("vehicle"))
    np.savez(tmp_path / "partial.npz", hulldown_bundle=np.int64(BUNDLE_FORMAT), kind=np.str_("vehicle"))
    np.save(tmp_path / "single.npy", np.zeros(3))
    save_asset(tmp_path / "scenery.npz", scenery())
    np.savez(tmp_path / "pickled.npz", hulldown_bundle=np.array([{}], dtype=object), kind=np.str_("vehicle"))
    for name, content, problem in (
        ("cut.npz", whole[: len(whole) // 2], "cannot be read as a bundle"),
        ("empty.npz", b"", "cannot be read as a bundle"),
        ("missing.npz", None, "does not exist"),
        ("other.npz", None, "isn't a hulldown bundle"),
        ("future.npz", None, f"is a bundle of format 99, this is {BUNDLE_FORMAT}"),
        ("partial.npz", None, "cannot be read as a bundle ('tree is not a file in the archive')"),
        ("scenery.npz", None, "is a bundle of a scenery, expected a vehicle"),
        ("single.npy", None, "cannot be read as a bundle"),
        ("pickled.npz", None, "cannot be read as a bundle"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(AssetError) as caught:
            load_vehicle(tmp_path / name)
        assert str(caught.value).startswith(f"{tmp_path / name}: {problem}"), name
        assert "\n" not in str(caught.value)


BEYOND = '{"name": "t", "mesh": {"name": "m", "vertices": ["float64", 0, 9, 3], "faces": ["int64", 0, 1, 3]}}'


@pytest.mark.parametrize("tree", ["{", "{}", "[1]", BEYOND])
def test_a_bundle_that_lacks_fields_or_arrays_is_a_one_line_error(tmp_path: Path, tree: str) -> None:
    path, arrays = tmp_path / "v.npz", {"float64": np.zeros(3), "int64": np.zeros(3, int)}
    np.savez(path, hulldown_bundle=np.int64(BUNDLE_FORMAT), kind=np.str_("vehicle"), tree=np.str_(tree), **arrays)
    with pytest.raises(AssetError, match=r"v\.npz: cannot be read as a bundle .*delete the file"):
        load_vehicle(path)


@pytest.mark.parametrize(("at", "value"), [(6, 250), (8, 1), (8, 64), (10, 8), (10, 99)])
def test_a_damaged_directory_is_a_one_line_error(path: Path, at: int, value: int) -> None:
    content = bytearray(path.read_bytes())
    entry = content.find(b"PK\x01\x02")
    while entry >= 0:
        content[entry + at] = value
        entry = content.find(b"PK\x01\x02", entry + 1)
    path.write_bytes(content)
    with pytest.raises(AssetError, match="cannot be read as a bundle"):
        load_vehicle(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
def test_a_bundle_that_decompresses_to_a_multiple_is_refused(path: Path, method: int) -> None:
    """16 MB took 9 GB of memory."""
    zip_again(path, method)
    with pytest.raises(AssetError, match=r"cannot be read as a bundle .*compressed"):
        load_vehicle(path)


@pytest.mark.parametrize("shape", [10**9, 10**14])
def test_an_array_larger_than_the_file_is_refused(path: Path, shape: int) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (shape, 3)})
    zip_again(path, float64=header.getvalue() + bytes(24))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(AssetError, match="cannot be read as a bundle"):
        load_vehicle(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**18  # KiB


def test_a_fingerprint_of_infinite_coordinates_is_a_number():
    @dataclass
    class Asset:
        bounds: np.ndarray

    found = asset_fingerprint(Asset(np.array([np.inf, -np.inf, np.nan, 1.0])))
    assert np.isfinite(found.shape)
