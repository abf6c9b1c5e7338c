"""Bundle files: vehicles and sceneries as arrays in an .npz, written atomically."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from hulldown.assets.scenery import Scenery
from hulldown.assets.textures import ARRAYS, packed, unpacked
from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.errors import AssetError
from hulldown.geometry.files import open_regular, replacing
from hulldown.geometry.meshes import Mesh

FORMAT = 6  # also raised when undersides or extreme vertices are computed in another way
# RuntimeError: zipfile takes damaged flags for encryption. MemoryError: a header may claim any shape.
_DAMAGE = (OSError, ValueError, EOFError, KeyError, TypeError, RuntimeError, MemoryError, zipfile.BadZipFile)
REMEDY = "delete the file, it is made again when it is needed"


def save_vehicle(path: Path | str, shape: VehicleShape) -> None:
    """Write `shape` to `path`, atomically."""
    _save(
        Path(path),
        "vehicle",
        name=np.str_(shape.name),
        mesh_name=np.str_(shape.mesh.name),
        vertices=shape.mesh.vertices,
        faces=shape.mesh.faces,
        **packed([shape.mesh.cutouts]),
        part_names=_names(shape.part_names),
        keypoint_names=_names(shape.keypoint_names),
        **{f: getattr(shape, f) for f in _arrays(VehicleShape)},
    )


def load_vehicle(path: Path | str) -> VehicleShape:
    """The vehicle that `save_vehicle` wrote to `path`, bit for bit.

    Raises
    ------
    AssetError
        If `path` is no such file, or one of another format version.
    """
    wanted = {"name", "mesh_name", "vertices", "faces", "part_names", "keypoint_names"}
    data = _load(Path(path), "vehicle", {*wanted, *ARRAYS, *_arrays(VehicleShape)})
    (cutouts,) = unpacked(data)
    return VehicleShape(
        name=str(data["name"]),
        mesh=Mesh(data["vertices"], data["faces"], str(data["mesh_name"]), cutouts),
        part_names=tuple(data["part_names"].tolist()),
        keypoint_names=tuple(data["keypoint_names"].tolist()),
        **{f: data[f] for f in _arrays(VehicleShape)},
    )


def save_scenery(path: Path | str, scenery: Scenery) -> None:
    """Write `scenery` to `path`, atomically."""
    meshes = [*scenery.obstacle_meshes, *([scenery.ground] if scenery.ground else [])]
    _save(
        Path(path),
        "scenery",
        name=np.str_(scenery.name),
        crs=np.str_(scenery.crs),
        ground_names=_names(scenery.ground_names),
        instance_names=_names(scenery.instance_names),
        removed_names=_names(scenery.removed_names),
        has_ground=np.bool_(scenery.ground is not None),
        mesh_names=_names([m.name for m in meshes]),
        vertex_counts=np.array([len(m.vertices) for m in meshes], np.int64),
        face_counts=np.array([len(m.faces) for m in meshes], np.int64),
        vertices=np.concatenate([np.empty((0, 3)), *(m.vertices for m in meshes)]),
        faces=np.concatenate([np.empty((0, 3), np.int32), *(m.faces for m in meshes)]),
        extreme_counts=np.array([0 if m.extreme is None else len(m.extreme) for m in meshes], np.int64),
        extreme=np.concatenate([np.empty(0, np.int64), *(m.extreme for m in meshes if m.extreme is not None)]),
        **packed([m.cutouts for m in meshes]),
        **{f: getattr(scenery, f) for f in _arrays(Scenery)},
    )


def load_scenery(path: Path | str) -> Scenery:
    """The scenery that `save_scenery` wrote to `path`, bit for bit.

    Raises
    ------
    AssetError
        If `path` is no such file, or one of another format version.
    """
    wanted = {
        "name",
        "crs",
        "ground_names",
        "instance_names",
        "removed_names",
        "has_ground",
        "mesh_names",
        "vertex_counts",
        "face_counts",
        "extreme_counts",
    }
    data = _load(Path(path), "scenery", {*wanted, "vertices", "faces", "extreme", *ARRAYS, *_arrays(Scenery)})
    vertices = np.split(data["vertices"], np.cumsum(data["vertex_counts"])[:-1])
    faces = np.split(data["faces"], np.cumsum(data["face_counts"])[:-1])
    extreme = [e if len(e) else None for e in np.split(data["extreme"], np.cumsum(data["extreme_counts"])[:-1])]
    described = zip(vertices, faces, data["mesh_names"].tolist(), unpacked(data), extreme, strict=False)
    meshes = [Mesh(*of_one) for of_one in described]
    ground = meshes.pop() if data["has_ground"] else None
    return Scenery(
        name=str(data["name"]),
        crs=str(data["crs"]),
        ground=ground,
        ground_names=tuple(data["ground_names"].tolist()),
        obstacle_meshes=tuple(meshes),
        instance_names=tuple(data["instance_names"].tolist()),
        removed_names=tuple(data["removed_names"].tolist()),
        **{f: data[f] for f in _arrays(Scenery)},
    )


def _arrays(kind: type) -> tuple[str, ...]:
    """Names of the fields that are single arrays, so that new fields are stored too."""
    return tuple(f.name for f in fields(kind) if "np.ndarray" in str(f.type))


def _names(names: Sequence[str]) -> np.ndarray:
    # NumPy would make floats of an empty list. It also strips trailing NULs, which Blender's names never have.
    return np.array(names, dtype=np.str_) if names else np.empty(0, dtype="<U1")


def _save(path: Path, kind: str, **arrays: np.ndarray | np.generic) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        np.savez(file, hulldown_bundle=np.int64(FORMAT), kind=np.str_(kind), **arrays)


def _load(path: Path, kind: str, wanted: set[str]) -> dict[str, np.ndarray]:
    try:
        # Opened here, since numpy leaves open what turns out to be no archive.
        with open_regular(path) as stream, np.load(stream, allow_pickle=False) as file:
            # Bundles are written as they are, so that reading one takes no more memory than the file has bytes.
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
            return {name: file[name] for name in wanted}
    except FileNotFoundError:
        raise AssetError("does not exist", path=path) from None
    except _DAMAGE as error:
        raise AssetError(f"cannot be read as a bundle ({error})", path=path, remedy=REMEDY) from error
