"""What a material does to light, as far as its shader nodes say: fills a volume, displaces, lets one see through."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hulldown.reading.blender.surfaces.nodes import material_output

SEEN_THROUGH = 0.5  # least transmission of a surface that one sees through
TRANSPARENT = "BSDF_TRANSPARENT"
REFRACTING = ("BSDF_GLASS", "BSDF_REFRACTION")
GLOSSY = ("BSDF_GLOSSY", "BSDF_ANISOTROPIC")
PASSED_ON = ("MIX_SHADER", "ADD_SHADER", "REROUTE", "GROUP", "GROUP_INPUT")


def is_volume(material: Any) -> bool:
    """Whether a material has a volume and no surface."""
    output = material_output(material)
    return bool(output and output.inputs["Volume"].is_linked and not output.inputs["Surface"].is_linked)


def is_displaced(material: Any) -> bool:
    """Whether a material displaces what wears it."""
    output = material_output(material)
    return bool(output and output.inputs["Displacement"].is_linked)


def is_clear(material: Any) -> bool:
    """Whether one sees through a material, as through water or glass: by refraction, transmission or a volume.

    Leaves that are cut out by transparency are not clear: beside it their materials have an opaque shader.
    """
    output = material_output(material)
    if not output:
        return False
    shaders = [shader for shader, _ in surface_shaders(material)]
    if any(shader.type in REFRACTING or _transmits(shader) for shader in shaders):
        return True
    thin = all(shader.type in (TRANSPARENT, *GLOSSY) for shader in shaders)
    clear = any(shader.type == TRANSPARENT for shader in shaders)
    return thin and (clear or bool(output.inputs["Volume"].is_linked))


def surface_shaders(material: Any) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """The shader nodes of a material's surface, each with the group nodes that it is in, innermost first."""
    output = material_output(material)
    if output:
        yield from _shaders(output.inputs["Surface"], ())


def _transmits(shader: Any) -> bool:
    socket = shader.inputs.get("Transmission Weight") if shader.type == "BSDF_PRINCIPLED" else None
    return bool(socket and (socket.is_linked or socket.default_value >= SEEN_THROUGH))


def _shaders(socket: Any, around: tuple[Any, ...]) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """The shader nodes behind a socket; `around` are the groups that it is in, innermost first."""
    for link in socket.links:
        node = link.from_node
        if node.mute or node.type not in PASSED_ON:
            yield node, around
        elif node.type == "GROUP":
            inner = node.node_tree and next((n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT"), None)
            if inner:
                for behind in inner.inputs:
                    if behind.identifier == link.from_socket.identifier:
                        yield from _shaders(behind, (node, *around))
        elif node.type == "GROUP_INPUT":
            for given in around[0].inputs if around else ():
                if given.identifier == link.from_socket.identifier:
                    yield from _shaders(given, around[1:])
        else:
            for behind in node.inputs:
                if behind.type == "SHADER":
                    yield from _shaders(behind, around)
