"""A stage saved as a file of its own, which shows the same picture in any Blender of the same version."""

from __future__ import annotations

import os
from typing import Any

import bpy


def strip_and_save_scene(scene: Any, path: str) -> None:
    """Save a scene with all data that it uses and nothing else; other data are removed from memory."""
    scene.render.filepath = "//"  # the folder of the file
    for window in bpy.context.window_manager.windows:
        window.scene = scene
    bpy.data.batch_remove([other for other in bpy.data.scenes if other != scene])
    bpy.data.orphans_purge(do_recursive=True)
    for image in bpy.data.images:
        image.filepath_raw = bpy.path.abspath(image.filepath, library=image.library)
    for block in list(bpy.data.user_map()):
        if block.library:  # a material of a library that the file links
            block.make_local()
    bpy.data.batch_remove(bpy.data.libraries)
    for image in bpy.data.images:
        if image.source in ("FILE", "TILED") and not image.packed_file and os.path.exists(image.filepath):
            image.pack()
            image.filepath_raw = f"//{os.path.basename(image.filepath)}"  # no path of this machine
    bpy.ops.wm.save_as_mainfile(filepath=path, compress=True, relative_remap=False)
