"""Rain and snow near the camera: drops and flakes in view, and the quads that draw their streaks.

Needs numpy only, as it runs in Blender too. Diameters are in meters, positions relative to the eye.

J. S. Marshall, W. McK. Palmer, The distribution of raindrops with size, Journal of Meteorology 5, 1948.
R. Gunn, G. D. Kinzer, The terminal velocity of fall for water droplets in stagnant air, Journal of Meteorology 6, 1949.
D. Atlas, R. C. Srivastava, R. S. Sekhon, Doppler radar characteristics of precipitation at vertical incidence, Reviews
of Geophysics 11, 1973.
J. D. Locatelli, P. V. Hobbs, Fall speeds and masses of solid precipitation particles, Journal of Geophysical Research
79, 1974.
K. Garg, S. K. Nayar, Vision and rain, International Journal of Computer Vision 75, 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hulldown.camera.intrinsics import Intrinsics

EXTINCTION_EFFICIENCY = 2.0  # drops and flakes are far larger than a wavelength of light
RAIN_DIAMETERS_MM = (0.3, 6.0)  # smaller drops are never seen, larger ones break up
SNOW_DIAMETERS_MM = (0.5, 8.0)
MEAN_FLAKE_MM = 1.5  # of the diameters' exponential distribution
DIAMETER_CLASSES = 100
FLUTTER_M_S = 0.2  # standard deviation of each component of a flake's own motion
NEAREST_M, FARTHEST_M = 0.4, 10.0  # from the camera; the veil alone contains farther drops
MIN_DROP_OPACITY = 0.01  # the veil alone contains fainter drops
MAX_DROPS = 40_000  # in an image; the faintest are left out
MAX_QUADS_PER_RAY = 0.15  # the mean over pixels: Cycles shades each quad, and the air before it
MIN_DISC_RADIUS_PX = 0.75  # of a drawn disc, so that a finer one fades instead of flickering

DROPS_STREAM = 0x57EA  # sets their draw apart from others by an image's seed


@dataclass(frozen=True, eq=False, slots=True)
class Sizes:
    """Size classes of drops or flakes, with number density and motion."""

    edges: np.ndarray  # the classes' bounds: diameters in meters
    number: np.ndarray  # in a cubic meter of air
    fall: np.ndarray
    flutter: float  # standard deviation of their own motion in each direction, m/s


@dataclass(frozen=True, eq=False, slots=True)
class PrecipitationView:
    """A camera's view and shutter time."""

    axes: np.ndarray  # scenery from camera; x right, y down, z forward
    half: tuple[float, float]  # tangents of half the horizontal and half the vertical field of view
    pixel: float  # width of a pixel at a distance of 1
    exposure_s: float  # shutter time in seconds


@dataclass(frozen=True, eq=False, slots=True)
class Drops:
    """Drops or flakes at the middle of the exposure."""

    centers: np.ndarray  # relative to the eye, along the scenery's axes, meters
    diameters: np.ndarray  # meters
    velocities: np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Streaks:
    """Quads that face the eye, each with a disc that moves along it while the shutter is open."""

    vertices: np.ndarray  # corners in turn, relative to the eye, meters
    # at each corner, in radii of the disc: the place across the motion and along it from the quad's center, and half of
    # the way that the disc goes
    profile: np.ndarray
    gain: np.ndarray  # factor on the opacity, of discs that are drawn wider than they are


def precipitation_view(world_from_camera: np.ndarray, intrinsics: Intrinsics, exposure_s: float) -> PrecipitationView:
    """Return a symmetric view that contains a camera's image, whose principal point may be off-center."""
    half = intrinsics.half_tangents
    pixel = 2.0 * half[0] / intrinsics.width if intrinsics.pinhole is None else 1.0 / intrinsics.pinhole[0]
    return PrecipitationView(world_from_camera[:3, :3], half, pixel, exposure_s)


def rain_sizes(rate_mm_h: float) -> Sizes:
    """Return drops: N(D) = 8000 exp(-4.1 R^-0.21 D) (Marshall and Palmer), falling as Gunn and Kinzer measured."""
    edges = np.linspace(*RAIN_DIAMETERS_MM, DIAMETER_CLASSES + 1)
    slope = 4.1 * max(rate_mm_h, 1e-9) ** -0.21
    number = -8000.0 / slope * np.diff(np.exp(-slope * edges))
    middle = (edges[1:] + edges[:-1]) / 2.0
    return Sizes(edges / 1000.0, number, 9.65 - 10.3 * np.exp(-0.6 * middle), 0.0)  # Atlas, Srivastava and Sekhon


def snow_sizes(extinction: float) -> Sizes:
    """Return flakes: as many as give the extinction, falling as Locatelli and Hobbs measured for aggregates."""
    edges = np.linspace(*SNOW_DIAMETERS_MM, DIAMETER_CLASSES + 1)
    middle = (edges[1:] + edges[:-1]) / 2.0
    share = -np.diff(np.exp(-edges / MEAN_FLAKE_MM))
    area = np.pi / 4.0 * (middle / 1000.0) ** 2
    number = share * extinction / (EXTINCTION_EFFICIENCY * share @ area)
    return Sizes(edges / 1000.0, number, 0.8 * middle**0.16, FLUTTER_M_S)


def sample_drops_in_view(sizes: Sizes, view: PrecipitationView, wind_m_s: tuple[float, float], *, seed: int) -> Drops:
    """Draw drops that are large enough in the image to be seen, uniform in the air in front of the camera."""
    rng = np.random.default_rng([seed, DROPS_STREAM])
    speed = np.hypot(sizes.fall, math.hypot(*wind_m_s))
    behind = float(speed.max()) * view.exposure_s / 2.0 / min(view.half)  # streaks reach into the image from outside
    reach = _size_class_reaches(sizes, speed, view, behind)
    count = rng.poisson(sizes.number * _view_pyramid_volumes(view, reach, behind))
    of = np.repeat(np.arange(len(count)), count)
    u = rng.random((len(of), 4))
    near, far = (NEAREST_M + behind) ** 3, (reach[of] + behind) ** 3
    depth = np.cbrt(near + u[:, 0] * (far - near))
    sides = (2.0 * u[:, 1:3] - 1.0) * depth[:, None] * np.array(view.half)
    centers = np.column_stack([sides, depth - behind]) @ view.axes.T
    velocities = rng.normal(size=(len(of), 3)) * sizes.flutter
    velocities += np.column_stack([np.full((len(of), 2), wind_m_s), -sizes.fall[of]])
    return Drops(centers, sizes.edges[of] + u[:, 3] * np.diff(sizes.edges)[of], velocities)


def _view_pyramid_volumes(view: PrecipitationView, reach: np.ndarray, behind: float) -> np.ndarray:
    """Return the volume of the view pyramid between the nearest and farthest drop; its apex is `behind` the eye."""
    return 4.0 / 3.0 * view.half[0] * view.half[1] * np.maximum((reach + behind) ** 3 - (NEAREST_M + behind) ** 3, 0.0)


def _size_class_reaches(sizes: Sizes, speed: np.ndarray, view: PrecipitationView, behind: float) -> np.ndarray:
    distances = np.geomspace(NEAREST_M, FARTHEST_M, 100)
    radius = (sizes.edges[1:] + sizes.edges[:-1])[:, None] / 2.0 / math.sqrt(2.0)
    wide = np.maximum(radius, MIN_DISC_RADIUS_PX * view.pixel * distances)
    way = np.maximum(speed[:, None] * view.exposure_s / 2.0 / wide, 1e-3)
    inside = np.minimum(way, 1.0)
    peak = (radius / wide) ** 2 * (inside - inside**3 / 3.0) / way  # falls with the distance
    for faintest in np.geomspace(MIN_DROP_OPACITY, 1.0, 40):
        seen = np.count_nonzero(peak >= faintest, axis=1)
        reach = distances[np.maximum(seen - 1, 0)]
        met = np.where(distances <= reach[:, None], 4.0 * wide**2 * (way + 1.0), 0.0)  # area of quads, by distance
        crowd = sizes.number @ (met[:, 1:] @ np.diff(distances))
        if sizes.number @ _view_pyramid_volumes(view, reach, behind) <= MAX_DROPS and crowd <= MAX_QUADS_PER_RAY:
            break
    return reach


def streak_quads(drops: Drops, view: PrecipitationView) -> Streaks:
    """Return the quads of drops.

    A drop hides each point of its streak while it passes, which is D / (D + length) of the time along the middle. The
    moving disc hides ``1 - r^2`` at `r` radii from its center. It hides as much in all as the drop and, as a streak,
    has its width at half of its darkness.
    """
    distance = np.linalg.norm(drops.centers, axis=1, keepdims=True)
    toward = drops.centers / distance
    across = np.cross(toward, drops.velocities)
    speed = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(speed > 1e-6, across / np.maximum(speed, 1e-6), np.cross(toward, view.axes[:, 1]))
    along = np.cross(across, toward)
    radius = drops.diameters[:, None] / math.sqrt(2.0)
    wide = np.maximum(radius, MIN_DISC_RADIUS_PX * view.pixel * distance)
    way = np.maximum(speed * view.exposure_s / 2.0 / wide, 1e-3)
    u = np.broadcast_to([-1.0, 1.0, 1.0, -1.0], (len(distance), 4))
    v = np.array([-1.0, -1.0, 1.0, 1.0]) * (way + 1.0)
    offset = u[..., None] * across[:, None] + v[..., None] * along[:, None]
    profile = np.stack([u, v, np.broadcast_to(way, u.shape)], axis=2)
    return Streaks(drops.centers[:, None] + wide[:, None] * offset, profile, ((radius / wide) ** 2)[:, 0])
