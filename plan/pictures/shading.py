"""Shade scenes by rays for previews: surfaces, a sun with shadows, a sky, and haze."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.base.color import linear_rgb_from_hex
from hulldown.camera.cameras import Cameras
from hulldown.plan.coats import Coat
from hulldown.scene.camera_pencils import PixelRays
from hulldown.scene.posed_scene import Scene
from hulldown.scene.ray_caster import coherent_index_blocks
from hulldown.scene.rays import RayList, SurfaceKind
from hulldown.weather.extinction import air_contrast
from hulldown.weather.kinds import WEATHER_KINDS, Weather, airlight_radiance

_ZENITH, _HORIZON = np.array([0.36, 0.55, 0.82]), np.array([0.78, 0.84, 0.92])
_EARTH, _LEAVES = np.array([0.52, 0.49, 0.36]), np.array([0.25, 0.36, 0.19])
_AMBIENT_SHARE = 0.45  # light from the whole sky; the rest is the sun's
_SUN_ELEVATION = math.radians(40.0)
_CHECKER_WIDTH_M = 5.0  # faint checkers on the ground show sizes


def shade_pixels(
    world: Scene,
    camera: Cameras,
    *,
    paints: Sequence[Float[np.ndarray, "3"]],
    sun: Float[np.ndarray, "3"],
    strength: float,
    weather: Weather | None,
) -> Float[np.ndarray, "n 3"]:
    """Return colors from 0 to 1 of a camera's n pixels, row by row, its vehicles in these paints."""
    along = camera.rays(camera.lenses.pixel_centers)[1]
    height = np.clip(along[:, 2], 0.0, 1.0)[:, None]
    color = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(height)
    hits = world.first_hits(PixelRays(camera))
    hit = np.flatnonzero(hits.hit)
    distance = hits.distance[hit, None]
    points = camera.position + distance * along[hit]
    # Faces without area have no normal, and stay dark.
    normal = np.nan_to_num(hits.normal[hit])
    direct = np.clip(normal @ sun, 0.0, None)
    if weather is not None and WEATHER_KINDS[weather.kind].overcast:
        direct *= 0.0  # clouds hide the sun
    lit = np.flatnonzero(direct > 0.0)
    # One shadow ray for what 2 x 2 pixels show of one object.
    row, column = np.divmod(hit[lit], camera.lenses.width)
    block = (row // 2 * camera.lenses.width + column // 2) * len(SurfaceKind) + hits.kind[hit[lit]]
    instance = hits.instance[hit[lit]]
    _, one, number = np.unique(block * (instance.max(initial=0) + 1) + instance, return_index=True, return_inverse=True)
    # Neighbors across the sun's rays are traced together.
    across = points[lit[one]] - (points[lit[one]] @ sun)[:, None] * sun
    order = np.concatenate([*coherent_index_blocks(across)])
    # Rays start off the surface by more than float32 errs at that distance.
    start = (points + normal * (1e-3 + 1e-4 * distance))[lit[one[order]]]
    shadowed = np.empty(len(one), dtype=bool)
    shadowed[order] = world.occlusion(RayList(start, np.broadcast_to(sun, start.shape)))
    direct[lit[shadowed[number]]] = 0.0
    light = _AMBIENT_SHARE * (0.7 + 0.3 * normal[:, 2]) + (1.0 - _AMBIENT_SHARE) * 1.3 * direct
    albedo = _surface_albedo(hits.kind[hit], hits.instance[hit], points, paints)
    if weather is not None:
        albedo = _covered_albedo(albedo, normal[:, 2], hits.kind[hit] == SurfaceKind.VEHICLE, weather)
    color[hit] = albedo * light[:, None]
    color *= strength
    if weather is not None:
        clear = air_contrast(weather.visibility_m, hits.distance)[:, None]
        color = clear * color + (1.0 - clear) * 0.9 * airlight_radiance(weather.kind, _HORIZON) * strength
    # Approximate gamma of displays.
    return np.clip(color, 0.0, 1.0) ** (1.0 / 1.6)


def _covered_albedo(
    albedo: Float[np.ndarray, "n 3"], up: Float[np.ndarray, " n"], vehicle: Bool[np.ndarray, " n"], weather: Weather
) -> Float[np.ndarray, "n 3"]:
    cover = np.where(vehicle, weather.vehicle_cover, weather.ground_cover)[:, None]
    kind = WEATHER_KINDS[weather.kind]
    if kind.cover_albedo is None:
        return albedo * (1.0 - 0.4 * cover)
    if kind.settles_above:
        cover = cover * np.clip(2.0 * up, 0.0, 1.0)[:, None]
    return albedo + cover * (np.array(kind.cover_albedo) - albedo)


def _surface_albedo(
    kind: UInt8[np.ndarray, " n"],
    instance: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "n 3"],
    paints: Sequence[Float[np.ndarray, "3"]],
) -> Float[np.ndarray, "n 3"]:
    odd = np.floor(points[:, :2] / _CHECKER_WIDTH_M).sum(axis=1) % 2.0
    albedo = _EARTH * (1.0 - 0.07 * odd)[:, None]
    albedo[kind == SurfaceKind.OBSTACLE] = _LEAVES
    for i, paint in enumerate(paints):
        albedo[(kind == SurfaceKind.VEHICLE) & (instance == i)] = paint
    return albedo


def preview_sun_direction(hdri: str, yaw_deg: float) -> Float[np.ndarray, "3"]:
    """Return a direction for the sun that differs between HDRIs and turns with them; the HDRI's sun is elsewhere."""
    azimuth = 2.0 * math.pi * _name_hash_share(hdri) + math.radians(yaw_deg)
    flat = math.cos(_SUN_ELEVATION)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(_SUN_ELEVATION)])


def preview_vehicle_color(vehicle: str, *, distractor: bool = False) -> Float[np.ndarray, "3"]:
    """Return a fixed color for a vehicle: from olive to sand, or from slate to plum for a distractor."""
    share = _name_hash_share(vehicle)
    if distractor:
        return (1.0 - share) * np.array([0.24, 0.34, 0.52]) + share * np.array([0.52, 0.30, 0.46])
    return (1.0 - share) * np.array([0.30, 0.36, 0.17]) + share * np.array([0.66, 0.52, 0.30])


def coat_or_own_color(own: Float[np.ndarray, "3"], coats: Sequence[Coat]) -> Float[np.ndarray, "3"]:
    """Return the linear color of a vehicle in a preview: its first coat's, or its own."""
    color = coats[0].color if coats else None
    return own if color is None else np.array(linear_rgb_from_hex(color))


def _name_hash_share(name: str) -> float:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") / 2**32
