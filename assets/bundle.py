"""Bundle files: vehicles and sceneries as one array a data type, and JSON, in an .npz, written atomically."""

from __future__ import annotations

import json
import math
import zipfile
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError
from hulldown.base.files import atomic_writer, open_regular_file
from hulldown.base.outside import convert_value

BUNDLE_FORMAT = 12  # also raised when undersides, surfaces, or extreme vertices are computed in another way
BUNDLE_KINDS = {VehicleShape: "vehicle", Scenery: "scenery"}
# RuntimeError: zipfile takes damaged flags for encryption. MemoryError: a header may claim any shape.
_DAMAGE_ERRORS = (
    *(OSError, ValueError, EOFError, KeyError, TypeError, RuntimeError, MemoryError, zipfile.BadZipFile),
    msgspec.MsgspecError,
)
DAMAGED_BUNDLE_REMEDY = "delete the file, it is made again when it is needed"
Asset = TypeVar("Asset", VehicleShape, Scenery)
ArrayPlace = tuple[str | int, ...]  # of an array: its data type, the number of its first element, and its shape


def save_asset(path: Path | str, asset: VehicleShape | Scenery) -> None:
    """Write `asset` to `path`, atomically. An array that it has several times, like a texture, is written once."""
    path, places = Path(path), dict[int, ArrayPlace]()
    stored: dict[str, list[np.ndarray]] = defaultdict(list)
    count: dict[str, int] = defaultdict(int)

    def place(array: np.ndarray) -> ArrayPlace:
        if id(array) not in places:
            kind = array.dtype.name
            places[id(array)] = kind, count[kind], *array.shape
            stored[kind].append(array.ravel())
            count[kind] += array.size
        return places[id(array)]

    tree = json.dumps(msgspec.to_builtins(asset, enc_hook=place))
    arrays = {kind: np.concatenate(parts) for kind, parts in stored.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_writer(path) as file:
        np.savez(
            file, hulldown_bundle=np.int64(BUNDLE_FORMAT), kind=np.str_(BUNDLE_KINDS[type(asset)]), tree=np.str_(tree), **arrays
        )


def load_vehicle(path: Path | str) -> VehicleShape:
    """Return the vehicle that `save_asset` wrote to `path`, bit for bit."""
    return _load_asset(Path(path), VehicleShape)


def load_scenery(path: Path | str) -> Scenery:
    """Return the scenery that `save_asset` wrote to `path`, bit for bit."""
    return _load_asset(Path(path), Scenery)


def _load_asset(path: Path, wanted: type[Asset]) -> Asset:
    try:
        # Opened here, since numpy doesn't close a file that isn't an archive.
        with open_regular_file(path) as stream, np.load(stream, allow_pickle=False) as file:
            # Reading an uncompressed bundle takes no more memory than the file has bytes.
            if any(member.compress_type for member in file.zip.infolist()):
                raise ValueError("it is compressed, which bundles never are")
            if "hulldown_bundle" not in file or "kind" not in file:
                raise AssetError("isn't a hulldown bundle", path=path, remedy=DAMAGED_BUNDLE_REMEDY)
            if (version := int(file["hulldown_bundle"])) != BUNDLE_FORMAT:
                raise AssetError(
                    f"is a bundle of format {version}, this is {BUNDLE_FORMAT}", path=path, remedy=DAMAGED_BUNDLE_REMEDY
                )
            if str(file["kind"]) != BUNDLE_KINDS[wanted]:
                raise AssetError(f"is a bundle of a {file['kind']}, expected a {BUNDLE_KINDS[wanted]}", path=path)
            tree, arrays = json.loads(str(file["tree"])), dict(file)

        @cache
        def view(kind: str, first: int, *shape: int) -> np.ndarray:
            return np.asarray(arrays[kind][first : first + math.prod(shape)].reshape(shape))

        return convert_value(tree, wanted, dec_hook=lambda _, place: view(*place))
    except FileNotFoundError:
        raise AssetError("does not exist", path=path) from None
    except _DAMAGE_ERRORS as error:
        raise AssetError(f"cannot be read as a bundle ({error})", path=path, remedy=DAMAGED_BUNDLE_REMEDY) from error
