"""Corrections for .mtl files that Blender's OBJ importer misreads."""

from __future__ import annotations

from pathlib import Path

import bpy

from hulldown.reading.blender.surfaces.shaders import surface_shaders
from hulldown.reading.confinement.references import directives, material_libraries

GLASS = (4, 6, 7, 9)  # illumination models with transparency or refraction
WEIGHT = "Transmission Weight"


def clear_false_glass(path: Path) -> None:
    """Make materials opaque that the .mtl files of an imported OBJ file don't describe as glass.

    The importer takes ``Tf`` as the share of light that passes. Exporters such as that of 3ds Max write ``Tf 1 1 1``
    for opaque materials, where it has no meaning: only the illumination models in `GLASS` transmit light.

    References
    ----------
    Alias|Wavefront, MTL material format, in File Formats, version 4.2, 1995, section 5 (``illum``).
    """
    found = [(m.name, shader) for m in bpy.data.materials for shader, _ in surface_shaders(m)]
    clear = [(name, shader.inputs[WEIGHT]) for name, shader in found if shader.type == "BSDF_PRINCIPLED"]
    clear = [(name, weight) for name, weight in clear if weight.default_value > 0.0]
    if not clear:
        return
    models = {name: model for library in material_libraries(path) for name, model in _illumination(library).items()}
    for name, weight in clear:
        if models.get(name, GLASS[0]) not in GLASS:
            weight.default_value = 0.0


def _illumination(library: Path) -> dict[str, int]:
    """Illumination model of each material of an .mtl file; 2, an opaque one, by default."""
    models: dict[str, int] = {}
    name = ""
    for key, value in directives(library, b"newmtl", b"illum"):
        if key == "newmtl":
            name = value
            models[name] = 2
        elif name and value.isdigit():
            models[name] = int(value)
    return models
