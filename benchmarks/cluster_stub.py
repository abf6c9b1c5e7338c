"""Preloaded by `dask worker`: in place of a picture by Blender comes a pixel, at once."""

import struct
import zlib

from render import cluster
from render.parcels import Answer, Picture, decode_parcel, encode


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


PIXEL = b"\x89PNG\r\n\x1a\n" + b"".join(
    [
        _chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)),
        _chunk(b"IDAT", zlib.compress(b"\0\0")),
        _chunk(b"IEND", b""),
    ]
)


def _stub(client: bytes, parcel: bytes) -> bytes:
    orders = decode_parcel(parcel).orders
    return encode(Answer(pictures=[Picture(order.index, PIXEL, "none") for order in orders], seconds=len(orders) / 4))


cluster._render_here = _stub
