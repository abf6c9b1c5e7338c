"""What glTF and OBJ files refer to, checked before an importer opens it: that it is a file, and that it is there."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from geometry.errors import AssetError
from reading.formats import kind_of_file, refuse_large_json

AGAIN = "export it again"
# Where a glTF 2.0 file refers to another of its objects by number: owner, key, what is meant (specification, 5).
NUMBERS = (
    *(("bufferViews", "buffer", "buffers"), ("accessors", "bufferView", "bufferViews"), ("nodes", "mesh", "meshes")),
    *(("nodes", "camera", "cameras"), ("nodes", "skin", "skins"), ("images", "bufferView", "bufferViews")),
    *(("textures", "source", "images"), ("textures", "sampler", "samplers")),
)
LISTS = (("scenes", "nodes", "nodes"), ("nodes", "children", "nodes"), ("skins", "joints", "nodes"))
GLB_JSON = b"JSON"
DEEPEST = 200  # nodes inside each other; Blender's importer calls itself for each


def refuse_odd_references(path: Path, kind: str) -> None:
    """Raise if a file of the format `kind` refers to what is no file, or to a part of itself that is not there.

    Raises
    ------
    AssetError
        Naming it.
    """
    if kind == "obj":
        _check_obj(path)
    elif kind == "gltf":
        _check_gltf(path)


def _refuse(path: Path, named: str) -> None:
    found = kind_of_file(path.parent / named)
    if found not in ("", "a file"):
        raise AssetError(f"refers to {named[:200]}, which is {found}, no file", path=path, remedy=AGAIN)


def _check_obj(path: Path) -> None:
    for line in _lines(path, b"mtllib"):
        material = path.parent / line
        _refuse(path, line)
        if kind_of_file(material) == "a file":
            for picture in _lines(material, b"map_", b"bump", b"disp", b"refl", b"norm"):
                _refuse(path, picture.split()[-1] if picture.split() else picture)


def _lines(path: Path, *starts: bytes) -> Iterator[str]:
    """What follows the first word of the lines that begin like this."""
    with open(path, "rb") as file:
        while line := file.readline(1 << 16):
            words = line.strip().split(maxsplit=1)
            if len(words) == 2 and words[0].lower().startswith(starts):
                yield words[1].decode("utf-8", "surrogateescape")


def _check_gltf(path: Path) -> None:
    try:
        data = json.loads(_gltf_json(path))
    except (ValueError, RecursionError, struct.error) as error:
        raise AssetError(f"is no glTF that can be read ({_said(error)})", path=path, remedy=AGAIN) from None
    if not isinstance(data, dict):
        raise AssetError("is no glTF: it is no JSON object", path=path, remedy=AGAIN)
    for owner in ("buffers", "images"):
        for i, entry in _entries(data, owner):
            uri = entry.get("uri")
            if isinstance(uri, str) and not uri.startswith("data:"):
                _refuse(path, unquote(uri))
                if owner == "buffers":
                    _check_size(path, unquote(uri), entry.get("byteLength"), i)
    for where, number, there, meant in _numbers(data):
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < there:
            raise AssetError(f"{where} = {number!r:.40}, but it has {there} {meant}", path=path, remedy=AGAIN)
    _check_depth(path, data)


def _gltf_json(path: Path) -> bytes:
    with open(path, "rb") as file:
        if file.read(4) != b"glTF":
            refuse_large_json(path, path.stat().st_size)
            return path.read_bytes()
        file.seek(12)
        size, kind = struct.unpack("<I4s", file.read(8))
        if kind != GLB_JSON:
            raise ValueError("its first chunk is no JSON")
        refuse_large_json(path, size)
        return file.read(size)


def _said(error: Exception) -> str:
    return "it is nested too deeply" if isinstance(error, RecursionError) else str(error)[:200]


def _entries(data: Mapping[str, Any], owner: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    entries = data.get(owner, [])
    if isinstance(entries, list):
        yield from ((i, entry) for i, entry in enumerate(entries) if isinstance(entry, dict))


def _check_size(path: Path, uri: str, wanted: object, number: int) -> None:
    file = path.parent / uri
    if kind_of_file(file) == "a file" and isinstance(wanted, int) and file.stat().st_size < wanted:
        there = file.stat().st_size
        problem = f"buffers[{number}] has {wanted} bytes, but {uri[:200]} has {there}"
        raise AssetError(problem, path=path, remedy="copy it again")


def _numbers(data: Mapping[str, Any]) -> Iterator[tuple[str, object, int, str]]:
    """Each reference by number: where it stands, the number, and of what how many there are."""

    def count(meant: str) -> int:
        return len(data[meant]) if isinstance(data.get(meant), list) else 0

    for owner, key, meant in NUMBERS:
        for i, entry in _entries(data, owner):
            if key in entry:
                yield f"{owner}[{i}].{key}", entry[key], count(meant), meant
    for owner, key, meant in LISTS:
        for i, entry in _entries(data, owner):
            listed = entry.get(key, [])
            for j, number in enumerate(listed if isinstance(listed, list) else [listed]):
                yield f"{owner}[{i}].{key}[{j}]", number, count(meant), meant
    for i, mesh in _entries(data, "meshes"):
        for j, part in _entries(mesh, "primitives"):
            where = f"meshes[{i}].primitives[{j}]"
            attributes = part.get("attributes", {})
            for name, number in attributes.items() if isinstance(attributes, dict) else ():
                yield f"{where}.attributes.{name:.40}", number, count("accessors"), "accessors"
            for key, meant in (("indices", "accessors"), ("material", "materials")):
                if key in part:
                    yield f"{where}.{key}", part[key], count(meant), meant


def _check_depth(path: Path, data: Mapping[str, Any]) -> None:
    """Raise if nodes are inside each other in a circle, or so deeply that the importer cannot follow."""
    children = {i: entry.get("children", []) for i, entry in _entries(data, "nodes")}
    level = set(children)
    for _ in range(DEEPEST):
        level = {child for i in level for child in children.get(i, [])}
        if not level:
            return
    problem = f"its nodes are inside each other in a circle, or more than {DEEPEST} deep"
    raise AssetError(problem, path=path, remedy=AGAIN)
