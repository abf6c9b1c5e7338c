"""What materials read of their objects: random numbers by name, as in Cycles' object.cpp; the rest is a doubt."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hulldown.blender.add_nodes import add_node
from hulldown.blender.nodes import tree_and_nested_trees
from hulldown.blender.tidy_properties import RANDOM_PROPERTY
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.wording import quote_names

UNIT_PER_UINT32 = 1.0 / 0xFFFFFFFF


def instance_random_number(instance: Any) -> float:
    """Return Cycles' random number, from 0 to 1, of anything that `depsgraph.object_instances` yields."""
    return (
        (instance.random_id % 2**32) * UNIT_PER_UINT32 if instance.is_instance else random_number_of_name(instance.object.name)
    )


def random_number_of_name(name: str) -> float:
    """Return Cycles' random number of an object that is no instance: `final` of Jenkins's lookup3.c, 2006."""
    total = 0
    for byte in name.encode("utf-8", "surrogateescape"):
        total = (total * 37 + byte) % 2**32
    start = (0xDEADBEEF + (2 << 2) + 13) % 2**32
    a, b, c = (start + total) % 2**32, start, start
    for bits in ((14, 11, 25), (16, 4, 14)):
        c = ((c ^ b) - _rotate_left_32_bits(b, bits[0])) % 2**32
        a = ((a ^ c) - _rotate_left_32_bits(c, bits[1])) % 2**32
        b = ((b ^ a) - _rotate_left_32_bits(a, bits[2])) % 2**32
    return (((c ^ b) - _rotate_left_32_bits(b, 24)) % 2**32) * UNIT_PER_UINT32


def _rotate_left_32_bits(number: int, bits: int) -> int:
    return (number << bits | number >> (32 - bits)) % 2**32


def detach_materials_from_objects(materials: Iterable[Any]) -> None:
    """Make materials read `RANDOM_PROPERTY` instead of Cycles' random number, and no other object's coordinates."""
    nodes = [pair for material in materials for pair in _material_trees_and_nodes(material) if not pair[0].library]
    for tree, node in nodes:
        if node.type == "TEX_COORD":
            node.object = None
        elif node.type == "OBJECT_INFO" and (links := list(node.outputs["Random"].links)):
            number = add_node(tree, "Attribute", attribute_type="INSTANCER", attribute_name=RANDOM_PROPERTY).outputs[2]
            for link in links:
                tree.links.new(number, link.to_socket)


def lost_input_doubts(materials: Iterable[Any], *, moved: bool) -> list[Doubt]:
    """Return a doubt about materials that read what tidy twins lack, such as positions if twins are `moved`."""
    losing = [
        m.name for m in materials if any(_reads_lost_input(node, moved=moved) for _, node in _material_trees_and_nodes(m))
    ]
    text = (
        f"the materials {quote_names(losing)} read attributes, particles, strands, or positions of the file's objects, "
        "and look different without them; bake them into textures in Blender"
    )
    return [Doubt(DoubtKind.NOT_READ, text)] if losing else []


def _reads_lost_input(node: Any, *, moved: bool) -> bool:
    kind, read = node.type, {socket.name for socket in node.outputs if socket.is_linked}
    if kind == "ATTRIBUTE":
        return bool(read) and node.attribute_type != "GEOMETRY" and node.attribute_name != RANDOM_PROPERTY
    if kind == "NEW_GEOMETRY":
        return moved and "Position" in read
    if kind == "TEX_COORD" and node.object is not None and "Object" in read:
        return True
    instanced = kind in ("TEX_COORD", "UVMAP") and node.from_instancer and bool(read & {"Generated", "UV"})
    return instanced or (kind in ("PARTICLE_INFO", "HAIR_INFO") and bool(read))


def _material_trees_and_nodes(material: Any) -> Iterator[tuple[Any, Any]]:
    if material.node_tree is not None and not material.is_grease_pencil:
        yield from ((tree, node) for tree in tree_and_nested_trees(material.node_tree) for node in tree.nodes)
