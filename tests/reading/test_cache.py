"""The cache of exports, with a stand-in for Blender."""

import json
import os
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

import hulldown.reading.cache
import hulldown.reading.hdri
from hulldown.assets.bundle import save_asset
from hulldown.assets.skylight import SkyLight
from hulldown.base.errors import AssetError, ConfigError
from hulldown.base.outside import file_sha256
from hulldown.geometry.meshes import Mesh
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library, load_planned_library
from hulldown.plan.plan_file import Plan
from hulldown.planning.planner import Planner
from hulldown.planning.search.pairs import Pairs
from hulldown.planning.write import make_plan_header
from hulldown.reading.cache import cached_export_and_digest
from hulldown.reading.confinement.landlock import landlock_version
from hulldown.reading.hdri import FoundSky
from hulldown.reading.pieces.asset_report import FileReport, Missing
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import Exported, exported_in_folder
from hulldown.tests.builders.shapes import scenery_of, vehicle_of

ODD = Doubt(DoubtKind.SCALE, "odd")

BLEND = b"BLENDER17-01v0500"
MESH = Mesh(np.eye(3), np.array([[0, 1, 2]]))


class Exporter:
    """A stand-in for Blender: writes a bundle, and lists the files that the asset refers to."""

    def __init__(self) -> None:
        self.read: list[str] = []
        self.files: tuple[str, ...] = ()
        self.missing: tuple[Missing, ...] = ()
        self.parts = 1

    def __call__(self, path: Path, folder: Path, *, kind: str, **_: object) -> Exported:
        self.read.append(path.name)
        folder = Path(folder)
        made = vehicle_of(*[MESH] * self.parts, name=path.stem) if kind == "vehicle" else scenery_of(path.stem, MESH)
        save_asset(folder / "bundle.npz", made)
        (folder / "tidy.blend").write_bytes(BLEND)
        report = FileReport(kind, str(path), (1.0, 1.0, 1.0), 1, 1.0, "z", missing=self.missing, doubts=(ODD,))
        return exported_in_folder(folder, report, self.files)


@pytest.fixture
def exporter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Exporter:
    stand_in = Exporter()
    monkeypatch.setattr(hulldown.reading.cache, "export_asset", stand_in)
    sky = FoundSky(SkyLight(), ())
    monkeypatch.setattr(hulldown.reading.hdri, "run_reader_jobs", lambda jobs, limits: None)
    monkeypatch.setattr(hulldown.reading.hdri, "read_job_answer", lambda job, kind: sky)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return stand_in


@pytest.fixture
def blend(tmp_path: Path) -> Path:
    path = tmp_path / "tank.blend"
    path.write_bytes(BLEND + b" content")
    return path


@pytest.fixture
def read(exporter: Exporter, blend: Path, tmp_path: Path) -> Callable[..., bool]:
    """A function that reads through the cache and returns whether the file was exported."""

    def run(path: Path = blend, kind: str = "vehicle", **options: object) -> bool:
        before, lines = len(exporter.read), []
        exported, digest = cached_export_and_digest(
            path, tmp_path / "cache", kind=kind, options=Options(**options), progress=lines.append
        )
        assert len(digest) == 64
        assert exported.bundle.is_file()
        assert exported.report.path == str(path)
        new = len(exporter.read) > before
        assert lines == [str(path)] * new
        return new

    return run


def test_other_content_options_and_kind_give_other_entries(read: Callable[..., bool], blend: Path) -> None:
    assert [read(), read(scale=0.01), read(keep=("a",)), read(kind="scenery")] == [True] * 4
    blend.write_bytes(BLEND + b" altered")
    assert read()
    blend.write_bytes(BLEND + b" content")
    assert not read(), "the older entry is still there"


def test_a_picture_that_is_put_near_for_a_missing_one_counts(
    read: Callable[..., bool], exporter: Exporter, tmp_path: Path
) -> None:
    # It was named model://car/textures/camo.png, so nothing appears at the place that the file names.
    exporter.missing = (Missing(f"{tmp_path}/model://car/textures/Camo.png", ("hull",)),)
    assert [read(), read()] == [True, False]
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "camo.png").write_bytes(b"green")
    assert [read(), read()] == [True, False]


def test_changes_of_textures_and_libraries_count(
    read: Callable[..., bool], exporter: Exporter, tmp_path: Path, blend: Path
) -> None:
    there, gone = tmp_path / "there.png", tmp_path / "gone.png"
    there.write_bytes(b"red")
    exporter.files = (str(there), str(gone))
    assert [read(), read()] == [True, False]
    there.write_bytes(b"red")
    assert not read(), "rewritten with the same content"
    there.write_bytes(b"sea")
    assert [read(), read()] == [True, False]
    gone.write_bytes(b"found")
    assert [read(), read()] == [True, False]
    there.unlink()
    assert [read(), read()] == [True, False]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "tank.blend").write_bytes(blend.read_bytes())
    assert read(tmp_path / "other" / "tank.blend"), "its relative paths lead to other files there"


@pytest.mark.skipif(not landlock_version(), reason="without confinement, Blender reads it too")
@pytest.mark.parametrize("link", [False, True])
def test_files_outside_the_folders_of_an_asset_are_not_opened(
    read: Callable[..., bool], exporter: Exporter, tmp_path: Path, blend: Path, link: bool
) -> None:
    """An unconfined process hashed them."""
    asset = tmp_path / "pack" / "models" / "tank.blend"
    asset.parent.mkdir(parents=True)
    blend.rename(asset)
    named = secret = tmp_path / "secret.png"
    secret.write_bytes(b"red")
    if link:
        named = asset.with_name("picture.png")
        named.symlink_to(secret)
    exporter.files = (str(named),)
    assert [read(asset), read(asset)] == [True, False]
    secret.write_bytes(b"blue")
    assert not read(asset), "as if it didn't exist"


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:9])


def piped(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def endless(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def forged(entry: Path, **note: object) -> None:
    """Rewrite an entry as somebody without the user's key could."""
    seal, body = (entry / "entry.json").read_bytes().split(b"\n", 1)
    sealed = json.loads(body)
    sealed["note"].update(note)
    sealed["content"] = {name: file_sha256(entry / name) for name in sealed["content"]}
    (entry / "entry.json").write_bytes(seal + b"\n" + json.dumps(sealed, indent=1).encode())


def of_another_asset(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\0")
    forged(path.parent)


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        *[(name, harm) for name in ("entry.json", "bundle.npz", "tidy.blend") for harm in (cut, piped, endless)],
        *[(name, harm) for name in ("bundle.npz", "tidy.blend") for harm in (Path.unlink, of_another_asset)],
        *[("", partial(forged, files={file: [0, 0, "x"]})) for file in ("/dev/zero", "/dev/random")],
    ],
)
def test_an_entry_without_this_users_seal_is_replaced(
    read: Callable[..., bool], tmp_path: Path, name: str, harm: Callable[[Path], object]
) -> None:
    read()
    (entry,) = (tmp_path / "cache").glob("*/")
    was = (entry / "tidy.blend").read_bytes()
    harm(entry / name)
    assert [read(), read()] == [True, False]
    assert (entry / "tidy.blend").read_bytes() == was


def test_an_entry_moved_to_another_key_is_replaced(read: Callable[..., bool], tmp_path: Path) -> None:
    read()
    (first,) = (tmp_path / "cache").glob("*/")
    read(scale=0.01)
    (second,) = set((tmp_path / "cache").glob("*/")) - {first}
    shutil.rmtree(first)
    shutil.copytree(second, first)
    assert read()


def test_another_users_entries_are_not_used(read: Callable[..., bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert read()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    assert [read(), read()] == [True, False]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert not read(), "next to the first user's entry, which is still there"


def test_a_lock_that_is_a_link_is_refused_and_not_followed(read: Callable[..., bool], tmp_path: Path) -> None:
    read()
    (lock,) = (tmp_path / "cache").glob("*.lock")
    lock.unlink(missing_ok=True)
    (tmp_path / "precious").write_text("content")
    lock.symlink_to(tmp_path / "precious")
    with pytest.raises(AssetError, match=r"\.lock: cannot be opened"):
        read()
    assert (tmp_path / "precious").read_text() == "content"


def test_a_failed_export_leaves_nothing_behind(
    read: Callable[..., bool], exporter: Exporter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssetError("broken")

    monkeypatch.setattr(hulldown.reading.cache, "export_asset", fail)
    with pytest.raises(AssetError, match="broken"):
        read()
    assert [p.suffix for p in (tmp_path / "cache").iterdir()] == [".lock"]
    monkeypatch.setattr(hulldown.reading.cache, "export_asset", exporter)
    assert read()


VEHICLES = [{"path": "b.blend", "category": "small"}, {"path": "a.blend", "category": "large", "name": "T"}]


def config_in(folder: Path, *, vehicles: Sequence[dict] = VEHICLES) -> Config:
    for file in ("a.blend", "b.blend", "field.blend"):
        (folder / file).write_bytes(BLEND + file.encode())
    (folder / "sky.exr").write_bytes(b"#?sky")
    assets = {"hdris": ["*.exr"], "vehicles": vehicles, "sceneries": [{"path": "field.blend"}]}
    return Config.of({"assets": assets, "budget": {"images_per_class": 1}}, path=folder / "hulldown.toml")


def test_the_assets_of_a_config(exporter: Exporter, tmp_path: Path) -> None:
    library = load_library(config_in(tmp_path))
    assets = library.assets
    assert list(assets.vehicles) == ["b", "T"], "in the config's order"
    assert assets.vehicles["T"].name == "T", "named as in the config, whatever the name in the cache"
    assert assets.categories == {"b": "small", "T": "large"}
    assert list(assets.sceneries) == ["field"]
    assert assets.hdris == ("sky",)
    assert assets.files["vehicles"]["T"].path == "a.blend"
    assert assets.files["hdris"]["sky"].path == "sky.exr"
    assert len(assets.files["hdris"]["sky"].sha256) == 64
    odd = {str(tmp_path / file): [ODD] for file in ("b.blend", "a.blend", "field.blend")}
    assert library.doubts(backdrop=False) == odd
    load_library(config_in(tmp_path))
    assert sorted(exporter.read) == ["a.blend", "b.blend", "field.blend"]


def test_limits_in_the_config_replace_the_files_without_reading_it_again(exporter: Exporter, tmp_path: Path) -> None:
    exporter.parts = 3
    load_library(config_in(tmp_path))
    vehicles = [
        {"path": "a.blend", "category": "large", "turret_limits_deg": [-30, 45], "gun_limits_deg": 0},
        {"path": "b.blend", "category": "large", "gun_limits_deg": [-10, 60]},
    ]
    assets = load_library(config_in(tmp_path, vehicles=vehicles)).assets
    assert np.degrees(assets.vehicles["a"].part_limits) == pytest.approx(np.array([[0, 0], [-30, 45], [0, 0]]))
    assert assets.vehicles["b"].part_limits[1].tolist() == [-np.pi, np.pi], "the limits of the file"
    assert np.degrees(assets.vehicles["b"].part_limits[2]) == pytest.approx([-10, 60])
    assert len(exporter.read) == 3


def test_limits_of_a_missing_part_are_refused(exporter: Exporter, tmp_path: Path) -> None:
    config = config_in(tmp_path, vehicles=[{**VEHICLES[0], "gun_limits_deg": [0, 10]}])
    with pytest.raises(AssetError, match=r"b\.blend: gun_limits_deg is given, but no gun was found"):
        load_library(config)


def test_strict_refuses_missing_textures(exporter: Exporter, tmp_path: Path) -> None:
    exporter.missing = (Missing("/x/gone.png", ("Hull", "Skirt")), Missing("/x/more.png", ()))
    allowed = [{**vehicle, "allow_missing": True} for vehicle in VEHICLES]
    load_library(config_in(tmp_path, vehicles=allowed))
    for vehicles, strict in ((allowed, True), (VEHICLES, False)):
        with pytest.raises(AssetError) as caught:
            load_library(config_in(tmp_path, vehicles=vehicles), strict=strict)
        assert "b.blend: /x/gone.png is missing, used by Hull, Skirt (and 1 more)" in str(caught.value)


def planned(folder: Path, **assets_section: str) -> Plan:
    """A plan of `config_in`, with other values in its header's section of assets."""
    config = config_in(folder)
    assets = load_library(config).assets
    path = folder / "plan.jsonl"
    pairs = Pairs(np.ones((len(assets.vehicles), 1)), np.ones(1), ())  # no vehicle needs a place
    header = make_plan_header(Planner(config, assets, pairs=pairs), path)
    header.config["assets"].update(assets_section)
    return Plan(path, header)


@pytest.mark.parametrize("cache", ["../elsewhere", "images", "a/../../elsewhere", "$OUT"])
def test_a_plans_header_cannot_choose_where_to_write(exporter: Exporter, tmp_path: Path, cache: str) -> None:
    folder = tmp_path / "project"
    folder.mkdir()
    plan = planned(folder, cache=cache.replace("$OUT", str(tmp_path / "out")))
    before = set(tmp_path.rglob("*"))
    load_planned_library(plan)
    assert {path.relative_to(folder).parts[0] for path in set(tmp_path.rglob("*")) - before} <= {".hulldown-cache"}
    load_planned_library(plan, cache=tmp_path / "mine")
    assert (tmp_path / "mine").is_dir()


def test_a_cache_that_is_a_link_is_not_followed(exporter: Exporter, tmp_path: Path) -> None:
    plan = planned(tmp_path)
    (tmp_path / ".hulldown-cache").rename(tmp_path / "was")
    (tmp_path / ".hulldown-cache").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match=r"\.hulldown-cache: is a link; name the folder that it leads to by --cache"):
        load_planned_library(plan)
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    ("file", "content", "name"),
    [
        ("sky.exr", b"#?dusk", "hdris: 'sky'"),
        ("a.blend", BLEND + b"new", "vehicles: 'T'"),
        ("field.blend", BLEND + b"new", "sceneries: 'field'"),
    ],
)
def test_a_plan_is_refused_when_a_file_has_changed_since(
    exporter: Exporter, tmp_path: Path, file: str, content: bytes, name: str
) -> None:
    plan = planned(tmp_path)
    assert list(load_planned_library(plan).assets.vehicles) == ["b", "T"]
    (tmp_path / file).write_bytes(content)
    with pytest.raises(ConfigError, match=rf"{name} \({file}\) is not what it was"):
        load_planned_library(plan)


def test_a_plan_is_refused_where_a_file_gives_another_geometry(exporter: Exporter, tmp_path: Path) -> None:
    """As another Blender may read it; rounding is no difference."""
    plan = planned(tmp_path)

    def with_shape(meters: float) -> Plan:
        sources = dict(plan.header.vehicles)
        read = sources["T"].geometry
        assert read is not None
        sources["T"] = structs.replace(sources["T"], geometry=structs.replace(read, shape=read.shape + meters))
        return Plan(plan.path, structs.replace(plan.header, vehicles=sources))

    load_planned_library(with_shape(1e-9))
    with pytest.raises(ConfigError, match=r"vehicles: 'T' \(a.blend\) has another geometry here.*; plan again here"):
        load_planned_library(with_shape(1e-3))


def test_an_hdri_that_is_not_a_picture_is_refused(exporter: Exporter, tmp_path: Path) -> None:
    config = config_in(tmp_path)
    (tmp_path / "sky.exr").write_bytes(b"<html>")
    with pytest.raises(AssetError, match=r"sky.exr: isn't an OpenEXR or Radiance picture; copy it again"):
        load_library(config)
    assert exporter.read == [], "before the slow work"
