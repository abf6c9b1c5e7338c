"""Odd and malicious files are one-line errors with their name: no traceback, no wait, no unlimited memory."""

import json
import os
import struct
from pathlib import Path

import pytest

from hulldown.base.errors import AssetError
from hulldown.reading.confinement.references import refuse_odd_references
from hulldown.reading.confinement.watch import ReadLimits
from hulldown.reading.pieces.formats import file_format
from hulldown.reading.reader_process import export_asset
from hulldown.tests.builders.messy_export import Messy

LIMITS = ReadLimits(silence_s=120.0, memory_bytes=2 * 2**30)
TOO_LARGE = "GiB of memory, more than the limit of 2.00 GiB; make it smaller, leave it out, or raise"


def refused(path: Path, folder: Path, **more: object) -> str:
    with pytest.raises(AssetError) as caught:
        export_asset(path, folder, **{"limits": LIMITS, **more})
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.blender
@pytest.mark.parametrize(
    ("case", "line"),
    [
        ("nan_location", "object 'Body' has a position that isn't finite; repair or delete it"),
        ("nan_empty", "object 'pivot' has a position that isn't finite; repair or delete it"),
        ("far_location", "object 'Body' reaches 1e+20 m from the origin, more than 1e+08 m; move"),
        ("nan_vertices", "object 'Body': "),
        ("nan_strands", "object 'Body': the strands of 'Hair' have coordinates that aren't numbers; repair or delete"),
        ("empty_scene", "its active scene 'Empty' is empty, beside 'Scene'; choose a scene with objects"),
        ("library", "lib.blend, which is a FIFO, not a file"),
        ("library_compressed", "lib.blend, which is a FIFO, not a file"),
        ("font", "font.woff2, which is a FIFO, not a file"),
    ],
)
def test_an_odd_file_is_a_one_line_error(messy: Messy, case: str, line: str) -> None:
    error = str(messy.errors[case])
    assert error.startswith(f"{messy.folder / case}.blend: ")
    assert line in error
    assert "\n" not in error


@pytest.mark.blender
@pytest.mark.parametrize(
    ("case", "names"),
    [
        ("names", ["unnamed 0"]),
        ("bald", ["Body"]),
        ("hairy_body", ["Body", "Body"]),
        ("squashed_gun", ["Body", "Turret", "Gun"]),
        ("no_known_tree", ["Body"]),
    ],
)
def test_an_odd_file_is_read(messy: Messy, case: str, names: list[str]) -> None:
    assert [row.name for row in messy.exported[case].report.rows if row.triangles] == names


@pytest.mark.blender
def test_a_hundred_million_instances_end_at_the_memory_limit(messy: Messy, tmp_path: Path) -> None:
    assert TOO_LARGE in refused(messy.folder / "instances_without_end.blend", tmp_path, kind="scenery")


@pytest.mark.blender
def test_a_silent_reader_is_ended(messy: Messy, tmp_path: Path) -> None:
    line = refused(messy.folder / "names.blend", tmp_path, limits=ReadLimits(silence_s=0.2))
    assert "reading it got nowhere for 0.2 s, which is the limit" in line


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    (tmp_path / "folder.blend").mkdir()
    os.mkfifo(tmp_path / "fifo.blend")
    (tmp_path / "zero.glb").symlink_to("/dev/zero")
    (tmp_path / "loop.obj").symlink_to("loop.obj")
    (tmp_path / "round").symlink_to("round")
    for name, line in (
        ("folder.blend", "is a folder, not a file"),
        ("fifo.blend", "is a FIFO, not a file"),
        ("zero.glb", "is a device, not a file"),
        ("loop.obj", "cannot be read (Too many levels of symbolic links)"),
        ("round/a.blend", "cannot be read (Too many levels"),
    ):
        with pytest.raises(AssetError) as caught:
            file_format(tmp_path / name)
        assert line in str(caught.value)


GLTF = {
    "asset": {"version": "2.0"},
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"uri": "mesh%20.bin", "byteLength": 36}],
}


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"buffers": [{"uri": "zero.bin", "byteLength": 36}]}, "refers to zero.bin, which is a device, not a file"),
        ({"buffers": [{"uri": "fifo%2Ebin", "byteLength": 36}]}, "refers to fifo.bin, which is a FIFO, not a file"),
        ({"buffers": [{"uri": "../../../../../../../../dev/zero"}]}, "which is a device, not a file"),
        ({"images": [{"uri": "fifo.bin"}]}, "refers to fifo.bin, which is a FIFO"),
        ({"buffers": [{"uri": "mesh .bin", "byteLength": 99}]}, "buffers[0] has 99 bytes, but mesh .bin has 36"),
        ({"nodes": [{"mesh": 7}]}, "nodes[0].mesh = 7, but it has 1 meshes; export it again"),
        ("[" * 100_000, "isn't readable glTF (depth limit exceeded"),
        ('{"asset": {"version": "2.0"}, "nodes": [1, 2', "gltf|isn't readable glTF"),
        ("[]", "isn't glTF: it isn't a JSON object"),
        ({"asset": {"version": "1.0"}}, "is glTF 1.0, which Blender does not read; convert it to glTF 2.0"),
    ],
)
def test_the_error_of_a_malformed_gltf_names_the_problem(tmp_path: Path, change: object, line: str, binary: bool) -> None:
    (tmp_path / "mesh .bin").write_bytes(bytes(36))
    (tmp_path / "zero.bin").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "fifo.bin")
    text = change if isinstance(change, str) else json.dumps({**GLTF, **change})
    path = tmp_path / ("a.glb" if binary else "a.gltf")
    chunk = text.encode()
    path.write_bytes(b"glTF" + struct.pack("<III4s", 2, 20 + len(chunk), len(chunk), b"JSON") + chunk if binary else chunk)
    with pytest.raises(AssetError) as caught:
        refuse_odd_references(path, "gltf")
    assert line.removeprefix("gltf|") in str(caught.value)


PACKED = {"buffer": 0, "byteLength": 36, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}
MESHOPT = {
    "extensionsUsed": ["EXT_meshopt_compression"],
    "extensionsRequired": ["EXT_meshopt_compression"],
    "bufferViews": [{"buffer": 0, "byteLength": 36, "extensions": {"EXT_meshopt_compression": PACKED}}],
}


@pytest.mark.blender
@pytest.mark.parametrize(
    ("change", "line"),
    [
        pytest.param({"nodes": [{"children": [0]}]}, "export it again", id="wrong indices"),
        pytest.param(MESHOPT, "write it without EXT_meshopt_compression, with gltf-transform", id="compressed"),
        # Zeros without a buffer, which Blender makes up.
        pytest.param({"accessors": [{"componentType": 5126, "type": "VEC3", "count": 2**27}]}, TOO_LARGE, id="a bomb"),
    ],
)
def test_a_gltf_that_fails_in_blender_is_a_one_line_error(tmp_path: Path, change: dict, line: str) -> None:
    (tmp_path / "mesh .bin").write_bytes(bytes(36))
    (tmp_path / "a.gltf").write_text(json.dumps({**GLTF, **change}))
    assert line in refused(tmp_path / "a.gltf", tmp_path, kind="vehicle")


@pytest.mark.parametrize(
    ("text", "material", "line"),
    [
        ("mtllib fifo.mtl\n", "", "refers to fifo.mtl, which is a FIFO"),
        ("v 0 0 0\nmtllib a.mtl\n", "newmtl x\nmap_Kd -s 1 1 1 fifo.mtl\n", "refers to fifo.mtl, which is a FIFO"),
        ("mtllib a.mtl\n", "bump zero.png", "refers to zero.png, which is a device"),
    ],
)
def test_an_obj_that_refers_to_a_device_or_fifo_is_refused(tmp_path: Path, text: str, material: str, line: str) -> None:
    os.mkfifo(tmp_path / "fifo.mtl")
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    (tmp_path / "a.mtl").write_text(material)
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(AssetError, match=line):
        refuse_odd_references(tmp_path / "a.obj", "obj")


def test_the_json_of_a_gltf_has_a_size_limit(tmp_path: Path) -> None:
    with open(tmp_path / "hole.gltf", "wb") as file:
        file.truncate(2**36)
    with open(tmp_path / "hole.glb", "wb") as file:
        file.write(struct.pack("<4sIII4s", b"glTF", 2, 2**31, 2**31 - 20, b"JSON"))
        file.truncate(2**31)
    for name, size in (("hole.gltf", "65,536"), ("hole.glb", "2,048")):
        with pytest.raises(AssetError, match=rf"{name}: its JSON has {size} MiB, more than 256; export it as \.glb"):
            refuse_odd_references(tmp_path / name, "gltf")
