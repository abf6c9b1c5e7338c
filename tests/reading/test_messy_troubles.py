"""Messages about files that are incomplete, broken, hostile, or read differently from how they render."""

from pathlib import Path

import pytest

from hulldown.base.errors import AssetError
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.reader_process import export_asset
from hulldown.tests.builders.messy_export import Messy

pytestmark = pytest.mark.blender
DAMAGED = {
    "truncated": "Blender cannot read it (Missing DNA block)",
    "scrambled": "Blender cannot read it",
    "newer": "was written by Blender 9.1, newer than the 5.",
    "newer_compressed": "was written by Blender 9.1, newer than the 5.",
}


def test_missing_files_are_listed_with_their_users(messy: Messy) -> None:
    missing = {Path(m.path).name: m.wanted_by for m in messy.exported["textured"].report.missing}
    pictureless = "the picture of the material 'Turret'"
    assert missing == {"gone.png": ("Turret",), "nested_gone.exr": ("Turret",), pictureless: ("Turret",)}
    assert [Path(m.path).name for m in messy.exported["lost_library"].report.missing] == ["soon_gone.blend"]
    assert any("gone.png, used by 'Turret'" in doubt.text for doubt in messy.exported["textured"].report.doubts)
    files = {Path(f).name for f in messy.exported["textured"].files}
    assert {"there.png", "gone.png"} <= files
    assert {Path(f).name for f in messy.exported["linked"].files} == {"library_vehicle.blend"}


def test_scripts_and_drivers_of_a_file_never_run(messy: Messy) -> None:
    assert not (messy.folder / "ran").exists()


@pytest.mark.parametrize(("name", "problem"), DAMAGED.items())
def test_a_damaged_file_is_a_one_line_error(messy: Messy, name: str, problem: str) -> None:
    text = str(messy.errors[name])
    assert text.startswith(f"{messy.folder / name}.blend: {problem}")
    assert "\n" not in text
    assert messy.errors[name].remedy


def test_the_error_of_a_file_without_visible_objects_names_what_hides_them(messy: Messy) -> None:
    assert "nothing that is rendered: 'Hull' is hidden from render with its collection 'Off'" in str(messy.errors["nothing"])


def test_nothing_is_lost_or_added(messy: Messy) -> None:
    lost = {name: [str(d) for d in found.report.doubts if d.kind == DoubtKind.LOST] for name, found in messy.exported.items()}
    assert not any(lost.values()), lost


@pytest.mark.blender
def test_differences_from_the_render_are_reported(messy: Messy) -> None:
    doubts = "\n".join(map(str, messy.exported["odd_ones"].report.doubts))
    for words in (
        "only the scene 'Scene' is read, not 'Other'",
        "only the view layer 'ViewLayer' is read, not 'Second'",
        "'Hull' is subdivided adaptively",
        "'Rough' is displaced by its material 'rough'",
    ):
        assert words in doubts
    rows = {row.name: row for row in messy.exported["odd_ones"].report.rows}
    assert rows["Strands"].why == "hair isn't part of a vehicle"
    furry = [(row.use, row.why) for row in messy.exported["odd_ones"].report.rows if row.name == "Furry"]
    assert sorted(furry) == [("dropped", "hair isn't part of a vehicle"), ("hull", "by default")]


@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("no.blend", None, "does not exist"),
        (f"{'x' * 300}.blend", None, "cannot be read (File name too long)"),
        ("empty.blend", b"", "is empty"),
        ("cipher.blend", bytes(range(7, 256)), "isn't a .blend file: it doesn't begin like one"),
        ("model.max", b"anything", "is another file, not a vehicle or scenery; expected one of .blend, .glb"),
        ("lfs.blend", b"version https://git-lfs.github.com/spec/v1\n", "is only a pointer to a file in Git LFS"),
        ("lfs.obj", b"version https://git-lfs.github.com/spec/v1\n", "is only a pointer to a file in Git LFS"),
        ("scene.gltf", b"{]", "isn't readable glTF ("),
        ("ktx.gltf", b'{"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]}', "textures[0] has a picture"),
        ("model.glb", b"BLENDER17-01v0500", "isn't a .glb file"),
    ],
)
def test_files_refused_without_starting_blender(tmp_path: Path, file: str, content: bytes | None, problem: str) -> None:
    if content is not None:
        (tmp_path / file).write_bytes(content)
    with pytest.raises(AssetError) as caught:
        export_asset(tmp_path / file, tmp_path, kind="vehicle")
    assert str(caught.value).startswith(f"{tmp_path / file}: {problem}")
    assert "\n" not in str(caught.value)
