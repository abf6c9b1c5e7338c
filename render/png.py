"""PNG files without notes: Blender writes dates, render times and paths of this machine into its pictures."""

from __future__ import annotations

import struct

SIGNATURE = b"\x89PNG\r\n\x1a\n"
NOTES = (b"tEXt", b"zTXt", b"iTXt", b"eXIf", b"tIME")


def without_notes(data: bytes) -> bytes:
    """The same picture without text, date and EXIF chunks, so that equal pictures are equal files.

    Raises
    ------
    ValueError
        If `data` is no whole PNG file.

    References
    ----------
    W3C, Portable Network Graphics (PNG) Specification, 3rd edition, section 5.
    """
    if not data.startswith(SIGNATURE):
        raise ValueError("data: expected a PNG file, got something else")
    kept, at = [SIGNATURE], len(SIGNATURE)
    while at < len(data):
        if at + 12 > len(data):
            raise ValueError("data: expected a whole PNG file, got one that ends in the middle")
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 12 + length
        if end > len(data):
            raise ValueError("data: expected a whole PNG file, got one that ends in the middle")
        if data[at + 4 : at + 8] not in NOTES:
            kept.append(data[at:end])
        at = end
    return b"".join(kept)
