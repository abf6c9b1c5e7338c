"""Small maps of HDRIs, for telling what a sky looks like without rendering it."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from geometry.errors import AssetError
from geometry.files import replacing
from reading.cache import sha256
from reading.export import ask_reader
from reading.hdri import CHECKED

ROWS = 256  # of a map, at most: 0.7 degrees each


def sky_maps(hdris: Mapping[str, Path], cache: Path) -> dict[str, Float[np.ndarray, "_ _ 3"]]:
    """Radiance of each HDRI as an equirectangular map: linear Rec. 709, the zenith in the first row, +x in the middle.

    Parameters
    ----------
    hdris
        .exr or .hdr files by name; Blender reads them, in a process of its own.
    cache
        Folder in which maps are kept, by the content of their files; it exists.

    Raises
    ------
    AssetError
        If one cannot be read.
    """
    kept = {name: cache / f"sky-{CHECKED}-{sha256(path)[:24]}.npy" for name, path in hdris.items()}
    for name, path in hdris.items():
        if _kept_map(kept[name]) is None:
            _make(path, kept[name])
    maps = {name: _kept_map(path) for name, path in kept.items()}
    return {name: found for name, found in maps.items() if found is not None}


def _kept_map(path: Path) -> Float[np.ndarray, "_ _ 3"] | None:
    try:
        found = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return found.astype(np.float64) if found.ndim == 3 and found.shape[2] == 3 and found.size else None


def _make(hdri: Path, kept: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name).resolve()
        made, answer = folder / "map.npy", folder / "answer.json"
        job = {
            "given": str(hdri),
            "path": str(hdri.resolve()),
            "format": "sky",
            "map": str(made),
            "answer": str(answer),
        }
        (said,) = ask_reader([job])
        if "error" in said:
            raise AssetError(said["error"]["problem"], path=hdri, remedy=said["error"]["remedy"])
        with replacing(kept) as file:
            file.write(made.read_bytes())
