"""Materials of a vehicle's surface: names, areas, and what can be seen through."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from hulldown.blender.buffers import read_property
from hulldown.blender.shaders import BASE_COLOR_INPUTS, is_clear_material, surface_shaders_and_stacks
from hulldown.reading.pieces.asset_report import MaterialRow
from hulldown.reading.pieces.roles import Piece


def material_rows(meshes: Sequence[Any], pieces: Sequence[Piece], piece_part: Sequence[int]) -> tuple[MaterialRow, ...]:
    """Return materials of the pieces with a part (`piece_part`; -1: none), largest share first."""
    scales: dict[int, float] = defaultdict(float)
    for piece, part in zip(pieces, piece_part, strict=True):
        if part >= 0 and isinstance(meshes[piece.mesh], bpy.types.Mesh):
            scales[piece.mesh] += abs(float(np.linalg.det(piece.pose[:3, :3]))) ** (2 / 3)
    areas: dict[Any, float] = defaultdict(float)
    for mesh, scale in scales.items():
        for material, area in _material_areas(meshes[mesh]).items():
            areas[material] += scale * area
    total = sum(areas.values()) or 1.0
    rows = [
        MaterialRow(
            material.name, area / total, is_clear_material(material), _least_constant_alpha(material), *_plain_color(material)
        )
        for material, area in areas.items()
    ]
    return tuple(sorted(rows, key=lambda row: (-row.share, row.name)))


def _material_areas(mesh: Any) -> dict[Any, float]:
    """Return the area of each material's faces, in the mesh's own units."""
    if not len(mesh.materials):
        return {}
    worn, area = (read_property(mesh.polygons, "material_index", np.int32), read_property(mesh.polygons, "area", np.float32))
    sums = np.bincount(worn.clip(0, len(mesh.materials) - 1), weights=area, minlength=len(mesh.materials))
    found: dict[Any, float] = defaultdict(float)
    for material, one in zip(mesh.materials, sums.tolist(), strict=True):
        if material is not None and one > 0.0:
            found[material] += one
    return found


def _plain_color(material: Any) -> tuple[tuple[float, float, float] | None, bool]:
    """Return the color of a material's only shader, None unless it's one color, and whether that's all metal."""
    shaders = [shader for shader, _ in surface_shaders_and_stacks(material)]
    socket = shaders[0].inputs.get(BASE_COLOR_INPUTS.get(shaders[0].type, "")) if len(shaders) == 1 else None
    if socket is None or socket.is_linked:
        return None, False
    red, green, blue, _ = (round(float(level), 4) for level in socket.default_value)
    metallic = shaders[0].inputs.get("Metallic")
    return (red, green, blue), bool(metallic and not metallic.is_linked and metallic.default_value > 1 - 1e-3)


def _least_constant_alpha(material: Any) -> float:
    sockets = [shader.inputs["Alpha"] for shader, _ in surface_shaders_and_stacks(material) if "Alpha" in shader.inputs]
    return min((float(socket.default_value) for socket in sockets if not socket.is_linked), default=1.0)
