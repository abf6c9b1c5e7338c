"""Bake opacity over texture coordinates with Cycles, for node trees that are more than one lookup."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

from hulldown.geometry.alpha import AlphaMap, Extension
from hulldown.reading.blender.arrays import coordinates
from hulldown.reading.blender.light_pictures import rendered, see_pixel_centers
from hulldown.reading.blender.surfaces.nodes import material_output, upstream
from hulldown.reading.blender.surfaces.opacity import Cutter, NotUnderstoodError
from hulldown.reading.blender.surfaces.opacity_nodes import show_opacity

WIDEST = 16.0  # times that an image may repeat in what is baked
# Nodes whose outputs follow from their inputs.
PLAIN = (
    *("Math", "VectorMath", "Mix", "MixRGB", "MapRange", "Clamp", "ValToRGB", "Invert", "RGBCurve", "FloatCurve"),
    *("VectorCurve", "SeparateColor", "SeparateXYZ", "CombineColor", "CombineXYZ", "Gamma", "BrightContrast"),
    *("HueSaturation", "RGBToBW", "Value", "RGB", "Mapping", "VectorRotate", "Emission", "MixShader"),
)
TEXTURES = tuple(f"Tex{name}" for name in ("Noise", "Voronoi", "Wave", "Magic", "Checker", "Brick", "Gradient"))


def baked(material: Any, size: int) -> Cutter:
    """The opacity of a material, over the range of its coordinates.

    Parameters
    ----------
    material
        An original, not evaluated.
    size
        Texels of the longer side.

    Raises
    ------
    NotUnderstoodError
        Naming what it depends on, besides texture coordinates.
    """
    copy = material.copy()
    groups = list(_own_groups(copy.node_tree))
    try:
        show_opacity(copy)
        layer = _layer(copy)
        low, high = _range(material, layer)
        texels = _render(copy, layer, low, high, size)
    finally:
        bpy.data.materials.remove(copy)
        for group in groups:
            bpy.data.node_groups.remove(group)
    whole = (low == 0.0).all() and (high == 1.0).all()
    extension = Extension.REPEAT if whole else Extension.EXTEND
    (x_scale, y_scale), (x, y) = (1.0 / (high - low)).tolist(), (-low / (high - low)).tolist()
    onto = ((x_scale, 0.0, x), (0.0, y_scale, y))
    return Cutter(AlphaMap(np.rint(texels * 255.0).astype(np.uint8), extension), layer, onto)


def _own_groups(tree: Any) -> Iterator[Any]:
    """Give a tree copies of its groups."""
    for node in tree.nodes:
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
            node.node_tree = node.node_tree.copy()
            yield node.node_tree
            yield from _own_groups(node.node_tree)


def _layer(material: Any) -> str:
    """The one layer of coordinates that the opacity depends on; "" is the one that is rendered."""
    output = material_output(material)
    found = {_layer_read_by(node, socket) for node, socket in upstream(output.inputs["Surface"], ())}
    layers = sorted(layer for layer in found if layer is not None)
    if len(layers) > 1:
        raise NotUnderstoodError(f"several layers of texture coordinates: {layers}")
    return layers[0] if layers else ""


def _layer_read_by(node: Any, socket: Any) -> str | None:
    """The layer of coordinates that a node reads; None if it reads none."""
    kind = node.bl_idname.removeprefix("ShaderNode")
    if kind == "UVMap" and not node.from_instancer:
        return str(node.uv_map)
    if kind == "TexImage" and node.projection == "FLAT":
        return None if node.inputs["Vector"].is_linked else ""
    if kind == "TexCoord" and socket.name == "UV" and not node.from_instancer:
        return ""
    placed = kind in TEXTURES and node.inputs["Vector"].is_linked
    if kind in PLAIN or placed or (kind == "LightPath" and socket.name.startswith("Is ")):
        return None
    raise NotUnderstoodError(f"the node {node.name!r}")


def _range(material: Any, layer: str) -> tuple[np.ndarray, np.ndarray]:
    """All coordinates of meshes with the material, and from 0 to 1."""
    low, high = np.zeros(2), np.ones(2)
    for mesh in bpy.data.meshes:
        if material.name not in mesh.materials:
            continue
        uv = coordinates(mesh, layer)
        if uv is not None and len(uv):
            low, high = np.minimum(low, uv.min(axis=0)), np.maximum(high, uv.max(axis=0))
    if (high - low).max() > WIDEST:
        raise NotUnderstoodError(f"nodes whose texture repeats {(high - low).max():.0f} times")
    return low, high


def _render(material: Any, layer: str, low: np.ndarray, high: np.ndarray, size: int) -> np.ndarray:
    extent = (high - low) / (high - low).max()
    width, height = np.maximum(np.rint(extent * size), 1).astype(int).tolist()
    scene = bpy.data.scenes.new("hulldown bake")
    mesh = bpy.data.meshes.new("hulldown bake")
    lens = bpy.data.cameras.new("hulldown bake")
    x, y = width / max(width, height), height / max(width, height)
    mesh.from_pydata([(0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0)], [], [(0, 1, 2, 3)])
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]], dtype=np.float32)
    mesh.uv_layers.new(name=layer or "UVMap").uv.foreach_set("vector", corners.ravel())
    mesh.materials.append(material)
    plane, camera = bpy.data.objects.new("hulldown bake", mesh), bpy.data.objects.new("hulldown bake", lens)
    lens.type, lens.ortho_scale = "ORTHO", 1.0
    camera.location = (x / 2, y / 2, 1.0)
    for obj in (plane, camera):
        scene.collection.objects.link(obj)
    scene.camera, scene.frame_current = camera, bpy.context.scene.frame_current
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_adaptive_sampling = "CPU", 1, False
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, 0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    see_pixel_centers(scene)
    try:
        return rendered(scene)[..., 0].clip(0.0, 1.0)
    finally:
        bpy.data.batch_remove([plane, camera, mesh, lens, scene])
