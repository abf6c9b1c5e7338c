"""The vehicle at each pixel's center by one ray of Cycles, opaque from a half on: the oracle for annotations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from hulldown.blender.light_pictures import render_light, set_light_at_pixel_centers
from hulldown.blender.opacity_nodes import show_opacity
from hulldown.blender.shaders import is_volume_only_material
from hulldown.render.blender import cycles
from hulldown.render.blender.messages import CyclesSettings
from hulldown.render.blender.scene import BlenderScene

FIRST_OBJECT_NUMBER = 30000  # of vehicles; files number their own objects from 1
INDEX_NODE_LABEL = "hulldown index"
ONE_RAY = CyclesSettings(samples=1, denoise=False, adaptive_threshold=0.0, bounces=0)


class IndexPictures:
    """A stage that renders object numbers."""

    def __init__(self, stage: BlenderScene, *, device: str, threads: int = 0) -> None:
        self.stage = stage
        self._bare = bpy.data.scenes.new("hulldown bare")
        self._bare.collection.objects.link(stage.root)
        self._bare.collection.objects.link(stage.camera)
        self._bare.camera = stage.camera
        dark = bpy.data.worlds.new("hulldown dark")
        dark.node_tree.nodes.clear()
        for scene in (stage.scene, self._bare):
            cycles.configure_scene(scene, ONE_RAY, device=device, threads=threads)
            set_light_at_pixel_centers(scene)
            scene.world = dark
        for obj in stage.scene.objects:
            if _is_only_volume(obj):
                obj.hide_render = True
        self._plain = bpy.data.materials.new("hulldown index")

    def render_vehicle_index_maps(self, vehicles: Sequence[Sequence[Any]]) -> np.ndarray:
        """Return the vehicle at each pixel's center."""
        for number, objects in enumerate(vehicles):
            for obj in objects:
                obj.pass_index = FIRST_OBJECT_NUMBER + number
        self._make_materials_emit_index()
        pictures = [_render_object_numbers(self.stage.scene)]
        render, bare = self.stage.scene.render, self._bare
        for name in ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y"):
            setattr(bare.render, name, getattr(render, name))
        for objects in vehicles:
            for obj in objects:
                bare.collection.objects.link(obj)
            pictures.append(_render_object_numbers(bare))
            for obj in objects:
                bare.collection.objects.unlink(obj)
        numbers = np.stack(pictures)
        return np.where(numbers >= FIRST_OBJECT_NUMBER, numbers - FIRST_OBJECT_NUMBER + 1, 0).astype(np.uint8)

    def _make_materials_emit_index(self) -> None:
        for material in bpy.data.materials:
            if INDEX_NODE_LABEL not in material and not material.is_grease_pencil:
                if material.node_tree is None:  # before Blender 5.0 it may have none
                    material.use_nodes = True
                show_opacity(material, _object_index_socket)
                material[INDEX_NODE_LABEL] = True
        for blocks in (bpy.data.meshes, bpy.data.curves, bpy.data.hair_curves, bpy.data.metaballs):
            for data in blocks:
                if not data.materials:
                    data.materials.append(self._plain)
                for slot, material in enumerate(data.materials):
                    data.materials[slot] = material or self._plain
        for obj in bpy.data.objects:
            for slot in obj.material_slots:
                if slot.link == "OBJECT" and slot.material is None:
                    slot.material = self._plain


def _render_object_numbers(scene: Any) -> np.ndarray:
    return np.rint(render_light(scene)[::-1, :, 0]).astype(np.int64)


def _object_index_socket(tree: Any) -> Any:
    return tree.nodes.new("ShaderNodeObjectInfo").outputs["Object Index"]


def _is_only_volume(obj: Any) -> bool:
    """Return whether a mesh has only volume shaders, so that it hides nothing as a surface."""
    if obj.type == "VOLUME":
        return True
    materials = [slot.material for slot in obj.material_slots if slot.material is not None]
    shown = [material for material in materials if material.node_tree is not None]
    return bool(shown) and all(is_volume_only_material(material) for material in shown)
