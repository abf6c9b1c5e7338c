"""Cut-outs of meshes as the plain arrays of a bundle, each texture and each array of texels once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hulldown.geometry.alpha import AlphaMap, Cutouts, Extension

TEXTURE_SIZE = 1024  # texels of the longer side, by default
ARRAYS = (
    *("cut_faces", "cut_uv", "cut_maps", "cut_counts"),
    *("map_texels", "map_extension", "map_smooth", "map_curve"),
)
OWN = "map_array_{}"  # the texels or the curve of maps


def packed(cutouts: Sequence[Cutouts | None]) -> dict[str, np.ndarray]:
    """Arrays by the names in `ARRAYS`, and all texels and curves of maps."""
    there = [cut for cut in cutouts if cut is not None]
    maps = list({id(alpha): alpha for cut in there for alpha in cut.maps}.values())
    number = {id(alpha): i for i, alpha in enumerate(maps)}
    used = [np.array([number[id(alpha)] for alpha in cut.maps])[cut.face_map] for cut in there]
    own = {id(array): array for alpha in maps for array in (alpha.texels, alpha.curve) if array is not None}
    place = {key: i for i, key in enumerate(own)}
    values = (
        np.concatenate([np.empty(0, np.int64), *(cut.face for cut in there)]),
        np.concatenate([np.empty((0, 3, 2), np.float32), *(cut.uv for cut in there)]),
        np.concatenate([np.empty(0, np.int64), *used]),
        np.array([-1 if cut is None else len(cut.face) for cut in cutouts], np.int64),
        np.array([place[id(alpha.texels)] for alpha in maps], np.int64),
        np.array([alpha.extension for alpha in maps], np.int64),
        np.array([alpha.smooth for alpha in maps], bool),
        np.array([place.get(id(alpha.curve), -1) for alpha in maps], np.int64),
    )
    arrays = {OWN.format(i): array for i, array in enumerate(own.values())}
    return {**dict(zip(ARRAYS, values, strict=True)), **arrays}


def unpacked(data: Mapping[str, np.ndarray]) -> list[Cutouts | None]:
    """The cut-outs that `packed` received, one entry per mesh.

    Raises
    ------
    KeyError, ValueError
        If the arrays don't fit together.
    """
    columns = (data[name].tolist() for name in ("map_texels", "map_extension", "map_smooth", "map_curve"))
    maps = tuple(
        AlphaMap(data[OWN.format(texels)], Extension(extension), smooth, data.get(OWN.format(curve)))
        for texels, extension, smooth, curve in zip(*columns, strict=True)
    )
    counts = data["cut_counts"].clip(0)
    cuts = (parted(data[name], counts) for name in ("cut_faces", "cut_uv", "cut_maps"))
    cutouts: list[Cutouts | None] = []
    for given, face, uv, face_map in zip(data["cut_counts"], *cuts, strict=True):
        used, face_map = np.unique(face_map, return_inverse=True)
        kept = tuple(maps[i] for i in used)
        cutouts.append(None if given < 0 else Cutouts(face, uv, face_map.reshape(-1), kept))
    return cutouts


def parted(flat: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
    """An array's rows as consecutive arrays of `counts` rows each."""
    return np.split(flat, np.cumsum(counts)[:-1]) if len(counts) else []
