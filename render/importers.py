"""Opening a file in Blender, whatever its format, and never running what it brings along."""

from __future__ import annotations

from pathlib import Path

import bpy

from geometry.errors import AssetError

FORMATS = (".blend", ".glb", ".gltf", ".fbx", ".obj")


def load(path: Path) -> tuple[float, str]:
    """Make `path` the file that is open in Blender.

    Returns
    -------
    metres_per_unit
        By the file's unit scale.
    written_by
        The Blender that wrote it, or its format.

    Raises
    ------
    AssetError
        If Blender cannot read it, or it is of a newer Blender.
    """
    if path.suffix.lower() == ".blend":
        return _load_blend(path)
    raise AssetError(f"is no file that can be read; expected one of {', '.join(FORMATS)}", path=path)


def _load_blend(path: Path) -> tuple[float, str]:
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        text = str(error).strip().removeprefix("Error: ")
        raise AssetError(f"Blender cannot read it ({text})", remedy="open it in Blender and save it again") from None
    version = ".".join(map(str, bpy.data.version[:2]))
    if tuple(bpy.data.version[:2]) > bpy.app.version[:2]:
        raise AssetError(
            f"was written by Blender {version}, newer than the {bpy.app.version_string} that is installed",
            remedy=f"save it for an older Blender or install bpy {version}",
        )
    units = bpy.context.scene.unit_settings
    # The file holds a float32; 0.01 shall be 0.01.
    unit = float(f"{units.scale_length:.7g}") if units.system != "NONE" else 1.0
    return unit, f"Blender {version}"
