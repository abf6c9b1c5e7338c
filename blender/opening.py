"""Open someone else's .blend so that it's drawn and does nothing else.

No script or simulation runs, no cache is written, and settings of Blender rather than of its own scene are reset.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import bpy
from bpy.app.handlers import persistent

WORKING_SPACE = "Linear Rec.709"  # the color space of HDRIs and of all colors in hulldown
IMPORT_NODES = ("GeometryNodeImportText", "GeometryNodeImportCSV")  # they draw files as shapes
UNKNOWN_NODE_TREE = "NodeTreeUndefined"
SIMULATION_MODIFIERS = ("FLUID", "DYNAMIC_PAINT")  # files and folders of these modifiers can't be forbidden


def open_blend(path: str, *, then: Callable[[], None] | None = None) -> list[str]:
    """Open the file at `path`; return a sentence for each part that is left out.

    Blender evaluates a file while it opens it, caches and fluids included. So the file is disarmed by a handler, which
    Blender calls when all is read and nothing is evaluated; right after it, `then` is called.
    """
    left_out: list[str] = []
    errors: list[Exception] = []

    @persistent
    def loaded(*_: object) -> None:
        try:
            _rename_undecodable_data()
            left_out.extend(disarm_file())
            if then:
                then()
        except Exception as error:  # Blender would print it and go on
            errors.append(error)

    handlers = bpy.app.handlers.load_post
    handlers.insert(0, loaded)
    try:
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    finally:
        handlers.remove(loaded)
    if errors:
        raise errors[0]
    reset_global_settings()
    _leave_editing_modes()
    return left_out


def _leave_editing_modes() -> None:
    """End edit mode and the like, in which a file was saved: such objects have no evaluated mesh."""
    objects = bpy.context.view_layer.objects
    for obj in [obj for obj in objects if obj.mode != "OBJECT"]:
        if obj.mode != "OBJECT":  # those edited together end together
            objects.active = obj
            bpy.ops.object.mode_set(mode="OBJECT")


def reset_global_settings() -> None:
    """Reset everything in `bpy.data` that applies to all of Blender and isn't the data itself."""
    # With it, Blender packs a picture when it is reloaded, and from then on shows that one, whatever its path.
    bpy.data.use_autopack = False
    space = getattr(bpy.data, "colorspace", None)
    if space is not None and space.working_space != WORKING_SPACE:
        bpy.ops.wm.set_working_color_space(convert_colors=True, working_space=WORKING_SPACE)


def disarm_file() -> list[str]:
    """Remove everything that writes or listens during evaluation; return a sentence for each removal.

    Call it after anything is read from a file, appended data too, and before evaluation.
    """
    left_out = []
    for obj in bpy.data.objects:
        for modifier in list(obj.modifiers):
            if modifier.type in SIMULATION_MODIFIERS or not all(
                _disable_disk_cache(cache) for cache in _modifier_point_caches(modifier)
            ):
                kind = modifier.type.lower().replace("_", " ")
                left_out.append(f"the {kind} of {obj.name!r} is left out, since its cache isn't in the file")
                obj.modifiers.remove(modifier)
    for tree in bpy.data.node_groups:
        if odd := [node for node in tree.nodes if node.bl_idname in IMPORT_NODES]:
            left_out.append(
                f"the text or table that the nodes {tree.name!r} import is left out, since it isn't a model or picture"
            )
            for node in odd:
                tree.nodes.remove(node)
    left_out += _replace_unknown_nodes()
    for scene in bpy.data.scenes:
        bodies = scene.rigidbody_world
        if bodies and bodies.point_cache and not _disable_disk_cache(bodies.point_cache):
            bodies.enabled = False
        scene.render.use_render_cache = False
        scene.render.use_compositing = scene.render.use_sequencer = False
        scene.compositing_node_group = None
        scene.sequence_editor_clear()
        scene.active_clip = None
    # They are in no picture, but are opened when their objects are evaluated.
    bpy.data.batch_remove([*bpy.data.sounds, *bpy.data.movieclips])
    return left_out


def _replace_unknown_nodes() -> list[str]:
    """Replace nodes of kinds that this Blender lacks: Cycles crashes with them."""
    left_out = []
    for material in list(bpy.data.materials):
        if material.node_tree and material.node_tree.bl_idname == UNKNOWN_NODE_TREE:
            name, new = material.name, bpy.data.materials.new(material.name)
            left_out.append(f"the nodes of the material {name!r} are left out, since this Blender doesn't know their kind")
            material.user_remap(new)
            bpy.data.materials.remove(material)
            new.name = name
    bpy.data.batch_remove([tree for tree in bpy.data.node_groups if tree.bl_idname == UNKNOWN_NODE_TREE])
    return left_out


def _modifier_point_caches(modifier: Any) -> Iterator[Any]:
    if modifier.type == "PARTICLE_SYSTEM":
        yield modifier.particle_system.point_cache
    elif modifier.type in ("CLOTH", "SOFT_BODY"):
        yield modifier.point_cache


def _disable_disk_cache(cache: Any) -> bool:
    """Stop a cache from writing files; return whether that worked. Baked caches are only read and stay."""
    if not cache.is_baked:
        every = cache.point_caches
        for flag in ("use_disk_cache", "use_external"):
            # Setting the property itself would move the cache, and delete files under its name.
            every.foreach_set(flag, [False] * len(every))
    return cache.is_baked or not cache.use_disk_cache


def _rename_undecodable_data() -> None:
    """Rename data whose names aren't UTF-8, which Python can't read, as in files before Blender 2.5."""
    for same in _named_collections():
        for number, block in enumerate(same):
            try:
                _ = block.name
            except UnicodeDecodeError:
                with contextlib.suppress(AttributeError):  # a slot has the name of its material, which has one by now
                    block.name = f"unnamed {number}"


def _named_collections() -> Iterator[Any]:
    yield from (getattr(bpy.data, p.identifier) for p in bpy.data.bl_rna.properties if p.type == "COLLECTION")
    for obj in bpy.data.objects:
        yield from (obj.modifiers, obj.particle_systems, obj.material_slots, obj.vertex_groups, obj.constraints)
    for blocks in (bpy.data.meshes, bpy.data.hair_curves, bpy.data.pointclouds):
        yield from (block.attributes for block in blocks)
    yield from (armature.bones for armature in bpy.data.armatures)
    yield from (scene.view_layers for scene in bpy.data.scenes)
