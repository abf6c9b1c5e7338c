"""Nodes of materials that read more than a mesh: an object, its instancer, its particle, or its place in the file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hulldown.reading.blender.api.add_nodes import add_node, maths
from hulldown.reading.blender.surfaces.nodes import trees
from hulldown.reading.blender.tidy_properties import INPUT, ROW
from hulldown.reading.pieces.roles import Key

ATTRIBUTE, OBJECT_INFO, PARTICLE = "ShaderNodeAttribute", "ShaderNodeObjectInfo", "ShaderNodeParticleInfo"
COORDINATES, UV_MAP, GEOMETRY = "ShaderNodeTexCoord", "ShaderNodeUVMap", "ShaderNodeNewGeometry"

Rows = Sequence[tuple[Any, Any]]  # three of an affine transform, each a vector and a number, or sockets with those


def reads(materials: Iterable[Any]) -> tuple[Key, ...]:
    """Return what the materials read of objects: type of the node or of its attribute, and name."""
    return tuple(dict.fromkeys(key for _, node in _nodes(materials) for key, _ in _inputs(node)))


def names_read(materials: Iterable[Any]) -> list[str]:
    """Return names of the attributes of objects that the materials read."""
    return [name for kind, name in reads(materials) if kind in ("OBJECT", "INSTANCER")]


def reads_places(materials: Iterable[Any]) -> bool:
    """Return whether a material reads a point's position in the file."""
    return any(True for _, node in _nodes(materials) for _ in _places(node))


def placed_objects(materials: Iterable[Any]) -> set[Any]:
    """Return the objects in whose coordinates the materials read positions."""
    return {obj for _, node in _nodes(materials) for _, obj in _places(node) if obj is not None}


def keep_inputs(
    materials: Iterable[Any],
    keys: Sequence[Key],
    places: Mapping[str, np.ndarray],
    file_from_twin: Float[np.ndarray, "4 4"] | None,
) -> None:
    """Make materials read custom properties in place of what is lost in a twin.

    `file_from_twin`: the file's coordinates by those of the twin; None if each object has its own, in the properties
    `ROW`.
    """
    numbers = {key: number for number, key in enumerate(keys)}
    moved = file_from_twin is None or not np.allclose(file_from_twin, np.eye(4), rtol=0.0, atol=1e-12)
    for tree, node in list(_nodes(materials)):
        for key, socket in list(_inputs(node)):
            name = f"{INPUT}{numbers[key]}"
            if socket is None:
                node.attribute_type, node.attribute_name = "INSTANCER", name
            else:
                found = _attribute(tree, name)
                _relink(tree, socket, found.outputs["Vector"] if socket.type == "VECTOR" else found.outputs[2])
        for socket, obj in list(_places(node)):
            if obj is None and not moved:
                continue
            place = _file_position(tree, file_from_twin)
            if obj is not None:
                place = _moved(tree, place, _rows(np.linalg.pinv(places[obj.name_full])))
                node.object = None
            _relink(tree, socket, place)


def _nodes(materials: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """Yield every node of these materials and of the groups in them, after its tree; each once, none of libraries."""
    seen = set()
    for material in materials:
        if material.node_tree is None or material.library or material.is_grease_pencil:
            continue
        for tree in trees(material.node_tree):
            if tree.as_pointer() not in seen and not tree.library:
                seen.add(tree.as_pointer())
                yield from ((tree, node) for node in tree.nodes)


def _inputs(node: Any) -> Iterator[tuple[Key, Any]]:
    """Yield what a node reads of an object, and the output that gives it; None if all of them do."""
    kind = node.bl_idname
    if kind == ATTRIBUTE and node.attribute_type != "GEOMETRY" and not node.attribute_name.startswith(INPUT):
        yield (node.attribute_type, node.attribute_name), None
    wanted: tuple[str, ...] = ()
    if kind == OBJECT_INFO:
        wanted = ("Location", "Random")
    elif kind == PARTICLE:
        wanted = tuple(socket.name for socket in node.outputs)
    elif kind in (COORDINATES, UV_MAP) and node.from_instancer:
        wanted = ("Generated", "UV")
    for socket in node.outputs:
        if socket.name in wanted and socket.is_linked:
            yield (kind, socket.name), socket


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    """Yield outputs of a node that give a point's position in the file, or by an object in it, which follows."""
    if node.bl_idname == GEOMETRY and node.outputs["Position"].is_linked:
        yield node.outputs["Position"], None
    if node.bl_idname == COORDINATES and node.object and node.outputs["Object"].is_linked:
        yield node.outputs["Object"], node.object


def _file_position(tree: Any, file_from_twin: Float[np.ndarray, "4 4"] | None) -> Any:
    if file_from_twin is not None:
        return _moved(tree, add_node(tree, "NewGeometry").outputs["Position"], _rows(file_from_twin))
    rows = [_attribute(tree, f"{ROW}{axis}").outputs for axis in range(3)]
    own = add_node(tree, "TexCoord").outputs["Object"]
    return _moved(tree, own, [(row["Vector"], row["Alpha"]) for row in rows])


def _rows(matrix: Float[np.ndarray, "4 4"]) -> Rows:
    return [(row[:3], row[3]) for row in matrix[:3].tolist()]


def _moved(tree: Any, position: Any, rows: Rows) -> Any:
    """Return a position after an affine transform."""
    along = [add_node(tree, "VectorMath", {0: position, 1: axis}, operation="DOT_PRODUCT") for axis, _ in rows]
    sums = [maths(tree, "ADD", dot.outputs["Value"], offset) for dot, (_, offset) in zip(along, rows, strict=True)]
    return add_node(tree, "CombineXYZ", dict(enumerate(sums))).outputs[0]


def _attribute(tree: Any, name: str) -> Any:
    return add_node(tree, "Attribute", attribute_type="INSTANCER", attribute_name=name)


def _relink(tree: Any, old: Any, new: Any) -> None:
    for link in list(old.links):
        tree.links.new(new, link.to_socket)
