"""Open an asset file of any format in Blender, without running its scripts."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular_file
from hulldown.blender.add_nodes import add_node, feed_input
from hulldown.blender.opening import open_blend
from hulldown.blender.shaders import surface_shaders_and_stacks
from hulldown.reading.blender.duplicates import Duplicate, remove_duplicate_objects
from hulldown.reading.blender.geotiff_object import open_geotiff_terrain
from hulldown.reading.blender.surfaces.textures import relink_moved_pictures
from hulldown.reading.confinement.blocks import refuse_special_references
from hulldown.reading.confinement.references import gltf_mesh_compression, obj_directives, obj_material_libraries
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.wording import quote_names
from hulldown.reading.scenery.geotiff import Elevations

FIRST_NODES_VERSION = (2, 80)  # older files have texture slots
GLASS_MODELS = ("4", "6", "7", "9")  # illumination models with transparency or refraction
TRANSMISSION_SOCKET = "Transmission Weight"
MIN_MAP_COORDINATE_M = 1e5  # from here on a float32 has steps of a centimeter
MAP_STEP_M = 1000.0  # float32 holds its multiples exactly
RESAVE_REMEDY = "open it in Blender and save it again"


@dataclass(frozen=True, slots=True)
class Opened:
    """Properties of the file that is open in Blender."""

    unit: float  # meters to one unit
    up: str  # the axis that points up, "z" or "y"
    written_by: str  # the Blender that wrote it, or its format
    doubts: tuple[Doubt, ...] = ()
    # duplicates taken out of the scene, by the name of the object that they equal
    duplicates: Mapping[str, Sequence[Duplicate]] = field(default_factory=dict)
    terrain: Elevations | None = None  # of a GeoTIFF: the elevations, in float64
    files: Sequence[str] = ()  # files that it refers to besides those that Blender lists


def open_asset_in_blender(path: Path, kind: str, options: Options) -> Opened:
    """Open `path` in Blender."""
    if kind == "blend":
        return _open_blend_asset(path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if kind == "geotiff":
        terrain, files = open_geotiff_terrain(path, options)
        return Opened(1.0, "z", "GeoTIFF", terrain.doubts, terrain=terrain, files=files)
    up = "z"
    # Blender starts with a scale of 1 m; glTF and FBX bring their own units and up axis, and the importers heed them.
    try:
        if kind == "gltf":
            vars(sys.modules["io_scene_gltf2"])["glTF2ImportUserExtension"] = RestPose
            bpy.ops.import_scene.gltf(filepath=str(path))
        elif kind == "fbx":
            bpy.ops.wm.fbx_import(filepath=str(path), use_anim=False)
            _relink_objects_by_name()
        else:
            # As it is in the file: then `up` in the config means the file's axis, and y is what OBJ files have.
            grouped = not any(key == "o" for key, _ in obj_directives(path, b"o"))
            with _recentered_obj_and_offset(path) as (file, offset):
                bpy.ops.wm.obj_import(filepath=str(file), forward_axis="Y", up_axis="Z", use_split_groups=grouped)
            for obj in bpy.context.scene.objects:
                obj.location = offset
            up = "z" if abs(offset[1]) > MIN_MAP_COORDINATE_M else "y"  # a northing isn't a height
            _make_false_glass_opaque(path)
            _wear_vertex_colors()
    except (RuntimeError, ValueError) as error:
        extension = gltf_mesh_compression(path) if kind == "gltf" else ""
        remedy = f"write it without {extension}, with gltf-transform for example" if extension else "export it again"
        raise AssetError(f"Blender cannot import it ({_short_error_text(error)})", remedy=remedy) from None
    if not bpy.context.scene.objects:
        raise AssetError("Blender finds nothing in it to import", remedy="export it again")
    doubts = tuple(relink_moved_pictures(path))
    return Opened(1.0, up, kind.upper().replace("GLTF", "glTF"), doubts)


class RestPose:
    """Extension of Khronos's glTF importer: nodes keep the file's pose, not that of an animation's first frame."""

    def gather_import_animations(self, animations: list[Any] | None, options: Any, gltf: Any) -> None:
        """Leave out the file's animations."""
        if animations:
            animations.clear()


def _relink_objects_by_name() -> None:
    """Link the scene's objects by name, since the FBX importer orders them (and meshes) differently in each process."""
    linked = bpy.context.scene.collection.objects
    for obj in sorted(linked, key=lambda obj: str(obj.name)):
        linked.unlink(obj)
        linked.link(obj)


@contextmanager
def _recentered_obj_and_offset(path: Path) -> Iterator[tuple[Path, list[float]]]:
    """Yield an OBJ file, or a copy near zero if its vertices are too large for float32, and the copy's offset."""
    offset = _obj_map_offset(path)
    if not any(offset):
        yield path, offset
        return
    with tempfile.TemporaryDirectory() as folder:
        copy, back = Path(folder, path.name), os.path.relpath(path.parent.resolve(), Path(folder).resolve())
        with open_regular_file(path) as lines, copy.open("wb") as file:
            for line in lines:
                words = line.split()
                if words[:1] == [b"v"]:
                    near = [float(x) - zero for x, zero in zip(words[1:4], offset, strict=True)]
                    line = b"v %.6f %.6f %.6f " % tuple(near) + b" ".join(words[4:]) + b"\n"
                elif words[:1] == [b"mtllib"]:
                    line = line.replace(b"mtllib", b"mtllib " + os.fsencode(back) + b"/", 1).replace(b"/ ", b"/", 1)
                file.write(line)
        yield copy, offset


def _obj_map_offset(path: Path) -> list[float]:
    """Return where the vertices of an OBJ file are, in whole kilometers; zeros unless that's on a map."""
    first = next((text.split()[:3] for key, text in obj_directives(path, b"v") if key == "v"), [])
    offset = (np.rint(np.array(first, dtype=np.float64) / MAP_STEP_M) * MAP_STEP_M).tolist()
    return offset if any(abs(x) > MIN_MAP_COORDINATE_M for x in offset) else [0.0, 0.0, 0.0]


def _wear_vertex_colors() -> None:
    """Give objects without a material the colors at their vertices, as scanning and generating programs write them."""
    bare = [obj.data for obj in bpy.context.scene.objects if obj.type == "MESH" and not obj.data.materials]
    bare = [mesh for mesh in bare if mesh.color_attributes]
    if bare:
        material = bpy.data.materials.new("vertex colors")
        tree = material.node_tree
        colors = add_node(tree, "VertexColor", layer_name=bare[0].color_attributes[0].name)  # the importer's
        feed_input(tree, tree.nodes["Principled BSDF"].inputs["Base Color"], colors.outputs["Color"])
    for mesh in bare:
        mesh.materials.append(material)


def _make_false_glass_opaque(path: Path) -> None:
    """Make materials opaque whose model isn't in `GLASS_MODELS`: exporters write ``Tf 1 1 1`` for those too."""
    found = [(m.name, shader) for m in bpy.data.materials for shader, _ in surface_shaders_and_stacks(m)]
    clear = [(name, shader.inputs[TRANSMISSION_SOCKET]) for name, shader in found if shader.type == "BSDF_PRINCIPLED"]
    clear = [(name, weight) for name, weight in clear if weight.default_value > 0.0]
    if not clear:
        return
    models = {name: model for library in obj_material_libraries(path) for name, model in _illumination_models(library).items()}
    for name, weight in clear:
        if models.get(name, GLASS_MODELS[0]) not in GLASS_MODELS:
            weight.default_value = 0.0


def _illumination_models(library: Path) -> dict[str, str]:
    models: dict[str, str] = {}
    name = ""
    for key, value in obj_directives(library, b"newmtl", b"illum"):
        if key == "newmtl":
            name = value
            models[name] = "2"
        elif name:
            models[name] = value
    return models


def _open_blend_asset(path: Path) -> Opened:
    refuse_special_references(path)
    duplicates: dict[str, list[Duplicate]] = {}
    try:
        left_out = open_blend(str(path), then=lambda: duplicates.update(remove_duplicate_objects()))
    except RuntimeError as error:
        raise AssetError(f"Blender cannot read it ({_short_error_text(error)})", remedy=RESAVE_REMEDY) from None
    version = ".".join(map(str, bpy.data.version[:2]))
    if tuple(bpy.data.version[:2]) > bpy.app.version[:2]:
        raise AssetError(
            f"was written by Blender {version}, newer than the {bpy.app.version_string} that is installed",
            remedy=f"save it for an older Blender or install bpy {version}",
        )
    scene = bpy.context.scene
    units = scene.unit_settings
    # The file holds a float32; 0.01 shall be 0.01.
    unit = float(f"{units.scale_length:.7g}") if units.system != "NONE" else 1.0
    if len(bpy.data.scenes) > 1:
        others = quote_names(s.name for s in bpy.data.scenes if s != scene)
        if not scene.objects:
            raise AssetError(
                f"its active scene {scene.name!r} is empty, beside {others}",
                remedy="choose a scene with objects in Blender and save",
            )
        left_out.append(f"only the scene {scene.name!r} is read, not {others}")
    layers = [layer.name for layer in scene.view_layers if layer.use]
    if len(layers) > 1:
        left_out.append(f"only the view layer {layers[0]!r} is read, not {quote_names(layers[1:])}")
    if lost := _lost_texture_picture_names():
        left_out.append(
            f"{len(lost)} of its pictures, such as {lost[0]!r}, belong to textures from before Blender 2.80, so their "
            "objects are rendered in one color; give the materials image nodes"
        )
    doubts = (Doubt(DoubtKind.NOT_READ, text) for text in left_out)
    return Opened(unit, "z", f"Blender {version}", (*doubts, *relink_moved_pictures(path)), duplicates)


def _lost_texture_picture_names() -> list[str]:
    """Return pictures of old files whose texture slots no longer exist, so that no material uses them."""
    if tuple(bpy.data.version[:2]) >= FIRST_NODES_VERSION:
        return []
    textures = [t for t in bpy.data.textures if t.type == "IMAGE" and t.users == 0]
    return sorted({t.image.name for t in textures if t.image})


def _short_error_text(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    # The last line of an importer in Python names a place in its code; the line before has the error.
    lines = [line for line in lines if not line.startswith("Location:")]
    last = lines[-1] if lines else "without a reason"
    return last.removeprefix("Error: ").rpartition("': ")[2]
