"""Write sceneries with water, ground, skies, and what scatters objects, for test_water_files; run in Blender."""

import math
import sys
from pathlib import Path

import bpy
from mathutils import Matrix

from hulldown.blender.add_nodes import add_node
from hulldown.tests.builders.blend_parts import cuboid, fresh, instance, link, save
from hulldown.tests.builders.node_trees import material_of, principled

GRAY = (0.5, 0.5, 0.5)


def plane(name, size, at=(0, 0, 0), material=None, *, cells=1, wave=0.0):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=size, location=at)
    made = bpy.context.object
    made.name = name
    if material is not None:
        made.data.materials.append(material)
    for v in made.data.vertices:
        v.co.z = wave * math.sin(v.co.x / 9) * math.cos(v.co.y / 9)
    return made


def begin():
    fresh()
    for x in (-30, 0, 30):
        cuboid("Kiste", (2, 2, 2), (x, 20, 3))
    return plane("Plane", 160, cells=40, wave=3.0)


def named():
    """Water by name, and ground by its shape alone; what is scattered and what scatters are removed."""
    begin().name = "Plane.003"
    plane("Wasserfläche", 150, (0, 0, -1))
    pond = bpy.data.collections.new("kept")
    inner = plane("Teich", 12)
    bpy.context.scene.collection.objects.unlink(inner)
    link(inner, pond)
    for i in range(2):
        instance(f"spot{i}", pond, (40 * i, 40, 5 + i))
    oak = cuboid("Oak", (1, 1, 1), (200, 200, 0))
    oak.hide_render = True
    bed = plane("Bed of oaks", 30, (0, 0, 4), cells=3)
    bed.modifiers.new("p", "PARTICLE_SYSTEM")
    settings = bed.particle_systems[0].settings
    settings.type, settings.count, settings.use_advanced_hair = "HAIR", 5, True
    settings.render_type, settings.instance_object = "OBJECT", oak


def leafy(tree):
    clear, leaf = (add_node(tree, kind).outputs[0] for kind in ("BsdfTransparent", "BsdfPrincipled"))
    return add_node(tree, "MixShader", {1: clear, 2: leaf}).outputs[0]


def dressed():
    """Water by material."""
    begin()
    plane("Flat.001", 150, (0, 0, -1), principled("M1", GRAY, Transmission_Weight=1.0))
    glass = material_of("M2", lambda tree: add_node(tree, "BsdfGlass").outputs[0])
    sea = plane("Upright", 60, (0, 0, 2), glass)
    sea.data.transform(Matrix.Rotation(-math.pi / 2, 4, "X"))  # modeled upright, turned level
    sea.rotation_euler.x = math.pi / 2
    plane("Leaf mat", 30, (0, 0, 8), material_of("M4", leafy))
    murk = material_of("M5", lambda tree: add_node(tree, "VolumeAbsorption").outputs[0], socket="Volume")
    cuboid("Ocean", (40, 40, 16), (0, 0, -9), murk)
    cuboid("Mist", (90, 90, 90), (0, 0, 0), murk)


def worn():
    """A lake within the ground's mesh, a steep waterfall in that of another, and ground all of which wears water."""
    terrain = begin()
    terrain.name = "Terrain"
    terrain.modifiers.new("t", "TRIANGULATE")
    cliff = plane("North terrain", 40, (0, -60, 9), cells=4)
    for ground, water in ((terrain, "Lake water"), (cliff, "Falling water")):
        for name in ("Grass", water):
            ground.data.materials.append(principled(name, GRAY))
    for face in terrain.data.polygons:
        x, y, _ = face.center
        face.material_index = 7 if x > 20 and y > 0 else 0  # beyond the last slot, as the last is worn
    for vertex in cliff.data.vertices:
        vertex.co.z = 4 * vertex.co.x if vertex.co.x > 9 else 0
    for face in cliff.data.polygons:
        face.material_index = int(face.center.x > 9)


def sky():
    """Objects and meshes called like a sky, in a collection that is only instanced too."""
    fresh()
    kept = bpy.data.collections.new("kept")
    sizes = {"Skydome": 400, "Rock": 2, "Inner backdrop": 300, "Inner rock": 3, "Terrain_N": 100}
    for name, size in sizes.items():
        made = cuboid(name, (size, size, size), (0, 0, 0))
        made.data.name = "Skydome.001" if name == "Terrain_N" else name
        if name.startswith("Inner"):
            bpy.context.scene.collection.objects.unlink(made)
            link(made, kept)
    bpy.ops.curve.primitive_bezier_circle_add(radius=90)
    bpy.context.object.name, bpy.context.object.data.name = "Ring", "Sky ring"
    bpy.context.object.data.bevel_depth = 1.0
    instance("carrier", kept)


def main(folder):
    for make in (named, worn, sky, dressed):
        make()
        save(folder / f"{make.__name__}.blend")
    # KHR_materials_transmission; without the wide flat sheet of murk, which glTF cannot hold.
    for name in ("Ocean", "Mist", "Leaf mat"):
        bpy.data.objects.remove(bpy.data.objects[name])
    bpy.ops.export_scene.gltf(filepath=str(folder / "dressed.glb"), export_apply=True)


main(Path(sys.argv[1]))
