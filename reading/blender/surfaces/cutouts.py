"""The faces of a mesh with alpha textures, and the textures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from hulldown.geometry.alpha import GRADES, AlphaMap, Cutouts, Extension, fewer_texels
from hulldown.reading.blender.arrays import coordinates, read
from hulldown.reading.blender.surfaces.bake import baked
from hulldown.reading.blender.surfaces.opacity import IDENTITY, Cutter, NotUnderstoodError, Value, opacity_of
from hulldown.reading.blender.surfaces.texels import texels


class CutoutReader:
    """Reads cut-outs; looks at each material and each image once.

    Parameters
    ----------
    longest
        Texels on the longer side of a stored image.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._cutters: dict[int, Cutter | None] = {}
        self._texels: dict[Any, np.ndarray] = {}
        self.doubts: list[str] = []

    def bake(self, materials: Iterable[Any]) -> None:
        """Bake the opacity of materials that are more than one lookup; call it while nothing is evaluated."""
        for material in materials:
            try:
                opacity_of(material)
            except NotUnderstoodError:
                key = material.as_pointer()
                try:
                    self._cutters[key] = baked(material, self._longest)
                except NotUnderstoodError as reason:
                    self._cutters[key] = None
                    self.doubts.append(
                        f"the material {material.name!r} counts as opaque: its transparency depends on {reason}"
                    )

    def cutouts(self, data: Any, materials: list[Any]) -> Cutouts | None:
        """Cut-outs of an evaluated mesh with loop triangles."""
        cutters = [self._cutter(material) if material else None for material in materials]
        if not any(cutters):
            return None
        slot = read(data.loop_triangles, "material_index", np.int32).clip(0, len(materials) - 1)
        face = np.flatnonzero(np.array([cutter is not None for cutter in cutters])[slot])
        if not len(face):
            return None
        corners = read(data.loop_triangles, "loops", np.int32, 3).reshape(-1, 3)[face]
        uv, face_map = np.empty((len(face), 3, 2), dtype=np.float32), np.empty(len(face), dtype=np.int64)
        maps: dict[AlphaMap, int] = {}  # those that a face wears, and their numbers
        for number, cutter in enumerate(cutters):
            of_slot = slot[face] == number
            if cutter is not None and of_slot.any():
                uv[of_slot] = _coordinates(data, cutter, corners[of_slot])
                face_map[of_slot] = maps.setdefault(cutter.alpha, len(maps))
        return Cutouts(face, uv, face_map, tuple(maps))

    def _cutter(self, material: Any) -> Cutter | None:
        key = material.original.as_pointer()
        if key not in self._cutters:
            self._cutters[key] = self._cut(opacity_of(material))
        return self._cutters[key]

    def _cut(self, value: Value) -> Cutter | None:
        if value.lookup is None:
            if value.curve >= 1.0:
                return None
            return Cutter(AlphaMap(value.curve.reshape(1, 1), Extension.EXTEND, smooth=False), "", IDENTITY)
        found = value.lookup
        image = found.node.image
        if image is None or not (image.has_data or all(image.original.size)):  # asking for the size loads it
            return None  # Cycles renders it pink; the report lists it as missing
        key = (image.original.as_pointer(), found.channel, found.node.outputs["Alpha"].is_linked)
        if key not in self._texels:
            self._texels[key] = texels(image.original, found.channel, alpha_used=key[-1])
        curve = None if (value.curve == GRADES).all() else value.curve
        smooth = found.node.interpolation != "Closest"
        alpha = AlphaMap(self._texels[key], Extension[found.node.extension], smooth, curve)
        if max(alpha.texels.shape) > self._longest:
            small = (*key, value.curve.tobytes())
            if small not in self._texels:
                self._texels[small] = fewer_texels(alpha, self._longest)
            alpha = replace(alpha, texels=self._texels[small], curve=None)
        return Cutter(alpha, found.layer, found.image_from_uv)


def _coordinates(data: Any, cutter: Cutter, corners: Int[np.ndarray, "m 3"]) -> Float32[np.ndarray, "m 3 2"]:
    """Coordinates of face corners; zeros if the mesh has no such layer, as in Cycles."""
    found = coordinates(data, cutter.layer)
    uv = np.zeros((*corners.shape, 2)) if found is None else found[corners]
    onto = np.array(cutter.image_from_uv)
    return np.asarray(uv @ onto[:, :2].T + onto[:, 2], dtype=np.float32)
