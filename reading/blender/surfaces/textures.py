"""Files that the file open in Blender refers to: textures and libraries, there or not, and who wants them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import bpy

from hulldown.reading.report import Missing

TILES = "<UDIM>"


def used_files() -> list[str]:
    """Absolute path of every file that the open file refers to, there or not; packed files are not referred to."""
    paths = {path for path in bpy.utils.blend_paths(absolute=True, packed=False, local=False) if path}
    paths |= {path for block in _referring() for path in _paths(block)}
    return sorted(paths)


def missing_files(drawn: Collection[str]) -> tuple[Missing, ...]:
    """Every file that something drawn refers to but that is not there.

    Parameters
    ----------
    drawn
        Names of the objects that matter.
    """
    users = bpy.data.user_map()
    found: dict[str, set[str]] = {}
    for block in _referring():
        gone = [path for path in _paths(block) if not _is_there(path)]
        if not gone:
            continue
        if isinstance(block, bpy.types.Library):
            wanted = {b.name for b in block.users_id if isinstance(b, (bpy.types.Object, bpy.types.Collection))}
        else:
            wanted = _objects_using(block, users) & set(drawn)
            if not wanted:
                continue
        for path in gone:
            found.setdefault(path, set()).update(wanted)
    return tuple(Missing(path, tuple(sorted(names))) for path, names in sorted(found.items()))


def _referring() -> Iterator[Any]:
    """Blocks that refer to files which the look or the shape of an object depends on."""
    for image in bpy.data.images:
        if image.source in ("FILE", "SEQUENCE", "MOVIE", "TILED") and not image.packed_file:
            yield image
    for blocks in (bpy.data.libraries, bpy.data.cache_files, bpy.data.volumes, bpy.data.fonts):
        for block in blocks:
            if not getattr(block, "packed_file", None) and block.filepath != "<builtin>":
                yield block


def _paths(block: Any) -> list[str]:
    if not block.filepath:
        return []
    return [bpy.path.abspath(block.filepath, library=getattr(block, "library", None))]


def _is_there(path: str) -> bool:
    try:
        if TILES in path:
            return any(Path(path).parent.glob(Path(path).name.replace(TILES, "[0-9][0-9][0-9][0-9]")))
        return Path(path).is_file() and _opens(path)
    except (OSError, ValueError):
        return False


def _opens(path: str) -> bool:
    """Whether this process may read it, which a confined one learns by trying alone."""
    with open(path, "rb"):
        return True


def _objects_using(block: Any, users: dict[Any, set[Any]]) -> set[str]:
    """Names of the objects that reach `block` through materials, node groups, modifiers and the like."""
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
