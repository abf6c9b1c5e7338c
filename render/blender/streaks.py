"""Streaks of rain and flakes of snow in the scene: one mesh of quads, replaced for each image."""

from __future__ import annotations

from functools import partial
from typing import Any

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_math_output, add_node
from hulldown.blender.frames import set_object_pose
from hulldown.render.blender.fog import set_hidden_in_render
from hulldown.render.blender.messages import CameraInput
from hulldown.weather.kinds import WEATHER_KINDS, Weather
from hulldown.weather.precipitation import Streaks, precipitation_view, sample_drops_in_view, streak_quads

STREAKS_NAME = "hulldown precipitation"


def falling_streaks(weather: Weather, camera: CameraInput, seed: int) -> Streaks | None:
    """Return the streaks in front of a camera; None in weather without rain or snow."""
    sizes_of = WEATHER_KINDS[weather.kind].sizes
    if sizes_of is None:
        return None
    pose = np.array(camera.world_from_camera)
    view = precipitation_view(pose, camera.intrinsics, weather.exposure_s)
    return streak_quads(sample_drops_in_view(sizes_of(weather), view, weather.wind_m_s, seed=seed), view)


class Precipitation:
    """Rain or snow near the camera, visible to the camera alone, without light or shadow."""

    def __init__(self, obj: Any) -> None:
        self._object = obj
        for rays in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
            setattr(obj, f"visible_{rays}", False)
        material = bpy.data.materials.new(STREAKS_NAME)
        material.cycles.emission_sampling = "NONE"  # otherwise they'd be thousands of lamps
        self._emission = _build_streak_material(material.node_tree)
        obj.data.materials.append(material)
        self.clear()

    def clear(self) -> None:
        """Remove all streaks."""
        set_hidden_in_render(self._object, True)

    def draw_streaks(self, streaks: Streaks, radiance: np.ndarray, eye: np.ndarray) -> None:
        """Draw streaks around the eye, in the scenery's frame."""
        mesh, count = self._object.data, len(streaks.gain)
        mesh.clear_geometry()
        mesh.vertices.add(4 * count)
        mesh.loops.add(4 * count)
        mesh.polygons.add(count)
        mesh.vertices.foreach_set("co", streaks.vertices.astype(np.float32).ravel())
        mesh.loops.foreach_set("vertex_index", np.arange(4 * count, dtype=np.int32))
        mesh.polygons.foreach_set("loop_start", np.arange(0, 4 * count, 4, dtype=np.int32))
        profile = mesh.attributes.new("profile", "FLOAT_VECTOR", "POINT")
        profile.data.foreach_set("vector", streaks.profile.astype(np.float32).ravel())
        gain = mesh.attributes.new("gain", "FLOAT", "POINT")
        gain.data.foreach_set("value", np.repeat(streaks.gain, 4).astype(np.float32))
        mesh.update(calc_edges=True)
        self._emission.inputs["Color"].default_value = (*radiance, 1.0)
        around = np.eye(4)
        around[:3, 3] = eye
        set_object_pose(self._object, around)
        set_hidden_in_render(self._object, False)


def _build_streak_material(tree: Any) -> Any:
    """Build the material: emission with the mean opacity of a moving disc, in closed form, times the gain."""
    tree.nodes.clear()
    math = partial(add_math_output, tree)
    profile = add_node(tree, "Attribute", attribute_name="profile").outputs["Vector"]
    gain = add_node(tree, "Attribute", attribute_name="gain").outputs["Fac"]
    u, v, way = add_node(tree, "SeparateXYZ", {0: profile}).outputs
    squared = math("MAXIMUM", math("SUBTRACT", 1.0, math("MULTIPLY", u, u)), 0.0)
    chord = math("SQRT", squared)
    first = math("MAXIMUM", math("SUBTRACT", v, way), math("MULTIPLY", chord, -1.0))
    last = math("MAXIMUM", math("MINIMUM", math("ADD", v, way), chord), first)
    cubes = math("SUBTRACT", math("POWER", last, 3.0), math("POWER", first, 3.0))
    hidden = math("MULTIPLY_ADD", cubes, -1.0 / 3.0, math("MULTIPLY", squared, math("SUBTRACT", last, first)))
    share = math("MULTIPLY", math("DIVIDE", hidden, math("MULTIPLY", way, 2.0)), gain)
    emission, clear = add_node(tree, "Emission"), add_node(tree, "BsdfTransparent")
    mix = add_node(tree, "MixShader", {0: share, 1: clear.outputs[0], 2: emission.outputs[0]})
    add_node(tree, "OutputMaterial", {"Surface": mix.outputs[0]})
    return emission
