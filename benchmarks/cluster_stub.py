"""Preloaded by `dask worker`: in place of a picture by Blender comes a pixel, at once."""

import struct
import zlib

from render import node
from render.cluster import own_address
from render.node import Answer, Order


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


PIXEL = b"\x89PNG\r\n\x1a\n" + b"".join(
    [
        _chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)),
        _chunk(b"IDAT", zlib.compress(b"\0\0")),
        _chunk(b"IEND", b""),
    ]
)


def _stub(order: Order, *contents: bytes) -> Answer:
    return Answer(own_address(), png=PIXEL, device="none")


node.render_row = _stub
