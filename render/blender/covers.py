"""Node groups for weather in materials: water (Lagarde, 2013), snow, or dust, by the node `SHARE_ATTRIBUTE`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy

from hulldown.blender.add_nodes import add_math_output, add_node, feed_input
from hulldown.weather.kinds import WEATHER_KINDS

SHARE_ATTRIBUTE = "hulldown share"
UP_NORMAL = (0.0, 0.0, 1.0)
UNDERSIDE_PROPERTY = "hulldown_above"  # of a vehicle's objects: x, y, z, 1 of the world to meters above its underside
# Lagarde: a surface soaks up water if it is rougher than 0.5 (perceptual roughness), fully from 0.9 on.
MIN_POROUS_ROUGHNESS, FULLY_POROUS_ROUGHNESS = 0.5, 0.9
WET_ALBEDO_SHARE = 0.6  # of the dry albedo where fully porous; his 0.2 turns soil twice as dark as measured
WET_ROUGHNESS_SHARE = 0.65  # of the dry roughness where fully porous
MAX_FULL_SNOW_DEG, MIN_BARE_SLOPE_DEG = 30.0, 60.0  # degrees of slope with the whole cover, and without any
FULL_DUST_HEIGHT_M, MAX_DUST_HEIGHT_M = 0.2, 1.2  # above a vehicle's underside
TOP_DUST_SHARE = 0.35  # of the dust on the lower parts; on scenery too
FILM_COAT, FILM_ROUGHNESS = 0.5, 0.12  # Cycles' coat reflects 4 % head-on, water 2 %; drops blur it
WATER_SPECULAR_SHARE = 0.5  # of the usual 4 % that a surface reflects head-on
PATCH_SIZES_M = (9.0, 1.4, 0.12)  # drifts, patches, and grass that sticks out of thin snow
PATCH_WEIGHTS = (0.6, 0.65, 0.45)  # their squares add up to 1
PATCH_EDGE_SHARE = 0.45  # of the noise, where half the ground is covered; at most 0.5
DUST_PATCH_M = 0.5
PATCH_NOISE = {"Detail": 5.0, "Roughness": 0.65}  # patches of all sizes: one size looks like camouflage
NOISE_MEAN, NOISE_SPREAD = 0.5, 0.0657  # measured
MAX_SHELTER_HEIGHT_M = 10.0  # higher things don't keep snow off
SKY_RAYS = 2
MIN_SKY_SHARE, FULL_SKY_SHARE = 0.0, 0.6  # of rays that reach the sky, for no snow and for all of it


class Group:
    """A node group under construction, with its inputs."""

    def __init__(self, name: str, inputs: dict[str, str], outputs: dict[str, str]) -> None:
        self.tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
        self.tree.use_fake_user = True  # keeps it from being purged with a vehicle in other weather
        for way, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
            for socket, kind in sockets.items():
                self.tree.interface.new_socket(socket, in_out=way, socket_type=f"NodeSocket{kind}")
        self.given = self.tree.nodes.new("NodeGroupInput").outputs
        self._end = self.tree.nodes.new("NodeGroupOutput")
        self.share = self.add("Value").outputs[0]
        self.share.node.name = SHARE_ATTRIBUTE
        self.share.default_value = 0.0

    def add(self, kind: str, inputs: dict[Any, Any] | None = None, /, **settings: Any) -> Any:
        """Return a node with inputs set to values or linked to sockets."""
        return add_node(self.tree, kind, inputs, **settings)

    def maths(self, operation: str, *values: Any, clamp: bool = False) -> Any:
        """Return one operation on numbers."""
        return add_math_output(self.tree, operation, *values, clamp=clamp)

    def dot_product_socket(self, a: Any, b: Any) -> Any:
        """Return the scalar product of two vectors."""
        return self.add("VectorMath", {0: a, 1: b}, operation="DOT_PRODUCT").outputs["Value"]

    def smooth_step_socket(self, value: Any, low: float, high: float) -> Any:
        """Return 0 at `low` to 1 at `high`, smoothly."""
        return self.add("MapRange", {0: value, 1: low, 2: high}, interpolation_type="SMOOTHSTEP").outputs[0]

    def even_noise_socket(self, where: Any, sizes: Sequence[float], weights: Sequence[float] = (1.0,)) -> Any:
        """Return noise in patches of several sizes, uniform in 0 to 1 within 0.02.

        `where`: position in meters.
        `sizes`, `weights`: meters of the patches, and the weight of each size; the squares of the weights add up to 1.
        """
        total: Any = NOISE_MEAN * (1.0 - sum(weights))
        for size, weight in zip(sizes, weights, strict=True):
            noise = self.add("TexNoise", {"Vector": where, "Scale": 1 / size, **PATCH_NOISE})
            total = self.maths("MULTIPLY_ADD", noise.outputs[0], weight, total)
        reach = 2.1 * NOISE_SPREAD  # of a smooth step that is nearly the normal distribution
        return self.smooth_step_socket(total, NOISE_MEAN - reach, NOISE_MEAN + reach)

    def finish_tree(self, **outputs: Any) -> Any:
        """Link the outputs, and return the finished tree."""
        for name, value in outputs.items():
            feed_input(self.tree, self._end.inputs[name.replace("_", " ")], value)
        return self.tree


def wetting_group(name: str, *, film: bool) -> Any:
    """Return a group before a principled shader's color, roughness, and coat; `film`: with a film of water on top."""
    floats = ("Roughness", "Specular IOR Level", "Coat Weight", "Coat Roughness")
    kinds = {"Base Color": "Color", **dict.fromkeys(floats, "Float")}
    g = Group(name, {**kinds, "Metallic": "Float"}, kinds)
    rough, shine = g.given["Roughness"], g.given["Specular IOR Level"]
    scale = 1 / (FULLY_POROUS_ROUGHNESS - MIN_POROUS_ROUGHNESS)
    soaks = g.maths("MULTIPLY_ADD", rough, scale, -MIN_POROUS_ROUGHNESS * scale, clamp=True)
    soaks = g.maths("MULTIPLY", soaks, g.maths("SUBTRACT", 1.0, g.given["Metallic"], clamp=True))
    soaked = g.maths("MULTIPLY", soaks, g.share)
    color = _scaled_vector_socket(g, g.given["Base Color"], g.maths("MULTIPLY_ADD", soaked, WET_ALBEDO_SHARE - 1, 1.0))
    rough = g.maths("MULTIPLY", rough, g.maths("MULTIPLY_ADD", soaked, WET_ROUGHNESS_SHARE - 1, 1.0))
    shine = g.maths("MULTIPLY", shine, g.maths("MULTIPLY_ADD", soaked, WATER_SPECULAR_SHARE - 1, 1.0))
    coat, blur = g.given["Coat Weight"], g.given["Coat Roughness"]
    if film:
        coat = g.maths("MAXIMUM", coat, g.maths("MULTIPLY", g.share, FILM_COAT))
        blur = g.maths("MAXIMUM", blur, g.maths("MULTIPLY", g.share, FILM_ROUGHNESS))
    return g.finish_tree(Base_Color=color, Roughness=rough, Specular_IOR_Level=shine, Coat_Weight=coat, Coat_Roughness=blur)


def soaking_group(name: str) -> Any:
    """Return a group before a diffuse shader's color; such a surface is fully porous."""
    g = Group(name, {"Color": "Color"}, {"Color": "Color"})
    return g.finish_tree(
        Color=_scaled_vector_socket(g, g.given["Color"], g.maths("MULTIPLY_ADD", g.share, WET_ALBEDO_SHARE - 1, 1.0))
    )


def _scaled_vector_socket(g: Group, vector: Any, factor: Any) -> Any:
    return g.add("VectorMath", {0: vector, "Scale": factor}, operation="SCALE").outputs[0]


def snow_group(name: str) -> Any:
    """Return a group for the output: white where it's level and, to camera rays, open to the sky."""
    g = _start_cover_group(name)
    seen = g.add("NewGeometry").outputs
    low, high = (math.cos(math.radians(slope)) for slope in (MIN_BARE_SLOPE_DEG, MAX_FULL_SNOW_DEG))
    lies = g.smooth_step_socket(g.dot_product_socket(seen["Normal"], UP_NORMAL), low, high)
    # A distance of 0 costs no ray: for surfaces that are too steep or not seen directly.
    camera = g.add("LightPath").outputs["Is Camera Ray"]
    wanted = g.maths("MULTIPLY", camera, g.maths("GREATER_THAN", lies, 0.0))
    reach = g.maths("MULTIPLY", wanted, MAX_SHELTER_HEIGHT_M)
    # About straight up, a slope would hide half of its own sky; about its normal, it would look for it in the ground.
    between = g.add("VectorMath", {0: g.add("VectorMath", {0: seen["Normal"], 1: UP_NORMAL}).outputs[0]}, operation="NORMALIZE")
    rays = {"Distance": reach, "Normal": between.outputs[0]}
    sky = g.add("AmbientOcclusion", rays, samples=SKY_RAYS).outputs["AO"]
    share = g.maths("MULTIPLY", g.maths("MULTIPLY", lies, g.share), g.smooth_step_socket(sky, MIN_SKY_SHARE, FULL_SKY_SHARE))
    patches = g.even_noise_socket(seen["Position"], PATCH_SIZES_M, PATCH_WEIGHTS)
    # Edges are narrower for small and large shares, so that the mean cover is the share.
    bare = g.maths("SUBTRACT", 1.0, share)
    edge = g.maths("MULTIPLY_ADD", g.maths("MULTIPLY", share, bare), 4 * PATCH_EDGE_SHARE, 1e-4)
    inside = g.maths("SUBTRACT", share, patches)
    covered = g.maths("ADD", g.maths("DIVIDE", inside, edge), 0.5, clamp=True)
    some = g.maths("GREATER_THAN", share, 0.0)
    return _finish_cover_tree(g, g.maths("MULTIPLY", covered, some), "snow")


def dust_group(name: str, *, climbs: bool) -> Any:
    """Return a group before the output: a thin brown film on level surfaces; near the ground too if it `climbs`."""
    g = _start_cover_group(name)
    seen = g.add("NewGeometry").outputs
    uneven = g.even_noise_socket(seen["Position"], (DUST_PATCH_M,))
    lies = g.maths("MULTIPLY", g.smooth_step_socket(g.dot_product_socket(seen["Normal"], UP_NORMAL), 0.5, 1.0), TOP_DUST_SHARE)
    if climbs:
        plane = g.add("Attribute", attribute_type="OBJECT", attribute_name=UNDERSIDE_PROPERTY).outputs
        height = g.maths("ADD", g.dot_product_socket(seen["Position"], plane["Vector"]), plane["Alpha"])
        ragged = g.maths("ADD", height, g.maths("MULTIPLY_ADD", uneven, 0.4, -0.2))
        low = g.maths("SUBTRACT", 1.0, g.smooth_step_socket(ragged, FULL_DUST_HEIGHT_M, MAX_DUST_HEIGHT_M))
        lies = g.maths("MAXIMUM", lies, low)
    thick = g.maths("MULTIPLY", lies, g.maths("MULTIPLY_ADD", uneven, 0.4, 0.6))
    return _finish_cover_tree(g, g.maths("MULTIPLY", thick, g.share), "dust")


def _start_cover_group(name: str) -> Group:
    return Group(name, {"Surface": "Shader", "Opacity": "Float"}, {"Surface": "Shader"})


def _finish_cover_tree(g: Group, share: Any, weather: str) -> Any:
    """Finish the cover of a kind of weather; holes in the surface stay holes."""
    albedo = WEATHER_KINDS[weather].cover_albedo
    assert albedo is not None
    matt = g.add("BsdfDiffuse", {"Color": (*albedo, 1.0)}).outputs[0]
    solid = g.maths("MULTIPLY", share, g.given["Opacity"])
    return g.finish_tree(Surface=g.add("MixShader", {0: solid, 1: g.given["Surface"], 2: matt}).outputs[0])
