"""Light and air: an HDRI as lamp and backdrop, and fog by meteorological visibility.

Runs inside Blender; needs numpy and bpy only.

References
----------
H. Koschmieder, Theorie der horizontalen Sichtweite, Beitraege zur Physik der freien Atmosphaere 12, 1924.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

SKY_MAP = 1024  # columns of the map by which Cycles finds the bright parts of the sky: a texel is 0.35 degrees
CONTRAST_THRESHOLD = 0.02  # of an object at the distance of the visibility; -ln 0.02 = 3.912


def extinction(visibility: float) -> float:
    """Extinction in 1/m of air through which one sees `visibility` metres (Koschmieder)."""
    return -math.log(CONTRAST_THRESHOLD) / visibility


class HdriWorld:
    """A world of our own in place of the scenery's."""

    def __init__(self, scene: Any) -> None:
        world = bpy.data.worlds.new("hulldown")
        scene.world = world
        # Blender's automatic choice took 1 s an image for a 1k HDRI, since each turn of the sky builds the map anew;
        # measured, 1024 has the noise of 4096.
        world.cycles.sampling_method = "MANUAL"
        world.cycles.sample_map_resolution = SKY_MAP
        nodes, links = world.node_tree.nodes, world.node_tree.links
        nodes.clear()
        coordinates = nodes.new("ShaderNodeTexCoord")
        self._mapping = nodes.new("ShaderNodeMapping")
        self._texture = nodes.new("ShaderNodeTexEnvironment")
        self._background = nodes.new("ShaderNodeBackground")
        output = nodes.new("ShaderNodeOutputWorld")
        links.new(coordinates.outputs["Generated"], self._mapping.inputs["Vector"])
        links.new(self._mapping.outputs["Vector"], self._texture.inputs["Vector"])
        links.new(self._texture.outputs["Color"], self._background.inputs["Color"])
        links.new(self._background.outputs["Background"], output.inputs["Surface"])
        self._airlight: dict[str, np.ndarray] = {}
        self._path = ""

    def set(self, path: str, yaw: float, strength: float, file_from_scenery: np.ndarray) -> None:
        """Light with the HDRI in `path`, turned by `yaw` radians counter-clockwise seen from above."""
        if path != self._path:
            old, self._texture.image = self._texture.image, bpy.data.images.load(path)
            if old is not None:
                bpy.data.images.remove(old)
            self._path = path
        # The node turns the direction that is looked up, so the sky turns the other way.
        cos, sin = math.cos(-yaw), math.sin(-yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        axes = file_from_scenery[:3, :3] / np.linalg.norm(file_from_scenery[:3, :3], axis=0)
        self._mapping.inputs["Rotation"].default_value = euler_xyz(turn @ axes.T)
        self._background.inputs["Strength"].default_value = strength

    def airlight(self) -> np.ndarray:
        """Radiance (3,) of air that is lit by this sky: that of an even sky which lights the ground as brightly."""
        if self._path not in self._airlight:
            small = self._texture.image.copy()
            small.scale(256, 128)
            pixels = np.empty(256 * 128 * small.channels, dtype=np.float32)
            small.pixels.foreach_get(pixels)
            pixels = pixels.reshape(128, 256, small.channels)[..., :3].astype(np.float64)
            bpy.data.images.remove(small)
            elevation = (np.arange(128) + 0.5) / 128 * math.pi - math.pi / 2
            weight = np.clip(np.sin(elevation), 0, None) * np.cos(elevation)
            self._airlight[self._path] = (pixels.mean(axis=1) * weight[:, None]).sum(axis=0) / weight.sum()
        return self._airlight[self._path] * self._background.inputs["Strength"].default_value


class Fog:
    """A box of even air around the camera that dims what is behind it and glows with the sky's light."""

    def __init__(self, obj: Any) -> None:
        self._object = obj
        self.clear()

    def clear(self) -> None:
        """No fog."""
        self._object.hide_render = True

    def fill(self, visibility: float, airlight: np.ndarray, file_from_scenery: np.ndarray, camera: Any) -> None:
        """Fog of the visibility in metres, seen from the camera's pose."""
        raise NotImplementedError


def euler_xyz(rotation: np.ndarray) -> tuple[float, float, float]:
    """Blender's XYZ Euler angles of a rotation matrix: first about x, then y, then z."""
    y = math.asin(max(-1.0, min(1.0, -rotation[2, 0])))
    if abs(rotation[2, 0]) < 1 - 1e-9:
        return math.atan2(rotation[2, 1], rotation[2, 2]), y, math.atan2(rotation[1, 0], rotation[0, 0])
    return 0.0, y, math.atan2(-rotation[0, 1], rotation[1, 1])
