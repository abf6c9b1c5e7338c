"""`hulldown init DIR --from FOLDER`: a config for the user's files."""

from pathlib import Path

import pytest

from hulldown import cli
from hulldown.base.errors import AssetError
from hulldown.plan.config.schema import Config
from hulldown.plan.library import hdri_paths_by_name, load_library
from hulldown.planning.inputs.found_assets import (
    FoundFile,
    found_config_text,
    missing_asset_kinds,
    read_found_files,
    relative_asset_files,
)
from hulldown.planning.write import unstated_doubts
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.tests.builders.blender_plans import run_python

FILES = """
from hulldown.tests.builders.blend_parts import cuboid, fresh, save
fresh()
cuboid("Hull", (6, 3, 1), (0, 0, 0.5))
cuboid("Turret", (2, 2, 1), (0, 0, 1.5))
save("tank.blend")
save("mine/tanks/one/scene.blend")
fresh()
cuboid("Ground", (100, 100, 1), (0, 0, 0))
for x in (-40, 40):
    cuboid("Rock", (2, 2, 2), (x, 0, 1))
save("mine/outside/park.blend")
fresh()
for name, y in (("a", -4), ("b", 4)):
    cuboid(f"{name}_Hull", (6, 3, 1), (0, y, 0.5))
save("mine/pair/pair.blend")
"""
# Two rows of four pixels, in Radiance's format without run lengths.
SKY = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes([128, 130, 140, 129]) * 7 + bytes([9, 9, 9, 128])
SQUARE = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\n" + bytes([128, 130, 140, 129]) * 4


@pytest.mark.blender
def test_a_folder_becomes_a_config_with_findings_as_comments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run_python("-c", FILES)
    (tmp_path / "mine/trucks/scene.fbx").parent.mkdir()
    (tmp_path / "mine/trucks/scene.fbx").write_bytes(b"no FBX at all")
    (tmp_path / "mine/tanks/one/scene.obj").write_text("v 0 0 0\n")
    (tmp_path / "mine/tanks/normal.hdr").write_bytes(SQUARE)
    (tmp_path / "mine/sky [1].hdr").write_bytes(SKY)
    for name in ("a.usdc", "b.stl"):
        (tmp_path / "mine" / name).write_bytes(b"")
    (tmp_path / "mine/.cache").mkdir()
    (tmp_path / "mine/.cache/tidy.blend").write_bytes(b"")
    assert cli.main(["init", "project", "--from", "mine"]) == 0
    assert {path.name for path in Path("project").iterdir()} == {".hulldown-cache", "hulldown.toml"}
    told = " ".join(capsys.readouterr().err.split())
    assert "3 of 7 files aren't used" in told
    assert told.count("2 files are of formats that aren't read (.stl, .usdc), such as a.usdc") == 1
    config = Config.read("project/hulldown.toml")
    assert [(v.path, v.category, v.name) for v in config.assets.vehicles] == [
        ("../mine/pair/pair.blend", "pair", "pair_a_Hull"),
        ("../mine/pair/pair.blend", "pair", "pair_b_Hull"),
        ("../mine/tanks/one/scene.blend", "tanks", "scene"),
    ]
    assert [v.keep for v in config.assets.vehicles] == [("a_Hull",), ("b_Hull",), ()]
    read_again: list[str] = []
    library = load_library(config, progress=read_again.append)
    assert not read_again
    text = Path("project/hulldown.toml").read_text(encoding="utf-8")
    guess = 'path = "../mine/tanks/one/scene.blend"\ncategory = "tanks"\nforward = "+x"\n'
    assert guess in text
    Path("project/without.toml").write_text(text.replace('forward = "+x"\n', ""), encoding="utf-8")
    assert load_library(Config.read("project/without.toml")).assets.files == library.assets.files
    assert all(max(library.assets.vehicles[name].size_xyz) < 6.01 for name in ("pair_a_Hull", "pair_b_Hull"))
    assert [s.path for s in config.assets.sceneries] == ["../mine/outside/park.blend"]
    assert list(hdri_paths_by_name(config)) == ["sky [1]"]
    above = text.partition('path = "../mine/tanks/one/scene.blend"')[0].rpartition("\n\n")[2]
    assert "# size 6.00 x 3.00 x 2.00 m" in above
    assert "# turret on hull: pivot" in above
    assert "# doubt: " in above
    assert "# ground: Ground" in text
    assert "# not used: ../mine/trucks/scene.fbx: isn't a .fbx file" in text
    assert "# not used: ../mine/tanks/one/scene.obj: is called as scene.blend is" in text
    assert "# not used: ../mine/tanks/normal.hdr: is 2 x 2 pixels" in text
    assert "tidy" not in text
    listed = library.doubts(backdrop=True)
    assert any(listed.values())
    of_pair = [d for name in ("pair_a_Hull", "pair_b_Hull") for d in library.models[name].report.doubts]
    assert set(of_pair) == {d for path, some in listed.items() if "pair" in path for d in some}
    assert not any(unstated_doubts(listed, config).values())  # they're in its comments
    Path("project/other.toml").write_text(text, encoding="utf-8")
    assert unstated_doubts(listed, Config.read("project/other.toml")) == listed  # `init` didn't write this one
    new = {path: [*some, Doubt(DoubtKind.SCALE, "new")] for path, some in listed.items()}
    assert {str(doubt) for some in unstated_doubts(new, config).values() for doubt in some} == {"new"}
    assert cli.main(["inspect", "project/hulldown.toml"]) == 0
    assert cli.main(["init", "project", "--from", "mine"]) == 2  # and existing files stay
    assert text == Path("project/hulldown.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ({}, "mine: holds no .blend, .glb, .gltf, .fbx, .obj, .tif, .tiff, .exr, .hdr file; name the folder"),
        ({"readme.txt": b"x"}, "mine: holds no .blend"),
        ({"a.fbx": b"x", "b.exr": b"x"}, "mine: none of its 2 files can be used; a.fbx: isn't a .fbx file"),
        (None, "mine: is no folder; name the folder"),
    ],
)
def test_a_folder_without_assets_is_a_one_line_error(
    files: dict[str, bytes] | None, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    if files is not None:
        Path("mine").mkdir()
        for name, content in files.items():
            (Path("mine") / name).write_bytes(content)
    assert cli.main(["init", "project", "--from", "mine"]) == 2
    *bar, line = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hulldown: {problem}")
    assert len(bar) <= 1  # of progress, if files were read
    assert not Path("project").exists()


def test_files_with_equal_names_get_different_asset_names(tmp_path: Path) -> None:
    found = [
        FoundFile(Path("vehicles/tanks/a/scene.gltf"), "vehicle", ("a", "name with \x1b[2J")),
        FoundFile(Path("trucks/scene.gltf"), "vehicle", ()),
        FoundFile(Path("lone.glb"), "vehicle", (), material="Body"),
        FoundFile(Path("hills.blend"), "scenery", ()),
        FoundFile(Path("day/sky.exr"), "hdri", ()),
        FoundFile(Path("night/sky.exr"), "hdri", ()),
    ]
    path = tmp_path / "hulldown.toml"
    path.write_text(found_config_text(tmp_path / "assets", found, tmp_path), encoding="utf-8")
    assets = Config.read(path).assets
    assert [(v.path, v.name, v.category) for v in assets.vehicles] == [
        ("assets/vehicles/tanks/a/scene.gltf", "vehicles_tanks_a_scene", "tanks"),
        ("assets/trucks/scene.gltf", "trucks_scene", "trucks"),
        ("assets/lone.glb", "lone", "vehicle"),
    ]
    assert assets.hdris == ("assets/day/sky.exr",)
    assert not assets.vehicles[2].paint
    path.write_text(path.read_text(encoding="utf-8").replace("\n# paint = ", "\npaint = "), encoding="utf-8")
    assert [entry.materials for entry in Config.read(path).assets.vehicles[2].paint] == [("Body",)]
    assert "# not used: assets/night/sky.exr: is called as day/sky.exr is" in path.read_text(encoding="utf-8")
    assert "# name with \\x1b[2J" in path.read_text(encoding="utf-8")
    assert missing_asset_kinds(found) == []
    assert missing_asset_kinds(found[:3]) == ["scenery", "HDRI"]


def test_a_name_that_a_config_cannot_hold_is_not_listed(tmp_path: Path) -> None:
    (tmp_path / "tank\n\udcff.glb").write_bytes(b"glTF")
    with pytest.raises(AssetError, match=r"(?s)none of its 1 files can be used.*rename it"):
        read_found_files(tmp_path, relative_asset_files(tmp_path), tmp_path / "cache")


def test_init_bare_writes_only_the_config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["init", str(tmp_path / "mine"), "--bare"]
    assert cli.main(words) == 0
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["hulldown.toml"]
    assert Config.read(tmp_path / "mine" / "hulldown.toml").assets.vehicles[0].path == "vehicles/tank.blend"
    assert cli.main(words) == 2
    assert "is there already" in capsys.readouterr().err
