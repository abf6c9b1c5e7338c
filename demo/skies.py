"""Skies as HDRIs: Blender's own open-air ones copied, and physical ones with a crisp sun computed by Cycles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.files import atomic_writer, replace_file

SKY_WIDTH_PX = 2048  # around the horizon
SUN_DIAMETER_RADIANS = np.radians(1.1)  # twice the real sun's: six pixels, and half floats can hold its brightness


@dataclass(frozen=True)
class Sky:
    """Parameters of a computed sky."""

    sun_elevation_deg: float
    sun_share: float  # of the light that falls on level ground
    sun_color: tuple[float, float, float]
    haze: float  # aerosol density, 1 is clear
    clouds: tuple[float, float]  # noise levels between which blue gives way to cloud
    cloud_color: tuple[float, float, float]
    light: float  # radiance of a white sheet lying under this sky
    drift: float  # where in the endless pattern its clouds are


SKY_RECIPES = {
    "sky_noon": Sky(54.0, 0.80, (1.0, 0.96, 0.90), 1.2, (0.53, 0.68), (1.0, 1.0, 1.0), 2.0, 0.0),
    "sky_morning": Sky(26.0, 0.74, (1.0, 0.87, 0.70), 1.6, (0.50, 0.72), (1.0, 0.96, 0.90), 1.5, 7.0),
    "sky_evening": Sky(11.0, 0.60, (1.0, 0.70, 0.44), 2.0, (0.52, 0.70), (1.0, 0.84, 0.70), 1.0, 21.0),
    "sky_overcast": Sky(40.0, 0.0, (1.0, 1.0, 1.0), 3.0, (0.15, 0.38), (0.96, 0.98, 1.0), 1.1, 3.0),
}


def copy_studio_hdri(name: str, folder: Path) -> Path:
    """Copy one of the HDRIs of the Blender package to folder/<name>.exr."""
    source = Path(bpy.utils.resource_path("LOCAL")) / "datafiles" / "studiolights" / "world"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.exr"
    replace_file(path, (source / path.name).read_bytes())
    return path


def render_sky_hdri(name: str, folder: Path) -> Path:
    """Compute one of `SKY_RECIPES` and save it as folder/<name>.exr, equirectangular, in scene-linear radiance."""
    sky = SKY_RECIPES[name]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    world = scene.world = bpy.data.worlds.new(name)
    world.cycles.sampling_method = "NONE"  # it lights nothing here
    _build_sky_nodes(world.node_tree, sky)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type = "PANO"
    camera.data.panorama_type = "EQUIRECTANGULAR"
    camera.rotation_euler = (np.pi / 2, 0.0, -np.pi / 2)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 2, False, False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = (
        SKY_WIDTH_PX,
        SKY_WIDTH_PX // 2,
        100,
    )
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth, settings.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
    scene.view_settings.view_transform = "Raw"
    folder.mkdir(parents=True, exist_ok=True)
    raw, path = folder / f".{name}.raw.exr", folder / f"{name}.exr"
    scene.render.filepath = str(raw)
    bpy.ops.render.render(write_still=True)
    _add_sun_and_save_sky(raw, path, scene, sky)
    raw.unlink()
    return path


def _build_sky_nodes(tree: Any, sky: Sky) -> None:
    tree.nodes.clear()

    def node(kind: str, *inputs: Any, **settings: Any) -> Any:
        new = tree.nodes.new(f"ShaderNode{kind}")
        for key, value in settings.items():
            setattr(new, key, value)
        for socket, value in zip(new.inputs, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, socket)
            elif value is not None:
                socket.default_value = value
        return new.outputs

    def mix(factor: Any, a: Any, b: Any) -> Any:
        unused = (None,) * 4
        return node("Mix", factor, None, *unused, a, b, data_type="RGBA")[2]

    look = node("TexCoord")["Generated"]
    _, _, up = node("SeparateXYZ", look)
    physics: dict[str, object] = {"sky_type": "MULTIPLE_SCATTERING", "altitude": 150.0, "aerosol_density": sky.haze}
    angle = {"sun_elevation": np.radians(sky.sun_elevation_deg), "sun_rotation": np.pi / 2}
    above = node("CombineXYZ", *node("SeparateXYZ", look)[:2], node("Math", up, 0.0, operation="MAXIMUM")[0])[0]
    air = node("TexSky", above, sun_disc=False, **physics, **angle)[0]
    # Clouds lie on a plane, so they crowd toward the horizon.
    height = node("Math", node("Math", up, 0.0, operation="MAXIMUM")[0], 0.12, operation="ADD")[0]
    overhead = node("VectorMath", look, node("CombineXYZ", height, height, height)[0], operation="DIVIDE")[0]
    plane = node("VectorMath", overhead, (sky.drift, 0.0, 0.0), operation="ADD")[0]
    billow = node("TexNoise", plane, None, 0.9, 9.0, 0.56, 2.0, None, None, 0.35)[0]
    shape = node("MapRange", billow, *sky.clouds, interpolation_type="SMOOTHSTEP")[0]
    core = node("MapRange", node("TexNoise", plane, None, 2.3, 8.0, 0.6)[0], 0.3, 0.75, 1.15, 0.72)[0]
    bright = node("VectorMath", air, tuple(LUMINANCE_WEIGHTS), operation="DOT_PRODUCT")["Value"]
    zenith = 2.8 if sky.sun_share else 1.2  # clouds beside blue sky outshine it
    glow = node("Math", node("Math", bright, zenith, operation="MULTIPLY")[0], core, operation="MULTIPLY")[0]
    cloud = node("VectorMath", sky.cloud_color, node("CombineXYZ", glow, glow, glow)[0], operation="MULTIPLY")[0]
    high = node("MapRange", up, 0.0, 0.10 if sky.sun_share else 0.01, interpolation_type="SMOOTHSTEP")[0]
    heaven = mix(node("Math", shape, node("Math", high, 0.92, operation="MULTIPLY")[0], operation="MULTIPLY")[0], air, cloud)
    background = node("Background", heaven, 1.0)[0]
    node("OutputWorld", background)


def _add_sun_and_save_sky(raw: Path, path: Path, scene: Any, sky: Sky) -> None:
    """Add earth and sun; scale so that a white sheet under this sky has its `light`; store in half floats."""
    image = bpy.data.images.load(str(raw))
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    rows = pixels.reshape(height, width, -1)
    elevation = (np.arange(height) + 0.5) / height * np.pi - np.pi / 2  # the first row is the lowest
    weight = np.maximum(np.sin(elevation), 0) * np.cos(elevation) * (np.pi / height) * (2 * np.pi / width)
    irradiance = float((rows[..., :3].mean(axis=-1) * weight[:, None]).sum())
    rows[..., :3] *= (1 - sky.sun_share) * sky.light * np.pi / irradiance
    earth = np.array([0.23, 0.20, 0.15]) * sky.light
    depth = np.clip(-elevation / 0.04, 0, 1)[:, None, None]
    rows[..., :3] += (earth - rows[..., :3]) * depth
    rise = np.radians(sky.sun_elevation_deg)
    radiance = sky.sun_share * sky.light / np.sin(rise) / (SUN_DIAMETER_RADIANS / 2) ** 2
    rows[..., :3] += (
        radiance * np.array(sky.sun_color) / np.mean(sky.sun_color) * _sun_pixel_coverage(width, height, rise)[..., None]
    )
    image.pixels.foreach_set(np.minimum(rows, 60000.0).ravel())
    settings = scene.render.image_settings
    settings.color_depth, settings.exr_codec = "16", "DWAA"
    with atomic_writer(path) as file:
        image.save_render(file.name, scene=scene)


def _sun_pixel_coverage(width: int, height: int, rise: float) -> np.ndarray:
    """Return the (h, w) share of each pixel that the sun's disc covers, at half the width and the elevation `rise`."""
    fine = (np.arange(8) + 0.5) / 8
    elevation = ((np.arange(height)[:, None] + fine) / height).ravel() * np.pi - np.pi / 2
    azimuth = ((np.arange(width)[:, None] + fine) / width).ravel() * 2 * np.pi - np.pi
    share = np.zeros((height, width))
    tall = np.flatnonzero(np.abs(elevation - rise) < SUN_DIAMETER_RADIANS)
    wide = np.flatnonzero(np.abs(azimuth) < 2 * SUN_DIAMETER_RADIANS / np.cos(rise))
    low, left = tall[0] // 8 * 8, wide[0] // 8 * 8
    e, a = elevation[low : low + len(tall) // 8 * 8], azimuth[left : left + len(wide) // 8 * 8]
    cosine = np.sin(e)[:, None] * np.sin(rise) + np.cos(e)[:, None] * np.cos(rise) * np.cos(a)
    covered = (cosine > np.cos(SUN_DIAMETER_RADIANS / 2)).reshape(len(e) // 8, 8, len(a) // 8, 8).mean(axis=(1, 3))
    share[low // 8 : low // 8 + covered.shape[0], left // 8 : left // 8 + covered.shape[1]] = covered
    return share
