"""Cut-outs of meshes as the plain arrays of a bundle, each texture and each array of texels once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hulldown.geometry.alpha import GRADES, AlphaMap, Cutouts, Extension

TEXTURE_SIZE = 1024  # texels of the longer side, by default
ARRAYS = (
    "cut_faces", "cut_uv", "cut_maps", "cut_counts",
    "map_texels", "map_extension", "map_smooth", "map_curve", "map_curves",
    "texel_shapes", "texel_is_byte", "texel_bytes", "texel_floats",
)  # fmt: skip


def packed(cutouts: Sequence[Cutouts | None]) -> dict[str, np.ndarray]:
    """Arrays by the names in `ARRAYS`."""
    there = [cut for cut in cutouts if cut is not None]
    maps = list({id(alpha): alpha for cut in there for alpha in cut.maps}.values())
    texels = list({id(alpha.texels): alpha.texels for alpha in maps}.values())
    number = {id(alpha): i for i, alpha in enumerate(maps)}
    place = {id(array): i for i, array in enumerate(texels)}
    used = [np.array([number[id(alpha)] for alpha in cut.maps])[cut.face_map] for cut in there]
    curves = list({id(alpha.curve): alpha.curve for alpha in maps if alpha.curve is not None}.values())
    row = {id(curve): i for i, curve in enumerate(curves)}
    is_byte = [array.dtype == np.uint8 for array in texels]
    values = (
        np.concatenate([np.empty(0, np.int64), *(cut.face for cut in there)]),
        np.concatenate([np.empty((0, 3, 2), np.float32), *(cut.uv for cut in there)]),
        np.concatenate([np.empty(0, np.int64), *used]),
        np.array([-1 if cut is None else len(cut.face) for cut in cutouts], np.int64),
        np.array([place[id(alpha.texels)] for alpha in maps], np.int64),
        np.array([alpha.extension for alpha in maps], np.int64),
        np.array([alpha.smooth for alpha in maps], bool),
        np.array([row.get(id(alpha.curve), -1) for alpha in maps], np.int64),
        np.array(curves, np.float32).reshape(-1, len(GRADES)),
        np.array([array.shape for array in texels], np.int64).reshape(-1, 2),
        np.array(is_byte, bool),
        _joined([array for array, byte in zip(texels, is_byte, strict=True) if byte], np.uint8),
        _joined([array for array, byte in zip(texels, is_byte, strict=True) if not byte], np.float32),
    )
    return dict(zip(ARRAYS, values, strict=True))


def unpacked(data: Mapping[str, np.ndarray]) -> list[Cutouts | None]:
    """The cut-outs that `packed` received, one entry per mesh.

    Raises
    ------
    ValueError
        If the arrays don't fit together.
    """
    shapes, is_byte = data["texel_shapes"], data["texel_is_byte"]
    sizes = shapes.prod(axis=1)
    texels = np.empty(len(shapes), dtype=object)
    for kind, flat in ((is_byte, data["texel_bytes"]), (~is_byte, data["texel_floats"])):
        for i, array in zip(np.flatnonzero(kind), parted(flat, sizes[kind]), strict=True):
            texels[i] = array.reshape(shapes[i])
    columns = (data[name].tolist() for name in ("map_texels", "map_extension", "map_smooth", "map_curve"))
    maps = tuple(
        AlphaMap(texels[which], Extension(extension), smooth, data["map_curves"][row] if row >= 0 else None)
        for which, extension, smooth, row in zip(*columns, strict=True)
    )
    counts = data["cut_counts"].clip(0)
    cuts = (parted(data[name], counts) for name in ("cut_faces", "cut_uv", "cut_maps"))
    cutouts: list[Cutouts | None] = []
    for given, face, uv, face_map in zip(data["cut_counts"], *cuts, strict=True):
        used, face_map = np.unique(face_map, return_inverse=True)
        kept = tuple(maps[i] for i in used)
        cutouts.append(None if given < 0 else Cutouts(face, uv, face_map.reshape(-1), kept))
    return cutouts


def _joined(arrays: Sequence[np.ndarray], dtype: type) -> np.ndarray:
    return np.concatenate([np.empty(0, dtype), *(array.ravel() for array in arrays)])


def parted(flat: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
    """An array's rows as consecutive arrays of `counts` rows each."""
    return np.split(flat, np.cumsum(counts)[:-1]) if len(counts) else []
