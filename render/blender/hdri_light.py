"""Light: an HDRI as lamp and backdrop, dimmed by the air of `render.blender.fog`."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_math_output, add_node
from hulldown.blender.buffers import image_pixels
from hulldown.camera.backdrop import HIGH_HORIZON_RADIANS, backdrop_color, backdrop_fade_sines
from hulldown.render.blender.messages import LightInput
from hulldown.weather.kinds import DUST_LAYERS, AirLayer, even_sky_radiance

MAX_LIFT_RADIANS = math.radians(89.0)  # what the camera sees is lifted by no more
SKY_MAP_COLUMNS = 1024  # Cycles finds the bright parts of the sky by this map; a texel is 0.35 degrees
MAX_KEPT_MAPS = 16  # each takes 0.8 MB
FINE_MAP_COLUMNS = 1024  # smaller HDRIs get twice their columns: with as many, the map overlooks flanks of small suns


class HdriWorld:
    """A world with an HDRI, in place of the scenery's world."""

    def __init__(self, scene: Any) -> None:
        world = bpy.data.worlds.new("hulldown")
        scene.world = world
        # Blender's automatic choice took 1 s an image for a 1k HDRI, since each turn of the sky builds the map anew.
        world.cycles.sampling_method = "MANUAL"
        self._world = world
        tree = self._tree = world.node_tree
        tree.nodes.clear()
        coordinates = add_node(tree, "TexCoord").outputs["Generated"]
        self._mapping = add_node(tree, "Mapping", {"Vector": coordinates})
        direction = self._mapping.outputs["Vector"]
        self._texture = add_node(tree, "TexEnvironment", {"Vector": direction})
        self._background = add_node(tree, "Background", {"Color": self._texture.outputs["Color"]})
        light = self._background.outputs["Background"]
        self._output = add_node(tree, "OutputWorld", {"Surface": light}).inputs["Surface"]
        self._lifted = _Lifted(tree, direction)
        self._veil = _Veil(tree, direction, self._texture.outputs["Color"])
        self._dimmed = _Dimmed(tree, direction, light)
        self._small: dict[str, np.ndarray] = {}
        self._colors: dict[str, str] = {}  # color space of each file
        self._path = ""

    def set(self, light: LightInput) -> None:
        """Light the scene with an HDRI; the camera sees one color below a high horizon (`camera.backdrop`)."""
        path, horizon = light.hdri, light.horizon
        if path != self._path:
            if not os.path.isfile(path):
                raise FileNotFoundError(path)
            if self._texture.image is None:
                self._texture.image = bpy.data.images.load(path)
            else:
                # A new image datablock would make Blender rebuild its graph of all objects.
                self._texture.image.filepath = path
                self._texture.image.colorspace_settings.name = self._color_space(path)  # reloading keeps the old one
                self._texture.image.reload()
                if self._texture.image.packed_file:
                    raise RuntimeError(f"{path}: Blender has packed this picture and would show no other")
            self._path = ""
            # Without pixels Cycles would light the scene with magenta.
            if 0 in self._texture.image.size:
                raise RuntimeError(f"{path}: Blender cannot read this picture")
            self._set_map_columns(sky_map_columns(self._texture.image.size[0]))
            self._path = path
        # The node turns the direction that is looked up, so the sky turns the other way.
        self._mapping.inputs["Rotation"].default_value = (0.0, 0.0, -light.yaw)
        self._background.inputs["Strength"].default_value = light.strength
        seen = self._mapping.outputs["Vector"] if horizon is None else self._lifted.lifted_direction_socket(horizon)
        self._link_if_changed(seen, self._texture.inputs["Vector"])
        color = self._texture.outputs["Color"]
        if horizon is not None and horizon > HIGH_HORIZON_RADIANS:
            color = self._veil.veiled_color_socket(
                min(horizon, MAX_LIFT_RADIANS), backdrop_color(self._radiance_map(), horizon)
            )
        self._link_if_changed(color, self._background.inputs["Color"])

    def _link_if_changed(self, output: Any, socket: Any) -> None:
        if socket.links[0].from_socket != output:  # new links make Cycles compile the sky anew
            self._tree.links.new(output, socket)

    def _color_space(self, path: str) -> str:
        if path not in self._colors:
            # It holds no pixels, and to remove it would cost what a new image in the graph does.
            self._colors[path] = bpy.data.images.load(path).colorspace_settings.name
        return self._colors[path]

    def _set_map_columns(self, columns: int) -> None:
        if self._world.cycles.sample_map_resolution != columns:
            self._world.cycles.sample_map_resolution = columns
            self._world.update_tag()  # or the first map's width stays, and a picture depends on those before it

    def sky_airlight_radiance(self) -> np.ndarray:
        """Return the radiance (3,) of air in this sky's light: an even sky that lights the ground as brightly."""
        return even_sky_radiance(self._radiance_map()) * self._background.inputs["Strength"].default_value

    def dim_light(self, air: Sequence[AirLayer], below: float, glow: np.ndarray) -> None:
        """Dim light by air of the radiance `glow`; the camera sees the sky through the air above the box of `Fog`."""
        light = self._dimmed.dimmed_light_socket(air, below, glow) if air else self._background.outputs["Background"]
        self._link_if_changed(light, self._output)

    def _radiance_map(self) -> np.ndarray:
        """Radiance (128, 256, 3) of the HDRI, the zenith in the first row."""
        if self._path not in self._small:
            small = self._texture.image.copy()
            small.scale(256, 128)
            radiance = image_pixels(small)[::-1, :, :3].astype(np.float64)
            small.buffers_free()  # the image stays, like that of `_color_space`
            if len(self._small) >= MAX_KEPT_MAPS:
                del self._small[next(iter(self._small))]
            self._small[self._path] = radiance
        return self._small[self._path]


def sky_map_columns(width: int) -> int:
    """Return columns of Cycles' importance map for an HDRI of `width` columns.

    A texel of the map is as bright as the HDRI at its center. If a sun is in the texel but not at its center,
    light is found by chance: pictures are too dark, with fireflies. For wider HDRIs, more than `SKY_MAP_COLUMNS` change
    nothing (measured) until the map takes too long to build for each image.
    """
    return 2 * width if width <= FINE_MAP_COLUMNS else SKY_MAP_COLUMNS


class _Veil:
    """Nodes that show the camera one color up to an elevation, and the HDRI from a little above."""

    def __init__(self, tree: Any, direction: Any, color: Any) -> None:
        z = add_node(tree, "SeparateXYZ", {0: direction}).outputs[2]
        self._share = add_node(tree, "MapRange", {0: z, "To Min": 1.0, "To Max": 0.0}, clamp=True)
        camera = add_node(tree, "LightPath").outputs["Is Camera Ray"]
        share = add_math_output(tree, "MULTIPLY", camera, self._share.outputs[0])
        self._mix = add_node(tree, "Mix", {0: share, 6: color}, data_type="RGBA")

    def veiled_color_socket(self, horizon: float, color: np.ndarray) -> Any:
        """Return the visible color: even below an elevation in radians, the HDRI above."""
        self._share.inputs["From Min"].default_value, self._share.inputs["From Max"].default_value = backdrop_fade_sines(
            horizon
        )
        self._mix.inputs[7].default_value = (*color, 1.0)
        return self._mix.outputs[2]


class _Lifted:
    """Nodes that lift directions of camera rays to an elevation; light is unchanged."""

    def __init__(self, tree: Any, direction: Any) -> None:
        x, y, z = add_node(tree, "SeparateXYZ", {0: direction}).outputs
        squared = add_math_output(tree, "ADD", add_math_output(tree, "MULTIPLY", x, x), add_math_output(tree, "MULTIPLY", y, y))
        flat = add_math_output(tree, "SQRT", squared)
        self._slope = add_node(tree, "Math", {0: flat}, operation="MULTIPLY")
        lifted = add_math_output(tree, "MAXIMUM", z, self._slope.outputs[0])
        camera = add_node(tree, "LightPath").outputs["Is Camera Ray"]
        seen = add_node(tree, "Mix", {0: camera, 2: z, 3: lifted}, data_type="FLOAT").outputs[0]
        self._lifted = add_node(tree, "CombineXYZ", {0: x, 1: y, 2: seen})

    def lifted_direction_socket(self, horizon: float) -> Any:
        self._slope.inputs[1].default_value = math.tan(min(horizon, MAX_LIFT_RADIANS))
        return self._lifted.outputs[0]


class _Dimmed:
    """Nodes that show a sky through air, by a ray's length in it; few, since every light ray evaluates them."""

    def __init__(self, tree: Any, direction: Any, light: Any) -> None:
        z = add_node(tree, "SeparateXYZ", {0: direction}).outputs[2]
        camera = add_node(tree, "LightPath").outputs["Is Camera Ray"]
        self._layers, depths = [], []
        for _ in range(DUST_LAYERS):
            overhead, steepness = (
                add_math_output(tree, "MULTIPLY_ADD", camera, 0.0, 0.0),
                add_math_output(tree, "MAXIMUM", z, 1.0),
            )
            self._layers.append((*overhead.node.inputs[1:], steepness.node.inputs[1]))
            depths.append(add_math_output(tree, "DIVIDE", overhead, steepness))
        share = add_math_output(tree, "EXPONENT", reduce(partial(add_math_output, tree, "ADD"), depths))
        self._glow = add_node(tree, "Background")
        self._mix = add_node(tree, "MixShader", {0: share, 1: self._glow.outputs[0], 2: light})

    def dimmed_light_socket(self, air: Sequence[AirLayer], below: float, glow: np.ndarray) -> Any:
        whole = sum(layer.extinction for layer in air)
        for number, (more, overhead, steepness) in enumerate(self._layers):
            layer = air[number] if number < len(air) else AirLayer(0.0, 0.0, 1.0)
            seen = layer.extinction * layer.above - (whole * layer.above if number == 0 else 0.0)  # less what Fog shows
            overhead.default_value = -layer.extinction * (layer.above + below)
            more.default_value = -seen - overhead.default_value
            steepness.default_value = layer.above / layer.reach
        self._glow.inputs["Color"].default_value = (*glow, 1.0)
        return self._mix.outputs[0]
