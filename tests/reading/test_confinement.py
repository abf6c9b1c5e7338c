"""Asset files that try to read a secret outside their folders, or to write there, with and without Landlock.

The kernel reports which files were opened (inotify).
"""

import ctypes
import os
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import orjson
import pytest

from hulldown.base.errors import AssetError
from hulldown.cluster.scheduler import Scheduler
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library
from hulldown.plan.plan_file import read_plan
from hulldown.plan.row import decode_row
from hulldown.planning.write import write_plan
from hulldown.reading.confinement.landlock import landlock_version
from hulldown.reading.reader_process import export_asset
from hulldown.render.blender.messages import CyclesSettings
from hulldown.render.jobs import make_render_job
from hulldown.render.pool import Engine
from hulldown.render.process import Blender, Confinement
from hulldown.render.supervisor import render_remaining_images
from hulldown.tests.builders.blender_plans import run_script
from hulldown.tests.builders.clusters import cluster
from hulldown.tests.builders.parameters import few
from hulldown.tests.builders.render_plans import cube_library, make_row, moved

OPEN, ACCESS = 0x20, 0x01  # from inotify(7)
WRITES_WHEN_OPENED = ("particles", "paint", "fluid")
WRITERS = (*WRITES_WHEN_OPENED, "outputs")
pytestmark = pytest.mark.blender
needs_landlock = pytest.mark.xfail(not landlock_version(), reason="this kernel has no Landlock", run=False)


class Opened:
    """Names of the files in a folder that any process has opened since this object was made."""

    def __init__(self, folder: Path) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._queue = libc.inotify_init1(os.O_NONBLOCK)
        assert libc.inotify_add_watch(self._queue, os.fsencode(folder), OPEN | ACCESS) >= 0, ctypes.get_errno()

    def names(self) -> set[str]:
        """Return the new names."""
        found = set()
        while True:
            try:
                events = os.read(self._queue, 1 << 16)
            except BlockingIOError:
                return found
            while events:
                *_, size = struct.unpack_from("iIII", events)
                found.add(events[16 : 16 + size].rstrip(b"\0").decode().split(".")[0])
                events = events[16 + size :]


@pytest.fixture(scope="module")
def attack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in `mine` whose assets try to reach `secret` and `target`."""
    folder = tmp_path_factory.mktemp("attack")
    for name in ("mine/assets", "secret", "target"):
        (folder / name).mkdir(parents=True)
    run_script("attack_files.py", "build", folder / "mine/assets", folder / "secret", folder / "target")
    return folder


def written(folder: Path) -> set[str]:
    """Paths of all files, except for the project's output."""
    return {str(path) for path in folder.rglob("*") if "mine/out" not in str(path)}


def cleaned(folder: Path) -> set[str]:
    """The same after removing what earlier attempts left."""
    for left in [*folder.glob("target/*"), *folder.glob("mine/assets/blendcache*")]:
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    return written(folder)


@needs_landlock
def test_a_file_with_all_attacks_reads_and_writes_nothing_outside(attack: Path, tmp_path: Path) -> None:
    before, opened = written(attack), Opened(attack / "secret")
    report = export_asset(attack / "mine/assets/all/everything.blend", tmp_path, kind="scenery").report
    missing = {Path(missing.path).name for missing in report.missing}
    assert {"image.png", "relative.png", "udim.<UDIM>.png", "font.ttf", "linked.blend"} <= missing, "missing files are reported"
    assert opened.names() == set()
    assert written(attack) == before


@needs_landlock
def test_texts_and_tables_next_to_an_asset_are_not_imported(attack: Path, tmp_path: Path) -> None:
    report = export_asset(attack / "mine/assets/all/neighbors.blend", tmp_path, kind="vehicle").report
    assert report.triangles == 3 * 12, "three cubes, and nothing imported"
    assert sum("is left out, since it isn't a model or picture" in doubt.text for doubt in report.doubts) == 3


@needs_landlock
@pytest.mark.thorough
def test_blender_without_precautions_opens_the_secrets(attack: Path) -> None:
    """This shows that the attacks work."""
    opened = Opened(attack / "secret")
    secrets = {path.name.split(".")[0] for path in (attack / "secret").iterdir()}
    run_script("attack_files.py", "open", *(path for path in assets(attack) if path.stem in secrets))
    assert secrets <= opened.names()


@pytest.mark.parametrize("case", few(WRITES_WHEN_OPENED, "particles"))
def test_these_files_write_when_blender_opens_them(attack: Path, case: str) -> None:
    """This shows that the attacks work."""
    before = cleaned(attack)
    run_script("attack_files.py", "open", attack / f"mine/assets/{case}.blend", check=False)
    assert written(attack) > before


@pytest.mark.parametrize("case", WRITERS)
def test_the_list_of_risky_features_alone_stops_them_when_read(
    attack: Path, tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HULLDOWN_CONFINEMENT", "off")
    before = cleaned(attack)
    exported = export_asset(attack / f"mine/assets/{case}.blend", tmp_path, kind="vehicle")
    assert written(attack) == before
    lost = [doubt.text for doubt in exported.report.doubts if "since its cache isn't in the file" in doubt.text]
    assert len(lost) == (case in ("fluid", "paint"))
    assert {p.name for p in tmp_path.iterdir()} == {"bundle.npz", "picture.png", "tidy.blend", "answer.json"}


@pytest.mark.parametrize("role", ["scenery", "vehicle"])
def test_the_list_of_risky_features_alone_stops_them_when_rendered(
    attack: Path, tmp_path: Path, role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker renders a file in place of a prepared one, as in a cache that came with a plan."""
    monkeypatch.setenv("HULLDOWN_CONFINEMENT", "off")
    before, folder = cleaned(attack), attack / "mine/assets"
    settings = CyclesSettings(samples=1, denoise=False, adaptive_threshold=0.0, bounces=0)
    jobs = []
    for case in WRITERS:
        files = {"scenery": "nothing", "vehicle": "nothing", role: case}
        there = {role: folder / f"{name}.blend" for role, name in files.items()}
        library = cube_library(folder)
        library = replace(
            library,
            models={"cube": moved(library.models["cube"], there["vehicle"])},
            sceneries={"void": moved(library.sceneries["void"], there["scenery"])},
        )
        row = decode_row(orjson.dumps(make_row(0)))
        jobs.append(make_render_job(row, library, settings, tmp_path / f"{case}.png"))
    with Blender(tmp_path / "log", device="cpu", confinement=Confinement(tmp_path, ())) as blender:
        assert not any(blender.do(job).reasons for job in jobs)
    assert {path.stem for path in tmp_path.glob("*.png")} == set(WRITERS)
    assert written(attack) == before


@pytest.fixture(scope="module")
def planned(attack: Path) -> Path:
    """The plan of all readable files, one image each; making it must not reach anything."""
    before, opened, sound = written(attack), Opened(attack / "secret"), []
    for path in assets(attack):
        try:
            load_library(config(attack, [path]))
        except AssetError:
            continue
        sound.append(path)
    assert len(sound) > 20
    made = config(attack, sound)
    plan = write_plan(made, load_library(made).assets, attack / "mine/out/plan.jsonl")
    assert opened.names() == set()
    assert written(attack) == before
    return plan.path


@needs_landlock
@pytest.mark.thorough
@pytest.mark.parametrize("where", ["here", "cluster"])
def test_no_attack_succeeds_from_plan_to_picture(attack: Path, planned: Path, where: str, tmp_path: Path) -> None:
    before, opened, out = written(attack), Opened(attack / "secret"), attack / "mine/out" / where
    if where == "here":
        report = render_remaining_images(planned, out, engine=Engine(device="cpu"))
    else:
        with cluster(tmp_path / "nodes", 1) as nodes:
            report = render_remaining_images(planned, out, engine=Engine(scheduler=Scheduler(nodes.address), device="cpu"))
    assert report.failed == ()
    assert report.rendered == len(read_plan(planned))
    assert opened.names() == set()
    assert written(attack) == before


def assets(attack: Path) -> list[Path]:
    suffixes = (".blend", ".gltf", ".obj", ".fbx")
    return [path for path in sorted(attack.glob("mine/assets/*.*")) if path.suffix in suffixes and not path.is_symlink()]


def config(attack: Path, vehicles: list[Path]):
    data = {
        "assets": {
            "hdris": ["assets/sky.exr"],
            "vehicles": [
                {"path": f"assets/{path.name}", "name": path.stem, "category": "box", "allow_missing": True}
                for path in vehicles
            ],
            "sceneries": [{"path": "assets/all/everything.blend"}],
            "cache": "out/cache",
        },
        "budget": {"images_per_class": len(vehicles)},
        "render": {"width": 32, "height": 24, "samples": 1},
    }
    return Config.of(data, path=attack / "mine/hulldown.toml")
