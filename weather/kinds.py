"""The weather of an image, and its kinds: one object each with all properties of the kind.

A new kind is an entry of `WEATHER_KINDS`, keys in `plan.config.scene_sections`, and a section of docs/weather.md; a
new way to cover surfaces is a function of `render.blender.covers` too. Needs numpy only, as it runs in Blender.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.camera.response import distance_from_daylight
from hulldown.weather.precipitation import Sizes, rain_sizes, snow_sizes

CONTRAST_THRESHOLD = 0.02  # of an object at the distance of the visibility; -ln 0.02 = 3.912
# The fog is a box around the camera.
FOG_REACH = 1.5  # visibilities from the camera to the side of the fog: 0.3 % of what is behind shows through
MAX_FOG_REACH_M = 2000.0  # what an HDRI shows on the horizon is seldom farther away
FOG_HEIGHT = 0.25  # visibilities above the camera: the sky overhead keeps 38 %, the horizon nothing
MAX_FOG_HEIGHT_M = 300.0  # haze of kilometers leaves the zenith blue
DUST_LAYERS = 2  # of equal extinction; their tops follow an exponential decay with height
# Of thick dust under an even white sky: (1 - s) (1 - 0.139 s) / (1 + 1.17 s), s^2 = (1 - w) / (1 - 0.7 w), where the
# single-scattering albedo w is 0.98 in red, 0.955 in green, 0.93 in blue.
DUSTY_AIR_ALBEDO = (0.56, 0.42, 0.34)
WARMEST_GRAY_FOG_K = 5000.0
FOG_COLOR_UV = (0.02, 0.05)  # CIE 1976 u'v' off daylight from which fog has some of the light's color, and all


def air_extinction(visibility_m: float) -> float:
    """Extinction in 1/m of air with this visibility in meters.

    H. Koschmieder, Theorie der horizontalen Sichtweite, Beitraege zur Physik der freien Atmosphaere 12, 1924.

    >>> round(air_extinction(1000.0), 6)
    0.003912
    """
    return -math.log(CONTRAST_THRESHOLD) / visibility_m


@dataclass(frozen=True, slots=True)
class Weather:
    """An image's weather: visibility, precipitation, wind, and covers."""

    visibility_m: float  # meteorological visibility in meters
    kind: str
    rain_mm_h: float = 0.0  # rate of the rain; 0 of other kinds
    wind_m_s: tuple[float, float] = (0.0, 0.0)  # wind velocity along the scenery's x and y, which slants rain and snow
    exposure_s: float = 0.004  # shutter time in seconds, which sets the length of streaks
    # ground_cover, vehicle_cover: wetness or cover by snow or dust of scenery and vehicles, 0 to 1
    ground_cover: float = 0.0
    vehicle_cover: float = 0.0

    def __post_init__(self) -> None:
        covers = (self.ground_cover, self.vehicle_cover)
        sound = 0.0 < self.visibility_m <= 1e9 and 0.0 <= self.rain_mm_h <= 1000.0 and 0.0 < self.exposure_s <= 10.0
        sound &= all(abs(speed) <= 100.0 for speed in self.wind_m_s) and all(0.0 <= cover <= 1.0 for cover in covers)
        if not sound or self.kind not in WEATHER_KINDS:
            raise ValueError(f"weather: expected one of {', '.join(WEATHER_KINDS)} with numbers in range, got {self}")


@dataclass(frozen=True, eq=False, slots=True)
class WeatherKind:
    """A kind of weather: its keys in the config's `[weather]`, of which its share's is its name, and its effects."""

    # visibility, rate: keys of the range of visibilities, or of the rates of rain that visibility and wetness follow
    # from
    visibility: str = ""
    rate: str = ""
    # keys of the covers of ground and vehicles; empty if there are none, or the rate decides
    covers: tuple[str, ...] = ()
    surfaces: str = ""  # name in `render.blender.surfaces.COVER_BUILDERS` of what covers them; empty: nothing does
    windy: bool = True  # whether wind and shutter time matter
    overcast: bool = False  # whether it comes with clouds that hide the sun
    layers: int = 1  # layers of air, of equal extinction; more than one thin out with height
    # color of endless air under a gray sky; None: gray too, but for the color of light that isn't daylight's
    tint: tuple[float, float, float] | None = (1.0, 1.0, 1.0)
    sizes: Callable[[Weather], Sizes] | None = None  # drops or flakes that fall in a weather; None: nothing falls
    # their radiance over that of the air: a drop shows most of the sky behind and above it (Garg and Nayar), less what
    # its surfaces reflect; a flake is lit by the sky and by the ground, which is half as bright
    share_of_sky: float = 0.0
    # albedo of what covers surfaces; None: they are wet, which darkens them
    cover_albedo: tuple[float, float, float] | None = None
    settles_above: bool = False  # whether it covers level surfaces more than steep ones in previews


WEATHER_KINDS: Mapping[str, WeatherKind] = MappingProxyType(
    {
        "fog": WeatherKind(visibility="visibility_m", windy=False, tint=None),
        "rain": WeatherKind(
            rate="rain_mm_h",
            surfaces="water",
            overcast=True,
            sizes=lambda weather: rain_sizes(weather.rain_mm_h),
            share_of_sky=0.94,
        ),
        "snow": WeatherKind(
            visibility="snow_visibility_m",
            covers=("snow_cover", "vehicle_snow_cover"),
            surfaces="snow",
            overcast=True,
            sizes=lambda weather: snow_sizes(air_extinction(weather.visibility_m)),
            share_of_sky=0.75,
            cover_albedo=(0.80, 0.83, 0.86),
            settles_above=True,
        ),
        "dust": WeatherKind(
            visibility="dust_visibility_m",
            covers=("dust_cover", "vehicle_dust_cover"),
            surfaces="dust",
            layers=DUST_LAYERS,
            tint=DUSTY_AIR_ALBEDO,
            cover_albedo=(0.36, 0.28, 0.19),
        ),
    }
)


class AirLayer(NamedTuple):
    """Air in a box around the camera."""

    extinction: float
    above: float  # above, reach: meters from the camera to its top, and to its sides and bottom
    reach: float


def air_layers(kind: str, visibility_m: float) -> list[AirLayer]:
    """Return nested layers of air with equal extinction, lowest first.

    Most kinds are one layer. Dust gets thinner by ``exp(-z / h)`` above the camera, where h is the height of a layer of
    fog: in steps, each as high as the mean of its part of the decay, so that as much of it is overhead. From the camera
    down it is whole, so that targets lose contrast as `air_extinction` says.
    """
    top, reach = min(FOG_HEIGHT * visibility_m, MAX_FOG_HEIGHT_M), min(FOG_REACH * visibility_m, MAX_FOG_REACH_M)
    tops, layers = [top], WEATHER_KINDS[kind].layers
    if layers > 1:
        parts = [part / layers for part in range(layers + 1)]
        areas = [part - part * math.log(part) if part else 0.0 for part in parts]  # integrals of -log
        tops = sorted(layers * top * (after - before) for before, after in itertools.pairwise(areas))
    return [AirLayer(air_extinction(visibility_m) / len(tops), above, reach) for above in tops]


def airlight_radiance(kind: str, sky: np.ndarray) -> np.ndarray:
    """Radiance (3,) of endless air under a sky that lights the ground as brightly as an even one of radiance `sky`.

    H. C. van de Hulst, Multiple Light Scattering, 1980: the reflectance of a thick cloud.
    O. Dubovik et al., Variability of absorption and optical properties of key aerosol types observed in worldwide
    locations, Journal of the Atmospheric Sciences 59, 2002: the albedo of desert dust.
    """
    tint, luminance = WEATHER_KINDS[kind].tint, np.dot(sky, LUMINANCE_WEIGHTS)
    if tint is not None:
        return luminance * np.array(tint)
    if luminance <= 0.0:
        return sky
    # Fog is white under a blue sky, since many scatterings mix all light, and orange in an evening's.
    low, high = FOG_COLOR_UV
    kept = np.clip((distance_from_daylight(sky, warmest=WARMEST_GRAY_FOG_K) - low) / (high - low), 0.0, 1.0)
    return np.asarray(luminance + kept * (sky - luminance))


def even_sky_radiance(sky: np.ndarray) -> np.ndarray:
    """Return the radiance (3,) of an even sky that lights level ground as `sky` does, whose first row is the zenith."""
    elevation = math.pi / 2 - (np.arange(len(sky)) + 0.5) / len(sky) * math.pi
    weight = np.clip(np.sin(elevation), 0.0, None) * np.cos(elevation)
    return np.asarray((sky.mean(axis=1) * weight[:, None]).sum(axis=0) / weight.sum())
