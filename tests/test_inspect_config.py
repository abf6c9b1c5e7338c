"""`hulldown inspect` of a config, which reads files with their options."""

import json
import math
from pathlib import Path

import pytest
from PIL import Image

from hulldown import cli
from hulldown.planning.inputs.inspection import inspect_file
from hulldown.tests.blender_plans import run_python
from hulldown.tests.test_found_assets import SKY

FILES = """
from hulldown.tests.blend_parts import cuboid, fresh, save
fresh()
cuboid("Hull", (300, 600, 100), (0, 0, 50))
cuboid("Turret", (200, 200, 100), (0, 0, 150))
cuboid("Crate", (200, 200, 200), (500, 0, 100))
save("tank.blend")
fresh()
cuboid("Lawn", (100, 100, 1), (0, 0, 0))
cuboid("Rock", (2, 2, 2), (0, 0, 1))
save("park.blend")
"""
CONFIG = """
[assets]
hdris = ["*.hdr"]
vehicles = [
    { path = "tank.blend", category = "tank", scale = 0.01, forward = "+y", drop = ["Crate"], turret_limits_deg = 30 },
]
sceneries = [{ path = "park.blend" }]

[ground]
include = ["Lawn"]

[budget]
images_per_class = 1
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    run_python("-c", FILES, cwd=folder)
    (folder / "sky.hdr").write_bytes(SKY)
    (folder / "hulldown.toml").write_text(CONFIG, encoding="utf-8")
    return folder


@pytest.mark.blender
def test_the_files_of_a_config_are_read_with_its_options(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(project)
    assert cli.main(["inspect", "hulldown.toml", "tank.blend", "--json", "-o", "all.png"]) == 0
    tank, park, alone = json.loads(capsys.readouterr().out)
    assert [(found["kind"], found["path"]) for found in (tank, park, alone)] == [
        ("vehicle", "tank.blend"),
        ("scenery", "park.blend"),
        ("vehicle", "tank.blend"),
    ]
    assert tank["size"] == pytest.approx([6.0, 3.0, 2.0])
    assert tank["unit"] == 0.01
    assert {row["name"]: row["use"] for row in tank["rows"]} == {
        "Hull": "hull",
        "Turret": "turret",
        "Crate": "dropped",
    }
    assert tank["parts"][0]["limits"] == pytest.approx([math.radians(30), math.radians(30)])
    assert {row["name"]: row["use"] for row in park["rows"]} == {"Lawn": "ground", "Rock": "obstacle"}
    assert max(alone["size"]) > 100
    assert alone["parts"][0]["limits"] != tank["parts"][0]["limits"]
    with Image.open("all.png") as image:
        assert image.width > 3 * 960


@pytest.mark.blender
def test_files_read_for_a_plan_are_not_read_again(project: Path) -> None:
    inspect_file(project / "hulldown.toml")
    read: list[str] = []
    inspect_file(project / "hulldown.toml", progress=read.append)
    assert read == []
    inspect_file(project / "park.blend", progress=read.append)
    assert read == [str(project / "park.blend")]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("scale = ", "hulldown: hulldown.toml: isn't TOML: Invalid value (at end of document)"),
        ("scale = 1", "hulldown: hulldown.toml: assets is missing (and 2 more)"),
        (CONFIG, "hulldown: hulldown.toml: assets.hdris: '*.hdr' matches no file"),
        (CONFIG.replace("*.hdr", "sky.hdr"), "hulldown: tank.blend: does not exist"),
    ],
)
def test_a_mistake_in_a_config_is_a_one_line_error(
    text: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hulldown.toml").write_text(text, encoding="utf-8")
    if "sky.hdr" in text:
        Path("sky.hdr").write_bytes(SKY)
    assert cli.main(["inspect", "hulldown.toml"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(line)
    assert printed.err.count("\n") == 1


def test_an_existing_page_of_another_program_is_found_before_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    many = "".join(f'{{ path = "{k}.blend", category = "tank" }},' for k in range(12))
    Path("hulldown.toml").write_text(
        f'[assets]\nvehicles = [{many}]\nsceneries = [{{ path = "park.blend" }}]\n[budget]\nimages_per_class = 1\n'
    )
    Path("all-2.png").write_bytes(b"of somebody else")
    assert cli.main(["inspect", "hulldown.toml", "-o", "all.png"]) == 2
    assert capsys.readouterr().err.startswith("hulldown: all-2.png: exists and wasn't drawn by hulldown")
