"""Node trees, materials, and pictures for the scripts that build test files; run in Blender."""

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node

FORMATS = {".png": "PNG", ".exr": "OPEN_EXR"}


def node_group(kind, inputs=None, outputs=None):
    """Make a node group; return it, the sockets of its input node, and those of its output node.

    `kind` is "Geometry" or "Shader"; `inputs` and `outputs` are the types of its sockets by name. By default, geometry
    goes in and comes out.
    """
    group = bpy.data.node_groups.new("group", f"{kind}NodeTree")
    passed = {"Geometry": "Geometry"}
    for way, sockets in (("INPUT", inputs or passed), ("OUTPUT", outputs or passed)):
        for name, socket in sockets.items():
            group.interface.new_socket(name, in_out=way, socket_type=f"NodeSocket{socket}")
    return group, group.nodes.new("NodeGroupInput").outputs, group.nodes.new("NodeGroupOutput").inputs


def write_picture(path, pixels):
    """Write the pixels (h, w, 3 or 4), lowest row first, to a .png or .exr file."""
    height, width, channels = pixels.shape
    full = np.ones((height, width, 4), np.float32)
    full[..., :channels] = pixels
    image = bpy.data.images.new(path.stem, width, height, alpha=True, float_buffer=path.suffix == ".exr")
    image.pixels.foreach_set(full.ravel())
    image.filepath_raw, image.file_format = str(path), FORMATS[path.suffix]
    image.save()
    bpy.data.images.remove(image)
    return path


def principled(name, color, roughness=0.5, **inputs):
    """A material of one shader."""
    material = bpy.data.materials.new(name)
    shader = shader_of(material)
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    for key, value in {"Roughness": roughness, **inputs}.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return material


def shader_of(material):
    """The shader that a new material has."""
    return material.node_tree.nodes["Principled BSDF"]


def textured(name, image, **inputs):
    """A material of one shader with the colors of an image."""
    material = principled(name, (0.0, 0.0, 0.0), **inputs)
    colors = add_node(material.node_tree, "TexImage", image=image).outputs["Color"]
    material.node_tree.links.new(colors, shader_of(material).inputs["Base Color"])
    return material


def material_of(name, build, socket="Surface"):
    """A material with the shader whose output `build(tree)` returns."""
    material = bpy.data.materials.new(name)
    material.node_tree.nodes.clear()
    add_node(material.node_tree, "OutputMaterial", {socket: build(material.node_tree)})
    return material


def shader_group(roughness):
    """A node group around a shader, as in material packs."""
    group, given, result = node_group("Shader", {"Color": "Color"}, {"Shader": "Shader"})
    shader = add_node(group, "BsdfPrincipled", {"Base Color": given[0], "Roughness": roughness})
    group.links.new(shader.outputs[0], result[0])
    return group


def grouped(name, group, color):
    """A material that is such a group, in one color."""
    return material_of(name, lambda tree: add_node(tree, "Group", {0: (*color, 1.0)}, node_tree=group).outputs[0])
