"""What Cycles shows of a vehicle behind leaf cards whose texture is cut out, and behind the same leaves as geometry.

Started as a child, `python -P omissions_leaves_blender.py IN.npz OUT.npz`: reads meshes, cameras and sceneries, writes
a mask a camera. Unlike `render.blender.object_index`, which hides as much as the triangles do, leaves here are as
transparent as in a picture: one ray through each pixel's centre, through up to
`render.blender.cycles.TRANSPARENT_BOUNCES` holes.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import bpy
import numpy as np
from mathutils import Matrix

from reading.blender.frames import world_from_blender_camera
from render.blender import cycles
from render.blender.object_index import ONE_RAY, PIXEL_CENTRE


def main() -> None:
    given = np.load(sys.argv[1])
    os.dup2(2, 1)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _configure(scene, *given["size"].tolist(), float(given["fov_x"]))
    vehicle = _mesh("vehicle", given["vehicle_vertices"], given["vehicle_faces"], _glow("vehicle", 1.0))
    scene.collection.objects.link(bpy.data.objects.new("vehicle", vehicle))
    shown = {"alone": _masks(scene, given["world_from_camera"])}
    for number in range(int(given["sceneries"])):
        texture = given[f"texture_{number}"]
        atlas = bool(given[f"atlas_{number}"])
        materials = {"cards": _cut_out(f"cards {number}", texture, atlas=atlas), "leaves": _glow("leaves", 0.0)}
        for kind, material in materials.items():
            tree = _mesh(kind, given[f"{kind}_vertices_{number}"], given[f"{kind}_faces_{number}"], material)
            if kind == "cards":
                _map_corners(tree, given[f"uv_{number}"])
            if kind == "cards" and atlas:
                _save(tree, Path(sys.argv[2]).with_name(f"tree_{number}.blend"))
            copies = [bpy.data.objects.new("tree", tree) for _ in given[f"poses_{number}"]]
            for copy, pose in zip(copies, given[f"poses_{number}"], strict=True):
                copy.matrix_world = Matrix(pose.tolist())
                scene.collection.objects.link(copy)
            shown[f"{kind}_{number}"] = _masks(scene, given["world_from_camera"])
            for copy in copies:
                bpy.data.objects.remove(copy)
    np.savez(sys.argv[2], **shown)


def _configure(scene, width, height, fov_x):
    cycles.configure(scene, ONE_RAY, device="CPU")
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", PIXEL_CENTRE
    scene.world = bpy.data.worlds.new("dark")
    scene.world.node_tree.nodes.clear()
    scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.angle_x = "HORIZONTAL", fov_x
    scene.camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(scene.camera)


def _mesh(name, vertices, faces, material):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    mesh.materials.append(material)
    return mesh


def _map_corners(mesh, uv):
    layer = mesh.uv_layers.new(name="leaf")
    corner = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    layer.data.foreach_set("uv", uv[corner].astype(np.float32).ravel())


def _save(mesh, path):
    """A file with the mesh in it and nothing else."""
    scene = bpy.data.scenes.new("tree")
    scene.collection.objects.link(bpy.data.objects.new("tree", mesh))
    bpy.data.libraries.write(str(path), {scene})
    bpy.data.scenes.remove(scene)


def _glow(name, strength):
    material = bpy.data.materials.new(name)
    nodes = material.node_tree.nodes
    nodes.clear()
    glow, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    glow.inputs["Strength"].default_value = strength
    material.node_tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
    return material


def _cut_out(name, opaque, *, atlas):
    """Black where the texture is opaque, nothing where it is not; of an atlas it is the upper right quarter."""
    if atlas:
        opaque = np.block([[~opaque, opaque.T], [opaque[::-1], opaque]])
    material = _glow(name, 0.0)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    rows, columns = opaque.shape
    image = bpy.data.images.new(name, columns, rows)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.repeat(opaque.astype(np.float32).ravel(), 4))
    image.pack()
    leaf, through, mix = (
        nodes.new(kind) for kind in ("ShaderNodeTexImage", "ShaderNodeBsdfTransparent", "ShaderNodeMixShader")
    )
    leaf.image, leaf.interpolation = image, "Closest"
    if atlas:
        where, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
        mapping.inputs["Location"].default_value = (0.5, 0.5, 0.0)
        mapping.inputs["Scale"].default_value = (0.5, 0.5, 1.0)
        links.new(where.outputs["UV"], mapping.inputs["Vector"])
        links.new(mapping.outputs[0], leaf.inputs["Vector"])
    links.new(leaf.outputs["Color"], mix.inputs["Fac"])
    links.new(through.outputs[0], mix.inputs[1])
    links.new(nodes["Emission"].outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], nodes["Material Output"].inputs["Surface"])
    return material


def _masks(scene, world_from_camera):
    """(n, h, w): where each camera sees the vehicle."""
    found = []
    path = Path(sys.argv[2]).with_suffix(".exr")
    for pose in world_from_camera:
        scene.camera.matrix_world = Matrix(world_from_blender_camera(pose).tolist())
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(path))
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(image.size[0] * image.size[1] * image.channels, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        found.append(pixels.reshape(image.size[1], image.size[0], -1)[::-1, :, 0] > 0.5)
        bpy.data.images.remove(image)
    return np.array(found)


main()
