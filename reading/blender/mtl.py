"""What .mtl files mean where Blender's importer of OBJ files takes them otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy

from hulldown.reading.blender.surfaces.shaders import surface_shaders

GLASS = (4, 6, 7, 9)  # illumination models with transparency or refraction


def clear_false_glass(path: Path) -> None:
    """Make materials opaque that the .mtl files of an imported OBJ file don't describe as glass.

    The importer takes ``Tf`` as the share of light that passes. Exporters such as that of 3ds Max write ``Tf 1 1 1``
    for opaque materials, where it has no meaning: only the illumination models in `GLASS` transmit light.

    References
    ----------
    Alias|Wavefront, MTL material format, in File Formats, version 4.2, 1995, section 5 (``illum``).
    """
    models: dict[str, int] = {}
    for library in _values(path, "mtllib"):
        models |= _illumination(path.parent / library)
    for name, model in models.items():
        material = bpy.data.materials.get(name)
        if material is None or model in GLASS:
            continue
        for shader, _ in surface_shaders(material):
            if shader.type == "BSDF_PRINCIPLED":
                shader.inputs["Transmission Weight"].default_value = 0.0


def _illumination(library: Path) -> dict[str, int]:
    """The illumination model of each material of an .mtl file; 2, an opaque one, where it has none."""
    models: dict[str, int] = {}
    name = ""
    for key, value in _lines(library):
        if key == "newmtl":
            name = value
            models[name] = 2
        elif key == "illum" and name and value.isdigit():
            models[name] = int(value)
    return models


def _values(path: Path, key: str) -> Iterator[str]:
    return (value for found, value in _lines(path) if found == key)


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """First word and rest of each line; nothing if there is no such file or it can't be read."""
    try:
        with path.open(encoding="utf-8", errors="surrogateescape") as file:
            for line in file:
                if len(words := line.split(maxsplit=1)) == 2:
                    yield words[0].lower(), words[1].strip()
    except OSError:
        return
