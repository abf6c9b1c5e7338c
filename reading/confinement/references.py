"""Check the files that glTF and OBJ files refer to before an importer opens them."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from itertools import chain, islice
from pathlib import Path
from urllib.parse import unquote

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular_file
from hulldown.base.outside import parse_json
from hulldown.reading.confinement.landlock import is_in_readable_folder, readable_asset_folders
from hulldown.reading.pieces.formats import path_type_phrase

REEXPORT_REMEDY = "export it again"
GLB_JSON = b"JSON"
PICTURE_EXTENSION = "EXT_texture_webp"  # the only one with a texture's picture that Blender knows
COMPRESSION_EXTENSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_SEARCH_DEPTH = 2  # levels of folders below an asset's that are searched for missing textures
TEXTURE_FOLDERS = ("textures", "texture", "tex", "materials", "maps", "images")  # folders beside it that are searched too
MAX_SEARCHED_FILES = 20_000
MAX_JSON_BYTES = 2**28  # once read, a glTF's JSON takes some twenty times as many


def refuse_odd_references(path: Path, kind: str) -> None:
    """Refuse a file of the format `kind` that refers to something other than a file, or to a missing part of itself."""
    if kind == "obj":
        for material in obj_material_libraries(path):
            for _, picture in obj_directives(material, b"map_", b"bump", b"disp", b"refl", b"norm"):
                _refuse_non_file_reference(path, picture.split()[-1] if picture.split() else picture)
    elif kind == "gltf":
        _refuse_odd_gltf(path)


def _refuse_non_file_reference(path: Path, named: str) -> None:
    found = path_type_phrase(path.parent / named)
    if found not in ("", "a file"):
        raise AssetError(f"refers to {named[:200]}, which is {found}, not a file", path=path, remedy=REEXPORT_REMEDY)


def obj_material_libraries(path: Path) -> Iterator[Path]:
    """Yield the .mtl files of an OBJ file that exist and may be read."""
    for _, named in obj_directives(path, b"mtllib"):
        _refuse_non_file_reference(path, named)
        material = path.parent / named
        if path_type_phrase(material) == "a file" and is_in_readable_folder(material, readable_asset_folders(path)):
            yield material


def obj_directives(path: Path, *starts: bytes) -> Iterator[tuple[str, str]]:
    """Yield lines of an OBJ or .mtl file that begin with these words: the first word in lower case, and the rest."""
    with open_regular_file(path) as file:
        while line := file.readline(1 << 16):
            words = line.strip().split(maxsplit=1)
            if len(words) == 2 and words[0].lower().startswith(starts):
                key, rest = (word.decode("utf-8", "surrogateescape") for word in words)
                yield key.lower(), rest


def _refuse_odd_gltf(path: Path) -> None:
    try:
        data = parse_json(_gltf_json_bytes(path), object)
    except (ValueError, struct.error) as error:
        raise AssetError(f"isn't readable glTF ({str(error)[:200]})", path=path, remedy=REEXPORT_REMEDY) from None
    if not isinstance(data, dict):
        raise AssetError("isn't glTF: it isn't a JSON object", path=path, remedy=REEXPORT_REMEDY)
    asset = data.get("asset")
    if isinstance(asset, dict) and (version := str(asset.get("version"))).startswith("1"):
        raise AssetError(f"is glTF {version}, which Blender does not read", path=path, remedy="convert it to glTF 2.0")
    for owner in ("buffers", "images"):
        for i, entry in _indexed_gltf_entries(data, owner):
            uri = entry.get("uri")
            if isinstance(uri, str) and not uri.startswith("data:"):
                _refuse_non_file_reference(path, unquote(uri))
                if owner == "buffers":
                    _refuse_short_buffer(path, unquote(uri), entry.get("byteLength"), i)
    for i, texture in _indexed_gltf_entries(data, "textures"):
        extensions = texture.get("extensions")
        kinds = list(extensions) if isinstance(extensions, dict) else []
        if "source" not in texture and kinds and PICTURE_EXTENSION not in kinds:
            problem = f"textures[{i}] has a picture in {kinds[0]!r:.60} alone, which Blender doesn't read"
            raise AssetError(problem, path=path, remedy="convert its pictures to PNG, with gltf-transform for example")
    # Blender's importer leaves out a mesh that isn't there, and reports all other wrong numbers itself.
    meshes = sum(1 for _ in _indexed_gltf_entries(data, "meshes"))
    for i, node in _indexed_gltf_entries(data, "nodes"):
        if isinstance(mesh := node.get("mesh"), int) and not 0 <= mesh < meshes:
            raise AssetError(f"nodes[{i}].mesh = {mesh}, but it has {meshes} meshes", path=path, remedy=REEXPORT_REMEDY)


def gltf_mesh_compression(path: Path) -> str:
    """Return the extension that compresses the meshes of a glTF file that Blender has opened, or nothing.

    Blender's modules decode Draco up to 5.0, not in 5.2.3, and none decodes meshopt.
    """
    required = parse_json(_gltf_json_bytes(path), dict).get("extensionsRequired", [])
    return next((one for one in COMPRESSION_EXTENSIONS if isinstance(required, list) and one in required), "")


def _gltf_json_bytes(path: Path) -> bytes:
    with open_regular_file(path) as file:
        size, start = path.stat().st_size, 0
        if file.read(4) == b"glTF":
            file.seek(12)
            (size, kind), start = struct.unpack("<I4s", file.read(8)), 20
            if kind != GLB_JSON:
                raise ValueError("its first chunk is no JSON")
        if size > MAX_JSON_BYTES:
            problem = f"its JSON has {size / 2**20:,.0f} MiB, more than {MAX_JSON_BYTES // 2**20}"
            raise AssetError(problem, path=path, remedy="export it as .glb, whose buffers are no JSON")
        file.seek(start)
        return file.read(size)


def _indexed_gltf_entries(data: Mapping[str, object], owner: str) -> Iterator[tuple[int, Mapping[str, object]]]:
    entries = data.get(owner, [])
    if isinstance(entries, list):
        yield from ((i, entry) for i, entry in enumerate(entries) if isinstance(entry, dict))


def _refuse_short_buffer(path: Path, uri: str, wanted: object, number: int) -> None:
    file = path.parent / uri
    if path_type_phrase(file) == "a file" and isinstance(wanted, int) and file.stat().st_size < wanted:
        there = file.stat().st_size
        problem = f"buffers[{number}] has {wanted} bytes, but {uri[:200]} has {there}"
        raise AssetError(problem, path=path, remedy="copy it again")


def files_near_asset(path: Path) -> Iterator[Path]:
    """Return files in the folders that an asset may read, at most `MAX_SEARCHED_FILES`."""
    readable = readable_asset_folders(path)
    own = [path.parent, Path(os.path.realpath(path)).parent]
    children = [child for around in readable if around not in own for child in around.glob("*")]
    folders = own + [child for child in children if child.name.lower() in TEXTURE_FOLDERS and child.is_dir()]
    levels = [folder.glob("/".join(["*"] * depth)) for folder in folders for depth in range(1, MAX_SEARCH_DEPTH + 2)]
    files = islice(chain.from_iterable(levels), MAX_SEARCHED_FILES)
    return (file for file in files if file.is_file() and is_in_readable_folder(file, readable))
