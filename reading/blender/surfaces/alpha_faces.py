"""The faces of a mesh with alpha textures, and the textures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from hulldown.blender.buffers import read_property, texture_coordinates
from hulldown.geometry.alpha import AlphaMap, Cutouts, Extension, shrink_alpha_texels
from hulldown.reading.blender.surfaces.bake import bake_cutter, bake_opacity_by_material
from hulldown.reading.blender.surfaces.opacity import (
    IDENTITY_AFFINE,
    Cutter,
    Lookup,
    NotUnderstoodError,
    channel_texels,
    is_opaque,
)
from hulldown.reading.pieces.doubt import Doubt, DoubtKind


class CutoutReader:
    """Reads cut-outs; each material and each image is read once."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._opacities: dict[int, Lookup | float] = {}
        self._cutters: dict[int, Cutter | None] = {}
        self._texels: dict[Any, np.ndarray] = {}
        self.doubts: list[Doubt] = []

    def bake_material_opacity(self, materials: Iterable[Any]) -> None:
        """Bake the opacity of materials; call it while nothing is evaluated."""
        materials = [material for material in materials if not is_opaque(material)]
        self._opacities = bake_opacity_by_material(materials)
        for material in materials:
            if material.as_pointer() not in self._opacities:
                try:
                    self._cutters[material.as_pointer()] = bake_cutter(material, self._longest)
                except NotUnderstoodError as reason:
                    text = f"the material {material.name!r} counts as opaque: its transparency depends on {reason}"
                    self.doubts.append(Doubt(DoubtKind.OPACITY, text))

    def mesh_cutouts(self, data: Any, materials: list[Any]) -> Cutouts | None:
        """Return the cut-outs of an evaluated mesh with loop triangles."""
        cutters = [self._material_cutter(material) if material else None for material in materials]
        if not any(cutters):
            return None
        slot = read_property(data.loop_triangles, "material_index", np.int32).clip(0, len(materials) - 1)
        face = np.flatnonzero(np.array([cutter is not None for cutter in cutters])[slot])
        if not len(face):
            return None
        corners = read_property(data.loop_triangles, "loops", np.int32, 3).reshape(-1, 3)[face]
        uv, face_map = np.empty((len(face), 3, 2), dtype=np.float32), np.empty(len(face), dtype=np.int64)
        maps: dict[AlphaMap, int] = {}  # maps that a face uses, and their numbers
        for number, cutter in enumerate(cutters):
            of_slot = slot[face] == number
            if cutter is not None and of_slot.any():
                uv[of_slot] = _corner_texture_coordinates(data, cutter, corners[of_slot])
                face_map[of_slot] = maps.setdefault(cutter.alpha, len(maps))
        return Cutouts(face, uv, face_map, tuple(maps))

    def _material_cutter(self, material: Any) -> Cutter | None:
        key = material.original.as_pointer()
        if key not in self._cutters:
            self._cutters[key] = self._cutter_from_opacity(self._opacities[key]) if key in self._opacities else None
        return self._cutters[key]

    def _cutter_from_opacity(self, opacity: Lookup | float) -> Cutter | None:
        if isinstance(opacity, float):
            texel = np.full((1, 1), opacity, dtype=np.float32)
            return Cutter(AlphaMap(texel, Extension.EXTEND, smooth=False), "", IDENTITY_AFFINE) if opacity < 1.0 else None
        image, channel = opacity.image, opacity.channel
        if image is None or not (image.has_data or all(image.size)):  # asking for the size loads it
            return None  # Cycles renders it pink; the report lists it as missing
        key = (image.as_pointer(), channel, opacity.alpha_used)
        if key not in self._texels:
            self._texels[key] = channel_texels(image, channel, alpha_used=opacity.alpha_used)
        alpha = AlphaMap(self._texels[key], opacity.extension, opacity.smooth, opacity.curve)
        if max(alpha.texels.shape) > self._longest:
            small = (*key, opacity.curve is not None and opacity.curve.tobytes())
            if small not in self._texels:
                self._texels[small] = shrink_alpha_texels(alpha, self._longest)
            alpha = replace(alpha, texels=self._texels[small], curve=None)
        return Cutter(alpha, opacity.layer, opacity.image_from_uv)


def _corner_texture_coordinates(data: Any, cutter: Cutter, corners: Int[np.ndarray, "m 3"]) -> Float32[np.ndarray, "m 3 2"]:
    """Return the coordinates of face corners; zeros if the mesh has no such layer, as in Cycles."""
    found = texture_coordinates(data, cutter.layer)
    uv = np.zeros((*corners.shape, 2)) if found is None else found[corners]
    onto = np.array(cutter.image_from_uv)
    return np.asarray(uv @ onto[:, :2].T + onto[:, 2], dtype=np.float32)
