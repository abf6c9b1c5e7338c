"""Bake opacity with Cycles: over the values of one image lookup, or over texture coordinates if there is more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float, Float32

from hulldown.base.color import linear_from_srgb
from hulldown.blender.buffers import texture_coordinates
from hulldown.blender.light_pictures import render_light, set_light_at_pixel_centers
from hulldown.blender.nodes import material_output_node, tree_and_nested_trees, upstream_nodes_and_outputs
from hulldown.blender.opacity_nodes import show_opacity
from hulldown.geometry.alpha import TEXEL_GRADES, AlphaMap, Extension
from hulldown.reading.blender.surfaces.opacity import Cutter, Lookup, NotUnderstoodError, single_image_lookup

CYCLES_NOISE = 2e-6  # Cycles' luminance of white is 1.000001
MIN_BAKE_SIDE_PX = 4  # of a picture that Blender renders
UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 1.0]])
MAX_IMAGE_REPEATS = 16.0  # in what is baked
# Nodes whose outputs follow from their inputs.
PLAIN_NODES = (
    *("Math", "VectorMath", "Mix", "MixRGB", "MapRange", "Clamp", "ValToRGB", "Invert", "RGBCurve", "FloatCurve"),
    *("VectorCurve", "SeparateColor", "SeparateXYZ", "CombineColor", "CombineXYZ", "Gamma", "BrightContrast"),
    *("HueSaturation", "RGBToBW", "Value", "RGB", "Mapping", "VectorRotate", "Emission", "MixShader"),
)
TEXTURE_NODES = tuple(f"Tex{name}" for name in ("Noise", "Voronoi", "Wave", "Magic", "Checker", "Brick", "Gradient"))


def bake_opacity_by_material(materials: Sequence[Any]) -> dict[int, Lookup | float]:
    """Return the opacity of materials by pointer, if it's a monotone function of one lookup."""
    found: dict[int, Lookup | float] = {}
    shown, lookups = [], dict[int, Lookup | None]()
    with ExitStack() as copies:
        images = [
            copies.enter_context(_temporary_grade_image(values)) for values in (TEXEL_GRADES, linear_from_srgb(TEXEL_GRADES))
        ]
        for material, copy in zip(materials, copies.enter_context(_opacity_emitting_copies(materials)), strict=True):
            with suppress(NotUnderstoodError):
                lookups[material.as_pointer()] = lookup = single_image_lookup(copy)
                _replace_lookup_images(copy, images[lookup is not None and lookup.is_srgb])
                shown.append(copy)
        rows = _render_materials(shown, "", UNIT_SQUARE, (len(TEXEL_GRADES), 1))[:, 0] if shown else np.empty((0, 0))
    for (key, lookup), curve in zip(lookups.items(), rows, strict=True):
        is_texel = bool(np.abs(curve - TEXEL_GRADES).max() <= CYCLES_NOISE)
        one_way = (np.diff(curve) >= -CYCLES_NOISE).all() or (np.diff(curve) <= CYCLES_NOISE).all()
        if lookup is None or (np.ptp(curve) <= CYCLES_NOISE and lookup.has_texels_in_unit_range()):
            found[key] = round(float(curve[0]), 6)
        elif one_way and (is_texel or lookup.has_texels_in_unit_range()):
            found[key] = replace(lookup, curve=None if is_texel else curve)
    return found


@contextmanager
def _opacity_emitting_copies(materials: Sequence[Any]) -> Iterator[list[Any]]:
    copies = [material.copy() for material in materials]
    groups = [group for copy in copies for group in _copy_node_groups(copy.node_tree)]
    try:
        for copy in copies:
            show_opacity(copy)
        yield copies
    finally:
        bpy.data.batch_remove([*copies, *groups])  # one by one, each would look through all data


@contextmanager
def _temporary_grade_image(values: Float[np.ndarray, " g"]) -> Iterator[Any]:
    image = bpy.data.images.new("hulldown grades", len(values), 1, alpha=True, float_buffer=True, is_data=True)
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(np.repeat(values.astype(np.float32), 4))
    try:
        yield image
    finally:
        bpy.data.images.remove(image)


def _replace_lookup_images(material: Any, image: Any) -> None:
    for tree in tree_and_nested_trees(material.node_tree):
        for node in tree.nodes:
            if node.bl_idname == "ShaderNodeTexImage":
                node.image, node.interpolation, node.extension = image, "Closest", "EXTEND"
                for link in node.inputs["Vector"].links:
                    tree.links.remove(link)


def bake_cutter(material: Any, size: int) -> Cutter:
    """Return the opacity of a material, over the range of its coordinates."""
    with _opacity_emitting_copies([material]) as (copy,):
        layer = _opacity_uv_layer(copy)
        low, high = uv = _material_uv_range(material, layer)
        extent = (high - low) / (high - low).max()
        (texels,) = _render_materials([copy], layer, uv, np.maximum(np.rint(extent * size), 1).astype(int).tolist())
    whole = (low == 0.0).all() and (high == 1.0).all()
    extension = Extension.REPEAT if whole else Extension.EXTEND
    (x_scale, y_scale), (x, y) = (1.0 / (high - low)).tolist(), (-low / (high - low)).tolist()
    onto = ((x_scale, 0.0, x), (0.0, y_scale, y))
    return Cutter(AlphaMap(np.rint(texels * 255.0).astype(np.uint8), extension), layer, onto)


def _copy_node_groups(tree: Any) -> Iterator[Any]:
    for node in tree.nodes:
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
            node.node_tree = node.node_tree.copy()
            yield node.node_tree
            yield from _copy_node_groups(node.node_tree)


def _opacity_uv_layer(material: Any) -> str:
    """Return the one layer of coordinates that the opacity depends on; "" is the rendered layer."""
    output = material_output_node(material)
    found = {_node_uv_layer(node, socket) for node, socket in upstream_nodes_and_outputs(output.inputs["Surface"], ())}
    layers = sorted(layer for layer in found if layer is not None)
    if len(layers) > 1:
        raise NotUnderstoodError(f"several layers of texture coordinates: {layers}")
    return layers[0] if layers else ""


def _node_uv_layer(node: Any, socket: Any) -> str | None:
    kind = node.bl_idname.removeprefix("ShaderNode")
    if kind == "UVMap" and not node.from_instancer:
        return str(node.uv_map)
    if kind == "TexImage" and node.projection == "FLAT":
        return None if node.inputs["Vector"].is_linked else ""
    if kind == "TexCoord" and socket.name == "UV" and not node.from_instancer:
        return ""
    placed = kind in TEXTURE_NODES and node.inputs["Vector"].is_linked
    if kind in PLAIN_NODES or placed or (kind == "LightPath" and socket.name.startswith("Is ")):
        return None
    raise NotUnderstoodError(f"the node {node.name!r}")


def _material_uv_range(material: Any, layer: str) -> Float[np.ndarray, "2 2"]:
    low, high = np.zeros(2), np.ones(2)
    for mesh in bpy.data.meshes:
        if material.name not in mesh.materials:
            continue
        uv = texture_coordinates(mesh, layer)
        if uv is not None and len(uv):
            low, high = np.minimum(low, uv.min(axis=0)), np.maximum(high, uv.max(axis=0))
    if (high - low).max() > MAX_IMAGE_REPEATS:
        raise NotUnderstoodError(f"nodes whose texture repeats {(high - low).max():.0f} times")
    return np.stack([low, high])


def _render_materials(
    materials: Sequence[Any], layer: str, uv: Float[np.ndarray, "2 2"], size: Sequence[int]
) -> Float32[np.ndarray, "n h w"]:
    """Return the light of materials, from 0 to 1, each on a rectangle of its own of this size in pixels."""
    scene, lens = bpy.data.scenes.new("hulldown bake"), bpy.data.cameras.new("hulldown bake")
    mesh = bpy.data.meshes.new("hulldown bake")
    (width, height), count = size, len(materials)
    seen = np.maximum([width, count * height], MIN_BAKE_SIDE_PX)
    x, y = np.array([width, height]) / seen.max()
    ends = [(0, 0), (1, 0), (1, 1), (0, 1)]  # a rectangle's corners along both sides
    points = [(x * i, y * (k + j), 0.0) for k in range(count) for i, j in ends]
    mesh.from_pydata(points, [], np.arange(4 * count).reshape(-1, 4).tolist())
    corners = np.tile([(uv[i, 0], uv[j, 1]) for i, j in ends], (count, 1))
    mesh.uv_layers.new(name=layer or "UVMap").uv.foreach_set("vector", corners.astype(np.float32).ravel())
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.arange(count, dtype=np.int32))
    plane, camera = bpy.data.objects.new("hulldown bake", mesh), bpy.data.objects.new("hulldown bake", lens)
    lens.type, lens.ortho_scale = "ORTHO", 1.0
    camera.location = (*(seen / seen.max() / 2), 1.0)
    for obj in (plane, camera):
        scene.collection.objects.link(obj)
    scene.camera, scene.frame_current = camera, bpy.context.scene.frame_current
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_adaptive_sampling = "CPU", 1, False
    scene.cycles.use_denoising, scene.cycles.max_bounces = False, 0
    scene.render.resolution_x, scene.render.resolution_y = seen.tolist()
    scene.render.resolution_percentage = 100
    set_light_at_pixel_centers(scene)
    try:
        light = render_light(scene)[: count * height, :width, 0]
        return light.clip(0.0, 1.0).reshape(count, height, width)
    finally:
        bpy.data.batch_remove([plane, camera, mesh, lens, scene])
