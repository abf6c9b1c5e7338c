"""Files, objects, and collections for the scripts that build test files; run in Blender."""

from __future__ import annotations

from pathlib import Path

import bpy


def fresh():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def save(path, **options):
    path = Path(path).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def gather():
    """Link all objects of the scene into one collection, as they are in tidy twins."""
    everything = collection("everything")
    for obj in list(bpy.context.scene.collection.objects):
        everything.objects.link(obj)


def link(obj, collection=None):
    (collection or bpy.context.scene.collection).objects.link(obj)
    return obj


def place(name, data, at=(0, 0, 0), parent=None, rot=(0, 0, 0), scale=(1, 1, 1), collection=None):
    """An object with this data."""
    obj = link(bpy.data.objects.new(name, data), collection)
    obj.location, obj.rotation_euler, obj.scale, obj.parent = at, rot, scale, parent
    return obj


def empty(name, *where, **more):
    return place(name, None, *where, **more)


def instance(name, shown, *where, **more):
    """An empty that shows a collection."""
    obj = empty(name, *where, **more)
    obj.instance_type, obj.instance_collection = "COLLECTION", shown
    return obj


def mesh(name, vertices, faces):
    made = bpy.data.meshes.new(name)
    made.from_pydata(vertices, [], faces)
    return made


def cube(name="Body"):
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    bpy.context.object.name = name
    return bpy.context.object


def cuboid(name, size, at, material=None, parent=None):
    """A scaled cube with texture coordinates; the parent stays where it is."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=at)
    obj = bpy.context.object
    obj.name, obj.scale = name, size
    if material is not None:
        obj.data.materials.append(material)
    if parent is not None:
        obj.parent, obj.matrix_parent_inverse = parent, parent.matrix_world.inverted()
    bpy.context.view_layer.update()
    return obj


def collection(name, parent=None):
    made = bpy.data.collections.new(name)
    (parent or bpy.context.scene.collection).children.link(made)
    return made


def from_library(path, kind, name, **options):
    """A datablock of another file, linked; `kind` is "objects", for example."""
    with bpy.data.libraries.load(str(path), link=True, **options) as (_, wanted):
        setattr(wanted, kind, [name])
    return getattr(wanted, kind)[0]
