"""How bright a grey card on open land is: under a sky, and through the air that the renderer fills."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from jaxtyping import Float

from assets.skylight import SkyLight, even_sky
from camera.fog import FOG_ABOVE, FOG_REACH, FOG_SIDE, FOG_TOP, extinction
from camera.response import ALBEDO


def card_radiance(sky: SkyLight, *, yaw: float = 0.0, visibility_m: float | None = None) -> Float[np.ndarray, "3"]:
    """Radiance of a level grey card close to the camera, in linear Rec. 709.

    Parameters
    ----------
    sky
        What lights it.
    yaw
        Turn of the sky in radians, counter-clockwise seen from above; in clear air it changes nothing.
    visibility_m
        Of the air, if that is not clear: it takes from the light of each patch of the sky, and glows as the renderer's
        does (`render.blender.light.Fog`).
    """
    if visibility_m is None:
        return ALBEDO / math.pi * sky.clear
    east, north, up = sky.direction.T
    turned = np.stack([math.cos(yaw) * east - math.sin(yaw) * north, math.sin(yaw) * east + math.cos(yaw) * north, up])
    direct = clearness(turned.T, visibility_m) @ sky.irradiance
    even = _even()
    share = clearness(even.direction, visibility_m) @ even.irradiance[:, 0] / even.clear[0]
    return ALBEDO / math.pi * (direct + (1.0 - share) * sky.clear)


def clearness(along: Float[np.ndarray, "*n 3"], visibility_m: float) -> Float[np.ndarray, "*n"]:
    """Share of the light of a sky that reaches the camera from unit directions, through air around it."""
    reach, above = min(FOG_REACH * visibility_m, FOG_SIDE), min(FOG_ABOVE * visibility_m, FOG_TOP)
    x, y, z = np.moveaxis(along, -1, 0)
    with np.errstate(divide="ignore"):
        sides = np.stack([reach / np.abs(x), reach / np.abs(y), np.where(z > 0.0, above, reach) / np.abs(z)])
    return np.exp(-extinction(visibility_m) * sides.min(axis=0))


@cache
def _even() -> SkyLight:
    return even_sky()
