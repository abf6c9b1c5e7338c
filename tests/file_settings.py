"""Print the settings of a .blend that are still in force when it's rendered; run in Blender, prints JSON.

``python file_settings.py FOLDER`` compares a plain file with one in which every setting has another value, with key
frames where possible. The settings are those that Blender lists for a scene, its view layer, and the file.
"""

import contextlib
import json
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.reading.blender.opening import open_blend
from hulldown.render.blender import cycles
from hulldown.render.blender.scene import Stage
from hulldown.render.messages import CyclesSettings, SceneryInput

# Members of a scene that don't affect its picture: editing, display in a viewport, and other engines;
# its units and frame, which are part of its content; and what every datablock has.
NOT_OF_THE_PICTURE = {
    *("tool_settings", "cursor", "safe_areas", "display", "eevee", "hydra", "grease_pencil_settings", "unit_settings"),
    *("sequencer_colorspace_settings", "ffmpeg", "bake", "freestyle_settings", "annotation", "view_layer_eval"),
    *("frame_current", "frame_float", "frame_subframe", "frame_current_final", "filepath", "rna_type", "depsgraph"),
    *("layer_collection", "active_layer_collection", "collection", "rigidbody_world", "sequence_editor", "use_nodes"),
    # Playback, timeline, and physics, which a picture of one frame doesn't use.
    *("frame_start", "frame_end", "frame_step", "time_jump_unit", "time_jump_delta", "use_preview_range"),
    *("frame_preview_start", "frame_preview_end", "lock_frame_selection_to_range", "show_subframe", "sync_mode"),
    *("show_keys_from_selected_only", "use_custom_simulation_range", "simulation_frame_start", "simulation_frame_end"),
    *("gravity", "use_gravity", "use_audio", "use_audio_scrub", "audio_doppler_speed", "audio_doppler_factor"),
    *("audio_distance_model", "audio_volume", "use_stamp_note", "preview_pause", "preview_scrambling_distance"),
    # Curves that have an effect only with another setting, which is compared.
    *("curve_mapping", "motion_blur_shutter_curve", "linear_colorspace_settings"),
}
ID_PROPERTIES = {p.identifier for p in bpy.types.ID.bl_rna.properties}
SETTINGS = CyclesSettings(samples=4, denoise=False, adaptive_threshold=0.0, bounces=2)


def settings_of(struct, path, found, depth=0):
    """Every setting below `struct`: path to its owner, property, value."""
    skipped = NOT_OF_THE_PICTURE | (ID_PROPERTIES if depth == 0 and isinstance(struct, bpy.types.ID) else set())
    for prop in struct.bl_rna.properties:
        name = prop.identifier
        if name in skipped or prop.type == "COLLECTION" or (name == "name" and prop.type == "STRING"):
            continue
        value = getattr(struct, name)
        if prop.type == "POINTER" and value is not None and not isinstance(value, bpy.types.ID):
            if depth < 3:
                settings_of(value, f"{path}.{name}", found, depth + 1)
        elif prop.type == "POINTER":
            found.append((struct, prop, f"{path}.{name}", None if value is None else value.name))
        else:
            found.append((struct, prop, f"{path}.{name}", tuple(value) if getattr(prop, "is_array", False) else value))
    return found


def everything(scene):
    found = settings_of(scene, "scene", [])
    found += settings_of(scene.view_layers[0], "layer", [])
    return settings_of(bpy.data, "file", found)


def other(prop, value):
    """Other values that a property may have."""
    if prop.type == "BOOLEAN":
        return [not value]
    if prop.type == "ENUM":
        return [item.identifier for item in prop.enum_items if item.identifier != value]
    if prop.type == "STRING":
        return ["other"]
    if prop.type == "INT":
        return [value + 1, value - 1]
    return [value * 0.5 + 0.1, value * 0.5 - 0.1, value + 1.0]


def change(struct, prop, value):
    """Change a property and, where Blender allows it, add a key frame."""
    if prop.is_readonly or prop.type == "POINTER" or getattr(prop, "is_enum_flag", False):
        return False
    array = isinstance(value, tuple)
    for wanted in other(prop, value[0] if array else value):
        try:
            setattr(struct, prop.identifier, (wanted,) * len(value) if array else wanted)
            changed = getattr(struct, prop.identifier)
            if (tuple(changed) if array else changed) != value:
                with contextlib.suppress(TypeError):  # Blender refuses key frames for some animatable properties
                    struct.keyframe_insert(prop.identifier)
                return True
        except (TypeError, ValueError, AttributeError, RuntimeError):
            continue
    return False


def ready(path):
    """The settings of a file just before rendering, evaluated, as Cycles gets them."""
    stage = Stage(SceneryInput(str(path), np.eye(4).tolist(), [], []))
    cycles.configure(stage.scene, SETTINGS, device="CPU")
    graph = bpy.context.evaluated_depsgraph_get()
    graph.update()
    evaluated = {name: value for _, _, name, value in settings_of(graph.scene_eval, "scene", [])}
    return {name: value for _, _, name, value in everything(stage.scene)}, evaluated


def main(folder):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_plane_add()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "plain.blend"))
    scene = bpy.context.scene
    bpy.ops.wm.set_working_color_space(working_space="ACEScg", convert_colors=False)
    changed = [name for struct, prop, name, value in everything(scene) if change(struct, prop, value)]
    scene.view_layers[0].material_override = bpy.data.materials.new("override")
    scene.view_layers[0].world_override = bpy.data.worlds.new("override")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "changed.blend"))
    open_blend(str(folder / "changed.blend"))
    kept = len(bpy.data.scenes[0].objects)
    plain, changed_file = ready(folder / "plain.blend"), ready(folder / "changed.blend")
    left = {
        name: [str(before.get(name)), str(after.get(name))]
        for before, after in zip(plain, changed_file, strict=True)
        for name in {*before, *after}
        if before.get(name) != after.get(name)
    }
    print("@@" + json.dumps({"changed": changed, "left": left, "objects": kept}))


main(Path(sys.argv[1]))
