"""`hulldown inspect`: the report about a file or those of a config, its table, and pictures."""

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.table import Table

from hulldown import cli
from hulldown.base.errors import AssetError, HulldownError
from hulldown.base.terminal import Terminal
from hulldown.planning.inputs.inspection import inspect_file
from hulldown.reading.inspect import MAX_FULL_SIZE_ASSETS, ROLE_COLORS, Inspected, draw_asset, write_inspection_picture
from hulldown.reading.pieces.asset_report import FileReport, MaterialRow, ObjectRow
from hulldown.tests.builders.blender_plans import run_python
from hulldown.tests.builders.shapes import box, scenery_of, vehicle_of
from hulldown.tests.planning.test_found_assets import SKY
from hulldown.verbs import output
from hulldown.verbs.output import print_lines_and_tables

FILES = """
import bpy
from hulldown.tests.builders.blend_parts import cuboid, fresh, save
fresh()
bpy.context.scene.unit_settings.scale_length = 0.01
cuboid("Hull", (4, 4, 4), (0, 0, 2))
cuboid("Turret", (2, 2, 2), (0, 0, 4.5))
material = bpy.data.materials.new("paint")
image = bpy.data.images.new("gone", 1, 1)
image.source, image.filepath = "FILE", "//gone.png"
material.node_tree.nodes.new("ShaderNodeTexImage").image = image
bpy.data.objects["Hull"].data.materials.append(material)
save("tiny/tiny.blend")
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
sceneries = [{ path = "park.blend", ground = ["Lawn"] }]

[budget]
images_per_class = 1
"""
LONG = "Panzerkampfwagen_Geschuetzrohr_Muendungsbremse_links_oben_" * 3 + "1"
VEHICLE = vehicle_of(box((-3, -1.5, 0), (3, 1.5, 1)), box((-1, -1, 1), (1, 1, 2)))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    run_python("-c", FILES, cwd=folder)
    (folder / "sky.hdr").write_bytes(SKY)
    (folder / "hulldown.toml").write_text(CONFIG, encoding="utf-8")
    return folder


def hue_of(pixels: np.ndarray) -> np.ndarray:
    """Index of the part color of each shaded pixel, -1 for paper and ink."""
    length = np.linalg.norm(pixels, axis=-1, keepdims=True)
    near = (pixels / np.maximum(length, 1)) @ (ROLE_COLORS / np.linalg.norm(ROLE_COLORS, axis=1, keepdims=True)).T
    return np.where(near.max(axis=-1) > 0.995, near.argmax(axis=-1), -1)


def test_the_picture_shows_each_part_in_its_color() -> None:
    size = 200
    image = np.asarray(draw_asset(VEHICLE, size=size)).astype(float)
    assert image.shape == (2 * size, 2 * size, 3)
    scale = size / (6 * 1.25)  # pixels per meter in the view from the left, which the length fills
    left = hue_of(image[:size, :size])
    middle = left[:, size // 2 + 20]
    # From top to bottom: turret (upper meter), hull (lower meter).
    assert (middle == 1).sum() == pytest.approx(scale, abs=2)
    assert (middle == 0).sum() == pytest.approx(scale, abs=2)
    assert np.flatnonzero(middle == 1).max() < np.flatnonzero(middle == 0).min()
    for view in (image[:size, size:], image[size:, :size], image[size:, size:]):
        assert {0, 1} <= set(np.unique(hue_of(view)))


def test_a_model_is_drawn_whose_bar_of_meters_is_rounded_below_a_power_of_ten() -> None:
    # 0.24 m * 1.25 / 3 is 0.09999999999999999 m, whose logarithm is -1: fuzzing found it.
    model = vehicle_of(box((-0.12, -0.06, 0), (0.12, 0.06, 0.04)), box((-0.04, -0.04, 0.04), (0.04, 0.04, 0.08)))
    assert draw_asset(model, size=120).width == 240


@pytest.mark.parametrize("ground", [True, False])
def test_a_scenery_is_drawn(ground: bool) -> None:
    land = box((-50, -50, -1), (50, 50, 0)) if ground else None
    scenery = scenery_of("s", land, obstacles=[box((0, 0, 0), (5, 5, 5))], which=[0], poses=np.eye(4))
    image = np.asarray(draw_asset(scenery, size=120)).astype(float)
    green = hue_of(image[120:, 120:])[30:, :] == 3
    assert bool(green.sum() > 1000) is ground


@pytest.mark.blender
def test_a_file_is_inspected(project: Path) -> None:
    folder = project / "tiny"
    path = folder / "tiny.blend"
    (inspected,) = inspect_file(path, pictures=True)
    found = inspected.report
    assert found.kind == "vehicle"
    assert found.unit == 0.01
    assert found.size == pytest.approx((0.04, 0.04, 0.055))
    assert [(row.name, row.use, row.triangles) for row in found.rows] == [("Hull", "hull", 12), ("Turret", "turret", 12)]
    assert [Path(m.path).name for m in found.missing] == ["gone.png"]
    assert found.missing[0].wanted_by == ("Hull",)
    assert any("5.5 cm long; set scale = 1 (now 0.01)" in doubt.text for doubt in found.doubts)
    write_inspection_picture([inspected], folder / "tiny.png")
    with Image.open(folder / "tiny.png") as image:
        assert image.size == (960, 960)
    assert sorted(p.name for p in folder.iterdir()) == ["tiny.blend", "tiny.png"]
    with pytest.raises(AssetError, match=r"gone\.png is missing, used by Hull"):
        inspect_file(path, strict=True)
    with pytest.raises(HulldownError, match="cannot be written"):
        write_inspection_picture([inspected], path / "x.png")


def test_many_pictures_are_half_as_large(tmp_path: Path) -> None:
    # One sheet with all of the demo's assets had 3,000 x 8,000 pixels.
    report = FileReport("vehicle", "a.blend", (1.0, 1.0, 1.0), 12, 1.0, "z")
    many = [Inspected(f"v{k}", report, Image.new("RGB", (96, 96))) for k in range(2 * MAX_FULL_SIZE_ASSETS)]
    few, more = (tmp_path / name for name in ("few.png", "more.png"))
    write_inspection_picture(many[:MAX_FULL_SIZE_ASSETS], few)
    write_inspection_picture(many, more)
    with Image.open(few) as large, Image.open(more) as small:
        assert abs(large.width - small.width) < 20
        assert large.height > small.height > large.height / 2


@pytest.mark.blender
def test_the_files_of_a_config_are_read_with_its_options(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(project)
    assert cli.main(["inspect", "hulldown.toml", "gone.blend", "tank.blend", "--json", "-o", "all.png"]) == 2
    printed = capsys.readouterr()
    assert "gone.blend: does not exist" in printed.err
    tank, park, alone = json.loads(printed.out)
    assert [(found["kind"], found["path"]) for found in (tank, park, alone)] == [
        ("vehicle", "tank.blend"),
        ("scenery", "park.blend"),
        ("vehicle", "tank.blend"),
    ]
    assert tank["size"] == pytest.approx([6.0, 3.0, 2.0])
    assert tank["unit"] == 0.01
    assert {row["name"]: row["use"] for row in tank["rows"]} == {"Hull": "hull", "Turret": "turret", "Crate": "dropped"}
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
        ("scale = ", "hulldown.toml: isn't TOML: Invalid value (at end of document)"),
        ("scale = 1", "hulldown.toml: assets is missing (and 2 more)"),
        (CONFIG, "hulldown.toml: assets.hdris: '*.hdr' matches no file"),
        (CONFIG.replace("*.hdr", "sky.hdr"), "tank.blend: does not exist"),
        ("of somebody else", "all.png: exists and isn't a picture by hulldown"),
    ],
)
def test_a_mistake_in_a_config_or_a_picture_of_another_program_is_a_one_line_error(
    text: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hulldown.toml").write_text(text, encoding="utf-8")
    if "all.png" in line:
        Path("all.png").write_bytes(b"of somebody else")
    if "sky.hdr" in text:
        Path("sky.hdr").write_bytes(SKY)
    assert cli.main(["inspect", "hulldown.toml", "-o", "all.png"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"hulldown: {line}")
    assert printed.err.count("\n") == 1


def report(*rows: ObjectRow) -> FileReport:
    return FileReport("vehicle", "a.blend", (6.0, 3.0, 2.0), 12, 1.0, "z", rows=rows)


def shown(monkeypatch: pytest.MonkeyPatch, table: Table, **console: object) -> str:
    file = io.StringIO()
    monkeypatch.setattr(output, "STDOUT_TERMINAL", Terminal(file=file, highlight=False, **console))
    print_lines_and_tables(table)
    return file.getvalue()


def test_a_name_with_a_line_break_stays_in_one_line() -> None:
    odd = replace(report(), materials=(MaterialRow("Ty\nre", 1.0),))
    assert odd.lines()[-1] == "materials: Ty\\nre (100 %)"


def test_a_piped_table_has_whole_names_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    # They were cut at 80 columns, but `drop` needs them; every verb shows its tables this way.
    text = shown(monkeypatch, report(ObjectRow(LONG, "MESH", "hull", "by default")).table())
    assert any(LONG in line for line in text.splitlines())


def test_a_terminal_shows_every_character_of_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    text = shown(monkeypatch, report(ObjectRow(LONG, "MESH", "hull", "by default")).table(), force_terminal=True, width=80)
    cells = [line.split("│")[1].strip() for line in text.splitlines() if line.count("│") > 2]
    assert LONG in "".join(cells)
    assert "…" not in text


def test_objects_dropped_for_one_reason_share_a_row() -> None:
    # Hidden and dropped objects filled 16 of 24 rows.
    hidden = [ObjectRow(f"helper {k} of mine", "MESH", "dropped", "hidden from render", 1, 5) for k in "abcdefghijklmnop"]
    named = [ObjectRow(f"lamp {k} x", "LIGHT", "dropped", f"{f'lamp {k} x'!r} matches 'lamp'") for k in "abc"]
    lone = ObjectRow("bound", "MESH", "dropped", "'bound' matches 'bound'")
    table = report(hidden[0], ObjectRow("body", "MESH", "hull", "by default"), *hidden[1:], lone, *named).table()
    rows = list(zip(*(column.cells for column in table.columns[:4]), strict=True))
    assert [row[0].split(",")[0] for row in rows] == ["body", "helper a of mine", "bound", "lamp a x"]
    assert rows[1][0].endswith("helper l of mine and 4 more")
    assert rows[1][3] == "16"
    assert rows[3][2] == "its name matches 'lamp'"


@pytest.mark.parametrize("count", [1, 2])
def test_a_few_dropped_objects_keep_their_rows(count: int) -> None:
    rows = [ObjectRow(f"a{k}x", "MESH", "dropped", "hidden from render") for k in range(count)]
    assert report(*rows).table().row_count == count
