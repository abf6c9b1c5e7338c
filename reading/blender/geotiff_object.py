"""A GeoTIFF's elevations as an object in Blender, with an orthophoto or colors by slope."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from hulldown.base.errors import AssetError
from hulldown.blender.add_nodes import add_math_output, add_node
from hulldown.reading.confinement.landlock import is_in_readable_folder, readable_asset_folders
from hulldown.reading.pieces.options import Options
from hulldown.reading.scenery.geotiff import Elevations, read_elevations, read_orthophoto

TERRAIN_NAME = "terrain"
# Linear colors by the upward component of the normal: rock, scree, soil, grass.
SLOPE_COLORS = ((0.65, (0.17, 0.15, 0.13)), (0.8, (0.2, 0.17, 0.13)), (0.9, (0.13, 0.11, 0.06)), (0.97, (0.06, 0.08, 0.025)))
NOISE_PATCHES = ((0.004, 0.5), (0.05, 0.35), (0.6, 0.3))  # noise: waves per meter, and amplitude of brightness


def open_geotiff_terrain(path: Path, options: Options) -> tuple[Elevations, list[str]]:
    """Fill Blender's scene with a GeoTIFF's terrain; return its elevations, and the files it refers to."""
    terrain = read_elevations(path, area=options.area, scale=options.scale)
    mesh = bpy.data.meshes.new(TERRAIN_NAME)
    vertices, faces = terrain.mesh.vertices, terrain.mesh.faces
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, dtype=np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    obj = bpy.data.objects.new(TERRAIN_NAME, mesh)
    obj.location = terrain.anchor
    bpy.context.scene.collection.objects.link(obj)
    material = bpy.data.materials.new(TERRAIN_NAME)
    mesh.materials.append(material)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 0.95
    shader.inputs["Specular IOR Level"].default_value = 0.1
    color = _slope_color_socket(material.node_tree)
    texture = _confined_neighbor_path(path, options.texture) if options.texture else None
    if texture:
        low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
        anchor = terrain.anchor[:2]
        picture = read_orthophoto(texture, crs=terrain.crs, low=anchor + low, high=anchor + high)
        color = _draped_color_socket(material.node_tree, color, picture, low, high)
    material.node_tree.links.new(color, shader.inputs["Base Color"])
    return terrain, [str(texture)] if texture else []


def _confined_neighbor_path(path: Path, name: str) -> Path:
    file = Path(os.path.normpath(path.parent / name))
    if not is_in_readable_folder(file, readable_asset_folders(path)):
        raise AssetError("isn't in the folder of the elevations or the one around it", path=file, remedy="move it")
    return file


def _slope_color_socket(tree: Any) -> Any:
    normal, place = (add_node(tree, kind).outputs for kind in ("NewGeometry", "TexCoord"))
    brightness, uneven = 1.0, add_node(tree, "SeparateXYZ", {0: normal["Normal"]}).outputs["Z"]
    for scale, depth in NOISE_PATCHES:
        noise = add_node(tree, "TexNoise", {"Vector": place["Object"], "Scale": scale, "Detail": 5.0}).outputs["Factor"]
        uneven = add_math_output(tree, "MULTIPLY_ADD", noise, 0.06, uneven)
        brightness = add_math_output(
            tree, "MULTIPLY", add_math_output(tree, "MULTIPLY_ADD", noise, 2.0 * depth, 1.0 - depth), brightness
        )
    ramp = add_node(tree, "ValToRGB", {0: uneven})
    for k, (at, color) in enumerate(SLOPE_COLORS):
        stop = ramp.color_ramp.elements[k] if k < 2 else ramp.color_ramp.elements.new(1.0)
        stop.position, stop.color = at + 0.015 * len(NOISE_PATCHES), (*color, 1.0)
    inputs = {0: ramp.outputs["Color"], "Scale": brightness}
    return add_node(tree, "VectorMath", inputs, operation="SCALE").outputs[0]


def _draped_color_socket(
    tree: Any, below: Any, picture: UInt8[np.ndarray, "h w 4"], low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "orthophoto.png")
        Image.fromarray(picture).save(file, compress_level=1)
        image = bpy.data.images.load(str(file))
        image.pack()
    image.alpha_mode = "CHANNEL_PACKED"
    extent = np.subtract(high, low)
    inputs = {
        "Vector": add_node(tree, "TexCoord").outputs["Object"],
        "Location": (*(-low / extent), 0.0),
        "Scale": (*(1.0 / extent), 1.0),
    }
    turned = add_node(tree, "Mapping", inputs).outputs[0]
    shown = add_node(tree, "TexImage", {"Vector": turned}, image=image, extension="EXTEND").outputs
    # A mix node has sockets for each type of data: 0 is the factor, 6, 7, and the output 2 are colors.
    return add_node(tree, "Mix", {0: shown["Alpha"], 6: below, 7: shown["Color"]}, data_type="RGBA").outputs[2]
