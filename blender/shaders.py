"""Properties of a material by its shader nodes: volume, displacement, transparency."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hulldown.blender.nodes import Stack, material_output_node, socket_source_and_stack

MIN_TRANSPARENT_TRANSMISSION = 0.5  # a surface that transmits less isn't transparent
TRANSPARENT_SHADER = "BSDF_TRANSPARENT"
REFRACTION_SHADERS = ("BSDF_GLASS", "BSDF_REFRACTION")
GLOSSY_SHADERS = ("BSDF_GLOSSY", "BSDF_ANISOTROPIC")
BASE_COLOR_INPUTS = {"BSDF_PRINCIPLED": "Base Color", "BSDF_DIFFUSE": "Color"}  # by shader
MIXING_SHADERS = ("MIX_SHADER", "ADD_SHADER")


def is_volume_only_material(material: Any) -> bool:
    """Return whether a material has a volume and no surface."""
    output = material_output_node(material)
    return bool(output and output.inputs["Volume"].is_linked and not output.inputs["Surface"].is_linked)


def is_displaced_material(material: Any) -> bool:
    """Return whether a material displaces its surface."""
    output = material_output_node(material)
    return bool(output and output.inputs["Displacement"].is_linked)


def is_clear_material(material: Any) -> bool:
    """Return whether a material is transparent like water or glass; leaves cut out by a texture aren't."""
    output = material_output_node(material)
    if not output:
        return False
    shaders = [shader for shader, _ in surface_shaders_and_stacks(material)]
    if any(shader.type in REFRACTION_SHADERS or _transmits_light(shader) for shader in shaders):
        return True
    thin = all(shader.type in (TRANSPARENT_SHADER, *GLOSSY_SHADERS) for shader in shaders)
    clear = any(shader.type == TRANSPARENT_SHADER for shader in shaders)
    return thin and (clear or bool(output.inputs["Volume"].is_linked))


def surface_shaders_and_stacks(material: Any) -> Iterator[tuple[Any, Stack]]:
    """Yield the shader nodes of a material's surface, each with the group nodes that it is in."""
    output = material_output_node(material)
    if output:
        yield from _shaders_and_stacks(output.inputs["Surface"], ())


def _transmits_light(shader: Any) -> bool:
    socket = shader.inputs.get("Transmission Weight") if shader.type == "BSDF_PRINCIPLED" else None
    return bool(socket and (socket.is_linked or socket.default_value >= MIN_TRANSPARENT_TRANSMISSION))


def _shaders_and_stacks(socket: Any, stack: Stack) -> Iterator[tuple[Any, Stack]]:
    found = socket_source_and_stack(socket, stack)
    if found is None or not found[0].is_output:
        return
    node, stack = found[0].node, found[1]
    if node.type not in MIXING_SHADERS:
        yield node, stack
        return
    for behind in node.inputs:
        if behind.type == "SHADER":
            yield from _shaders_and_stacks(behind, stack)
