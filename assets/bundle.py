"""Bundle files: vehicles and sceneries as arrays in an .npz, written atomically."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.alpha import AlphaMap, Cutouts, Extension
from hulldown.geometry.errors import AssetError
from hulldown.geometry.files import open_regular, replacing
from hulldown.geometry.meshes import Mesh

FORMAT = 9  # also raised when undersides or extreme vertices are computed in another way
# RuntimeError: zipfile takes damaged flags for encryption. MemoryError: a header may claim any shape.
_DAMAGE = (OSError, ValueError, EOFError, KeyError, TypeError, RuntimeError, MemoryError, zipfile.BadZipFile)
OWN = "map_array_{}"  # the texels or the curve of maps
REMEDY = "delete the file, it is made again when it is needed"


def save(path: Path | str, asset: VehicleShape | Scenery) -> None:
    """Write `asset` to `path`, atomically."""
    path, more = Path(path), dict[str, np.generic]()
    if isinstance(asset, VehicleShape):
        kind, meshes = "vehicle", [asset.mesh]
    else:
        kind, meshes = "scenery", [*asset.obstacle_meshes, *([asset.ground] if asset.ground else [])]
        more["has_ground"] = np.bool_(asset.ground is not None)
    plain = {name: getattr(asset, name) for name in _plain(type(asset))}
    arrays = {
        name: value if isinstance(value, np.ndarray) else np.array(value, np.str_) for name, value in plain.items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        np.savez(file, hulldown_bundle=np.int64(FORMAT), kind=np.str_(kind), **arrays, **_packed(meshes), **more)


def load_vehicle(path: Path | str) -> VehicleShape:
    """The vehicle that `save` wrote to `path`, bit for bit.

    Raises
    ------
    AssetError
        If `path` isn't such a file, or has another format version.
    """
    data = _load(Path(path), "vehicle", _plain(VehicleShape))
    (mesh,) = _meshes(data)
    return VehicleShape(mesh=mesh, **_values(data, VehicleShape))


def load_scenery(path: Path | str) -> Scenery:
    """The scenery that `save` wrote to `path`, bit for bit.

    Raises
    ------
    AssetError
        If `path` isn't such a file, or has another format version.
    """
    data = _load(Path(path), "scenery", ["has_ground", *_plain(Scenery)])
    meshes = _meshes(data)
    ground = meshes.pop() if data["has_ground"] else None
    return Scenery(ground=ground, obstacle_meshes=tuple(meshes), **_values(data, Scenery))


def _plain(kind: type) -> list[str]:
    """Names of a type's fields of text and arrays, which is all but meshes."""
    return [field.name for field in fields(kind) if "Mesh" not in str(field.type)]


def _values(data: Mapping[str, np.ndarray], kind: type) -> dict[str, Any]:
    plain = {name: data[name] for name in _plain(kind)}
    texts = {name: array.tolist() for name, array in plain.items() if array.dtype.kind == "U"}
    return plain | {name: tuple(text) if isinstance(text, list) else text for name, text in texts.items()}


def _packed(meshes: Sequence[Mesh]) -> dict[str, np.ndarray]:
    """Rows of all meshes follow one another; the counts are rows per mesh."""
    extreme = [np.empty(0, np.int64) if mesh.extreme is None else mesh.extreme for mesh in meshes]
    return {
        "mesh_names": np.array([mesh.name for mesh in meshes], np.str_),
        "vertex_counts": np.array([len(mesh.vertices) for mesh in meshes], np.int64),
        "face_counts": np.array([len(mesh.faces) for mesh in meshes], np.int64),
        "extreme_counts": np.array([len(vertices) for vertices in extreme], np.int64),
        "vertices": np.concatenate([np.empty((0, 3)), *(mesh.vertices for mesh in meshes)]),
        "faces": np.concatenate([np.empty((0, 3), np.int32), *(mesh.faces for mesh in meshes)]),
        "extreme": np.concatenate([np.empty(0, np.int64), *extreme]),
        **packed([mesh.cutouts for mesh in meshes]),
    }


def _meshes(data: Mapping[str, np.ndarray]) -> list[Mesh]:
    vertices = parted(data["vertices"], data["vertex_counts"])
    faces = parted(data["faces"], data["face_counts"])
    extreme = [found if len(found) else None for found in parted(data["extreme"], data["extreme_counts"])]
    columns = (vertices, faces, data["mesh_names"].tolist(), unpacked(data), extreme)
    return [Mesh(*row) for row in zip(*columns, strict=True)]


def _load(path: Path, kind: str, names: Iterable[str]) -> dict[str, np.ndarray]:
    wanted = {*names, *_packed([])}
    try:
        # Opened here, since numpy doesn't close a file that isn't an archive.
        with open_regular(path) as stream, np.load(stream, allow_pickle=False) as file:
            # Reading an uncompressed bundle takes no more memory than the file has bytes.
            if any(member.compress_type for member in file.zip.infolist()):
                raise ValueError("it is compressed, which bundles never are")
            if "hulldown_bundle" not in file or "kind" not in file:
                raise AssetError("isn't a hulldown bundle", path=path, remedy=REMEDY)
            if (version := int(file["hulldown_bundle"])) != FORMAT:
                raise AssetError(f"is a bundle of format {version}, this is {FORMAT}", path=path, remedy=REMEDY)
            if str(file["kind"]) != kind:
                raise AssetError(f"is a bundle of a {file['kind']}, expected a {kind}", path=path)
            if missing := wanted - set(file.files):
                raise AssetError(f"lacks {sorted(missing)}", path=path, remedy=REMEDY)
            return dict(file)
    except FileNotFoundError:
        raise AssetError("does not exist", path=path) from None
    except _DAMAGE as error:
        raise AssetError(f"cannot be read as a bundle ({error})", path=path, remedy=REMEDY) from error


def packed(cutouts: Sequence[Cutouts | None]) -> dict[str, np.ndarray]:
    """Arrays of the cut-outs of meshes, with each texture, and each array of texels or a curve, once."""
    there = [cut for cut in cutouts if cut is not None]
    maps = list({id(alpha): alpha for cut in there for alpha in cut.maps}.values())
    number = {id(alpha): i for i, alpha in enumerate(maps)}
    used = [np.array([number[id(alpha)] for alpha in cut.maps])[cut.face_map] for cut in there]
    own = {id(array): array for alpha in maps for array in (alpha.texels, alpha.curve) if array is not None}
    place = {key: i for i, key in enumerate(own)}
    return {
        "cut_faces": np.concatenate([np.empty(0, np.int64), *(cut.face for cut in there)]),
        "cut_uv": np.concatenate([np.empty((0, 3, 2), np.float32), *(cut.uv for cut in there)]),
        "cut_maps": np.concatenate([np.empty(0, np.int64), *used]),
        "cut_counts": np.array([-1 if cut is None else len(cut.face) for cut in cutouts], np.int64),
        "map_texels": np.array([place[id(alpha.texels)] for alpha in maps], np.int64),
        "map_extension": np.array([alpha.extension for alpha in maps], np.int64),
        "map_smooth": np.array([alpha.smooth for alpha in maps], bool),
        "map_curve": np.array([place.get(id(alpha.curve), -1) for alpha in maps], np.int64),
        **{OWN.format(i): array for i, array in enumerate(own.values())},
    }


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
