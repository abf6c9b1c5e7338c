"""File formats by first bytes, and refusals that need no Blender."""

from __future__ import annotations

import stat
from pathlib import Path

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular_file
from hulldown.base.outside import describe_path

FORMAT_MAGIC = {
    b"BLENDER": "blend",
    b"\x28\xb5\x2f\xfd": "blend",  # Zstandard, which Blender compresses with
    b"\x1f\x8b": "blend",  # gzip, which it did before 3.0
    b"glTF": "gltf",
    b"Kaydara FBX Binary": "fbx",
    b"II*\0": "geotiff",
    b"MM\0*": "geotiff",
    b"II+\0": "geotiff",  # of more than 4 GB
    b"MM\0+": "geotiff",
}
FORMAT_SUFFIXES = {
    ".blend": "blend",
    ".glb": "gltf",
    ".gltf": "gltf",
    ".fbx": "fbx",
    ".obj": "obj",
    ".tif": "geotiff",
    ".tiff": "geotiff",
}
HDRI_SUFFIXES = (".exr", ".hdr")
OTHER_SUFFIXES = (  # of 3D files that aren't read
    *(".usd", ".usda", ".usdc", ".usdz", ".stl", ".ply", ".dae", ".3ds", ".max", ".ma", ".mb", ".c4d", ".abc", ".x3d"),
    *(".skp", ".stp", ".step", ".igs", ".iges", ".lwo", ".dxf", ".dwg", ".3mf", ".las", ".laz"),
)
LFS_POINTER = b"version https://git-lfs"  # Git LFS leaves such a text in place of a file that isn't fetched


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a regular file: reading a FIFO would wait forever, and a device has no end."""
    try:
        if (kind := _mode_type_phrase(path.stat().st_mode)) != "a file":
            raise AssetError(f"is {kind}, not a file", path=path, remedy="name files, such as *.blend")
        with open_regular_file(path) as file:
            start = file.read(64)
    except FileNotFoundError:
        raise AssetError("does not exist", path=path, remedy="check its name") from None
    except OSError as error:  # including links that lead to each other
        raise AssetError(f"cannot be read ({error.strerror})", path=path) from None
    except ValueError:
        raise AssetError("isn't a valid file name", path=path.name[:80]) from None
    if start.startswith(LFS_POINTER):
        raise AssetError("is only a pointer to a file in Git LFS", path=path, remedy="fetch it with `git lfs pull`")
    return start


def path_type_phrase(path: Path) -> str:
    """Return "a file", "a folder", "a FIFO", "a socket", "a device", or "" for a path where nothing exists."""
    try:
        return _mode_type_phrase(path.stat().st_mode)
    except (OSError, ValueError):
        return ""


def _mode_type_phrase(mode: int) -> str:
    kinds = {stat.S_IFREG: "a file", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket"}
    return kinds.get(stat.S_IFMT(mode), "a device")


def file_format(path: Path) -> str:
    """Return the format of the file `path`: "blend", "gltf", "fbx", "obj", or "geotiff"."""
    start = first_bytes(path)
    if not start:
        raise AssetError("is empty", path=path, remedy="copy it again")
    suffix = ".blend" if path.suffix.lower().startswith(".blend") else path.suffix.lower()
    for magic, kind in FORMAT_MAGIC.items():
        if start.startswith(magic) and FORMAT_SUFFIXES.get(suffix, kind) == kind:
            return kind
    expected = FORMAT_SUFFIXES.get(suffix)
    if expected is None:
        raise AssetError(
            f"is {describe_path(path)}, not a vehicle or scenery; expected one of {', '.join(FORMAT_SUFFIXES)}",
            path=path,
            remedy="save it as .blend in Blender",
        )
    if suffix == ".obj" and b"\0" not in start:
        return "obj"
    if suffix == ".gltf" and b"{" in start:
        return "gltf"
    if suffix == ".fbx" and start.lstrip().startswith(b";"):
        return "fbx"  # the text form
    raise AssetError(
        f"isn't a {suffix} file: it doesn't begin like one (damaged, encrypted, or another format)",
        path=path,
        remedy="copy it again, or save it as .blend in Blender",
    )
