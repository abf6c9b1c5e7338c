"""Visible air: fog by meteorological visibility."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node
from hulldown.blender.frames import set_object_pose
from hulldown.render.blender.hdri_light import HdriWorld
from hulldown.weather.kinds import air_layers


class Fog:
    """A flat box of air around the camera that absorbs light and emits the sky's.

    Koschmieder's law (`weather.kinds`): the radiance through `d` meters of air is
    ``radiance * exp(-extinction d) + airlight * (1 - exp(-extinction d))``. Absorption and emission have that closed
    form, so fog adds no noise; scattering, simulated, needs many bounces, turns the ground black when it gets few, and
    in a world volume hides the sky, which is infinitely far away.

    Only rays of the camera meet the box, which is as high as the lowest layer of air. Others would cost a quarter of a
    render, and the light has the rest of the air (`HdriWorld.dim_light`): what the fog takes from the sun comes back as
    airlight.
    """

    def __init__(self, obj: Any, world: HdriWorld) -> None:
        self._object, self._world = obj, world
        obj.visible_diffuse = obj.visible_glossy = obj.visible_transmission = obj.visible_shadow = False
        mesh = obj.data
        mesh.from_pydata(*_box_mesh_data())
        material = bpy.data.materials.new("hulldown fog")
        mesh.materials.append(material)
        tree = material.node_tree
        tree.nodes.clear()
        self._absorption = add_node(tree, "VolumeAbsorption", {"Color": (0.0, 0.0, 0.0, 1.0)})
        self._emission = add_node(tree, "Emission")
        both = add_node(tree, "AddShader", {0: self._absorption.outputs[0], 1: self._emission.outputs[0]})
        add_node(tree, "OutputMaterial", {"Volume": both.outputs[0]})
        self.clear()

    def clear(self) -> None:
        """Remove the fog."""
        set_hidden_in_render(self._object, True)
        self._world.dim_light([], 0.0, np.zeros(3))

    def fill_air(self, kind: str, visibility: float, glow: np.ndarray, camera: np.ndarray, *, below: float) -> None:
        """Fill the air about the camera down to surfaces `below` it, in meters, with endless air's radiance `glow`."""
        air = air_layers(kind, visibility)
        density = sum(layer.extinction for layer in air)
        self._absorption.inputs["Density"].default_value = density
        peak = float(glow.max())
        self._emission.inputs["Color"].default_value = (*(glow / max(peak, 1e-12)), 1.0)
        self._emission.inputs["Strength"].default_value = density * peak
        _, above, reach = air[0]
        box = np.diag([reach, reach, (reach + above) / 2, 1.0])
        box[:3, 3] = camera + np.array([0.0, 0.0, (above - reach) / 2])
        set_object_pose(self._object, box)
        set_hidden_in_render(self._object, False)
        self._world.dim_light(air, below, glow)


def set_hidden_in_render(obj: Any, hidden: bool) -> None:
    """Hide an object from renders, or show it."""
    if obj.hide_render != hidden:  # even setting the same value makes Blender rebuild its graph of all objects
        obj.hide_render = hidden


def _box_mesh_data() -> tuple[list[tuple[int, int, int]], list[Any], list[tuple[int, int, int, int]]]:
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, [], faces
