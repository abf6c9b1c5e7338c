"""List the files that a .blend refers to, without opening them, from its blocks (Blender's BLO_core_bhead.hh)."""

from __future__ import annotations

import gzip
import os
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, cast

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular_file
from hulldown.reading.pieces.formats import path_type_phrase

FILE_BLOCKS = (b"LI\0\0", b"VF\0\0", b"IM\0\0", b"MC\0\0", b"SO\0\0", b"CF\0\0", b"VO\0\0")
PATH_PATTERN = re.compile(rb"(?:^|\0)((?://|/|\.\.?/)[^\0]{1,1023})\0")
MAX_BLOCK_BYTES = 1 << 20  # usual ones have some thousand
MAX_LIBRARIES = 1000


def refuse_special_references(path: Path) -> None:
    """Raise if a .blend or one of its libraries refers to something that exists and isn't a regular file."""
    ring, seen = [path], {path}
    while ring and len(seen) < MAX_LIBRARIES:
        blend = ring.pop()
        for code, named in _referred_codes_and_paths(blend):
            found = blend.parent / named[2:] if named.startswith("//") else blend.parent / named
            kind = path_type_phrase(found)
            if kind not in ("", "a file", "a folder"):
                raise AssetError(f"refers to {named}, which is {kind}, not a file", remedy="delete it from the file")
            if code == b"LI\0\0" and kind == "a file" and found not in seen:
                seen.add(found)
                ring.append(found)


def _referred_codes_and_paths(path: Path) -> Iterator[tuple[bytes, str]]:
    """Yield block code and path, as written, of every file that a .blend refers to; skip unreadable blocks."""
    try:
        with open_regular_file(path) as raw, _decompress_blend(raw) as file:
            for code, data in _read_reference_blocks(file):
                for found in PATH_PATTERN.finditer(data):
                    yield code, found[1].decode("utf-8", "surrogateescape")
    except _damage_error_types():
        return


def _damage_error_types() -> tuple[type[Exception], ...]:
    common = (OSError, EOFError, ValueError, struct.error, zlib.error)
    try:
        import zstandard
    except ModuleNotFoundError:
        return common
    return (*common, zstandard.ZstdError)


def _decompress_blend(raw: BinaryIO) -> BinaryIO:
    start = raw.read(4)
    raw.seek(0)
    if start == b"\x28\xb5\x2f\xfd":
        import zstandard  # comes with bpy

        return cast(BinaryIO, zstandard.ZstdDecompressor().stream_reader(raw, read_across_frames=True))
    if start.startswith(b"\x1f\x8b"):
        return cast(BinaryIO, gzip.open(raw))
    return raw


def _read_reference_blocks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    header = _read_exactly(file, 12)
    if not header.startswith(b"BLENDER"):
        return
    if header[7:9].isdigit():  # since 5.0: its own size, and a format of blocks with sizes of 64 bits
        _read_exactly(file, int(header[7:9]) - 12)
        head, size_at = struct.Struct("<4siQqq"), 3
    else:
        little = "<" if header[8:9] == b"v" else ">"
        head = struct.Struct(little + ("4siQii" if header[7:8] == b"-" else "4siIii"))
        size_at = 1
    while True:
        fields = head.unpack(_read_exactly(file, head.size))
        code, size = fields[0], fields[size_at]
        if code == b"ENDB" or size < 0:
            return
        if code in FILE_BLOCKS and size <= MAX_BLOCK_BYTES:
            yield code, _read_exactly(file, size)
        else:
            file.seek(size, os.SEEK_CUR)


def _read_exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return data
