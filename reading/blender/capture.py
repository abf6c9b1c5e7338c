"""The depsgraph of a render, with Cycles' meshes, from an engine that draws nothing: Blender has no other way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

OUR_CAMERA = "hulldown camera"


class _Capture(bpy.types.RenderEngine):
    bl_idname = "HULLDOWN_CAPTURE"
    bl_label = "hulldown capture"
    bl_use_preview = False

    visit: Callable[[Any], None] | None = None
    error: BaseException | None = None

    def render(self, depsgraph: Any) -> None:
        """Store exceptions, to be raised later: Blender, which calls this, prints them and continues."""
        try:
            if _Capture.visit:
                _Capture.visit(depsgraph)
        except BaseException as error:
            _Capture.error = error


def visit_render_depsgraph(scene: Any, visit: Callable[[Any], None]) -> None:
    """Call `visit` with the depsgraph of `scene`, as rendered at its frame by our camera, which lives for the call."""
    if not _Capture.is_registered:
        bpy.utils.register_class(_Capture)
    render = scene.render
    render.engine = _Capture.bl_idname
    render.resolution_x = render.resolution_y = render.resolution_percentage = 16
    render.use_compositing = render.use_sequencer = render.use_freestyle = render.use_multiview = False
    layers = list(scene.view_layers)
    chosen = next((layer for layer in layers if layer.use), layers[0])
    for layer in layers:
        layer.use = layer == chosen
    # Not the file's: a picture is taken by another, and what depends on it would be drawn differently.
    scene.camera = bpy.data.objects.new(OUR_CAMERA, bpy.data.cameras.new(OUR_CAMERA))
    scene.collection.objects.link(scene.camera)
    _Capture.visit, _Capture.error = visit, None
    try:
        bpy.ops.render.render(scene=scene.name)
        if _Capture.error:
            raise _Capture.error
    finally:
        _Capture.visit = _Capture.error = None
