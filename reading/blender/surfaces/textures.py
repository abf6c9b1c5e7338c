"""Textures and libraries that the open file refers to, existing or missing, and the objects that use them."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import bpy

from hulldown.blender.nodes import socket_source_and_stack
from hulldown.blender.shaders import BASE_COLOR_INPUTS, surface_shaders_and_stacks
from hulldown.reading.confinement.references import files_near_asset
from hulldown.reading.pieces.asset_report import Missing
from hulldown.reading.pieces.doubt import Doubt, DoubtKind

UDIM_TOKEN = "<UDIM>"
TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tga", ".psd", ".tif", ".tiff", ".bmp", ".dds", ".webp")


def referenced_file_paths() -> list[str]:
    """Return the absolute path of every file that the open file refers to, existing or not, without packed ones."""
    paths = {path for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False) if path}
    paths |= {path for block in _external_file_datablocks() if (path := _block_path(block))}
    return sorted(paths)


def relink_moved_pictures(path: Path) -> list[Doubt]:
    """Point images whose files are missing to files of the same name near the asset."""
    images = [
        block
        for block in _external_file_datablocks()
        if isinstance(block, bpy.types.Image) and UDIM_TOKEN not in block.filepath
    ]
    gone = [image for image in images if (wanted := _block_path(image)) and not _is_readable_file(wanted)]
    named = [re.split(r"[/\\]", image.filepath)[-1].lower() for image in gone]
    found: dict[str, set[str]] = {name: set() for name in named}
    if found:
        for file in files_near_asset(path):
            if file.name.lower() in found:
                found[file.name.lower()].add(os.path.realpath(file))
    doubts = []
    for name, image in zip(named, gone, strict=True):
        files = found[name]
        if len({Path(file).read_bytes() for file in files}) == 1:
            near = os.path.relpath(min(files), path.parent)
            text = f"{image.filepath!r} isn't there; {near!r} is used in its place"
            doubts.append(Doubt(DoubtKind.MOVED_PICTURE, text))
            _replace_image(image, min(files))
        elif files:
            several = " and ".join(repr(os.path.relpath(file, path.parent)) for file in sorted(files)[:2])
            text = f"{image.filepath!r} isn't there, and {several} differ; put the right one in its place"
            doubts.append(Doubt(DoubtKind.SEVERAL_PICTURES, text))
    return doubts


def pictures_near_asset(path: Path) -> list[str]:
    """Return pictures that `relink_moved_pictures` searches near an asset, relative to its folder, without hidden folders."""
    near = {
        Path(os.path.relpath(file, path.parent)) for file in files_near_asset(path) if file.suffix.lower() in TEXTURE_SUFFIXES
    }
    return sorted(str(file) for file in near if not any(re.match(r"\.\w", part) for part in file.parts))


def _replace_image(image: Any, file: str) -> None:
    """Replace an image that was never read, which reloading wouldn't change."""
    new = bpy.data.images.load(file)
    new.colorspace_settings.name, new.alpha_mode = image.colorspace_settings.name, image.alpha_mode
    image.user_remap(new)
    bpy.data.images.remove(image)


def missing_or_unreadable_files(drawn: Collection[str]) -> tuple[Missing, ...]:
    """Return files and pictures of drawn objects that are missing, or that Blender can't read."""
    users = bpy.data.user_map()
    found: dict[tuple[str, str], set[str]] = {}
    for block in _external_file_datablocks():
        path = _block_path(block)
        if path and not _is_readable_file(path):
            problem = "missing"
        elif path and _is_unreadable_picture(block):
            problem = "unreadable"
        else:
            continue
        if isinstance(block, bpy.types.Library):
            wanted = {b.name for b in block.users_id if isinstance(b, (bpy.types.Object, bpy.types.Collection))}
        else:
            wanted = _using_object_names(block, users) & set(drawn)
            if not wanted:
                continue
        found.setdefault((path, problem), set()).update(wanted)
    for material in bpy.data.materials:
        if _lacks_base_color_image(material) and (wanted := _using_object_names(material, users) & set(drawn)):
            found[f"the picture of the material {material.name!r}", "missing"] = wanted
    return tuple(Missing(path, tuple(sorted(names)), problem) for (path, problem), names in sorted(found.items()))


def _is_unreadable_picture(block: Any) -> bool:
    """Return whether a block is a picture without pixels although its file is there."""
    return isinstance(block, bpy.types.Image) and block.source == "FILE" and not all(block.size)


def _lacks_base_color_image(material: Any) -> bool:
    for shader, around in surface_shaders_and_stacks(material):
        socket = shader.inputs.get(BASE_COLOR_INPUTS.get(shader.type, ""))
        found = socket_source_and_stack(socket, around) if socket is not None else None
        if found and found[0].is_output and found[0].node.type == "TEX_IMAGE" and found[0].node.image is None:
            return True
    return False


def _external_file_datablocks() -> Iterator[Any]:
    for image in bpy.data.images:
        if image.source in ("FILE", "SEQUENCE", "MOVIE", "TILED") and not image.packed_file:
            yield image
    for blocks in (bpy.data.libraries, bpy.data.cache_files, bpy.data.volumes, bpy.data.fonts):
        for block in blocks:
            if not getattr(block, "packed_file", None) and block.filepath != "<builtin>":
                yield block


def _block_path(block: Any) -> str:
    return bpy.path.abspath(block.filepath, library=getattr(block, "library", None)) if block.filepath else ""


def _is_readable_file(path: str) -> bool:
    try:
        if UDIM_TOKEN in path:
            return any(Path(path).parent.glob(Path(path).name.replace(UDIM_TOKEN, "[0-9][0-9][0-9][0-9]")))
        if Path(path).is_file():
            with open(path, "rb"):  # a confined process learns only by trying whether it can
                return True
    except (OSError, ValueError):
        pass
    return False


def _using_object_names(block: Any, users: dict[Any, set[Any]]) -> set[str]:
    seen, ring, names = {block}, [block], set()
    while ring:
        for user in users.get(ring.pop(), ()):
            if user in seen:
                continue
            seen.add(user)
            if isinstance(user, bpy.types.Object):
                names.add(user.name)
            else:
                ring.append(user)
    return names
