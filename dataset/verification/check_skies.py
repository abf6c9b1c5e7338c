"""Check that the sky in rendered pictures is the recorded HDRI with the recorded yaw and strength."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, UInt8
from msgspec import Struct
from PIL import Image as Pictures
from scipy import ndimage

from hulldown.assets.coco_types import Coco
from hulldown.base.outside import typed
from hulldown.camera.backdrop import HIGH, even_color, fade
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera
from hulldown.camera.response import displayed, white_balance
from hulldown.camera.sensor import Sensor
from hulldown.camera.weather.kinds import Weather, air_layers, airlight, even_sky
from hulldown.dataset.images import Image
from hulldown.dataset.records import Finding
from hulldown.dataset.store.declared import Pose
from hulldown.dataset.store.reservations import Reservation, find_reservation, plan_key
from hulldown.planning.inputs.loading import Library
from hulldown.planning.plan_file import Plan
from hulldown.reading.hdri import sky_map
from hulldown.scene.posed_scene import Scene

WIDTH = 96  # pixels of the small picture that is compared
FEWEST = 40  # of its pixels must be sky
UNLIKE = 6.0  # of 255: another sky, turn or strength; see docs/dataset.md for what was measured
DOUBTFUL = 3.0  # of 255: wrong too, if another sky of the plan differs by less than half of that
_ERODED = 1  # pixels around other things, such as leaves and wires that rays miss
_SMOOTHED = 5  # pixels: a small map has no finer details


class _Shot(Struct):
    """Fields of a rendered image's record, as of `planning.plan.row.Row`."""

    scenery: str
    hdri: str
    world_from_camera: Pose
    hdri_yaw_deg: float
    strength: float
    horizon_deg: float | None
    exposure_ev: float
    white_balance_k: float
    weather: Weather | None
    sensor: Sensor | None = None


@dataclass(frozen=True, eq=False, slots=True)
class SkyCheck:
    """Compares the sky of a plan's pictures with a small render of the recorded HDRI."""

    worlds: Mapping[str, Scene]  # ground and obstacles of each scenery, by its name
    skies: Mapping[str, Float[np.ndarray, "_ _ 3"]]  # equirectangular map of each HDRI, by its name; see `radiance`
    reservation: Reservation  # the plan's images in the dataset

    def __call__(self, image: Image, pixels: UInt8[np.ndarray, "h w 3"]) -> Iterator[Finding]:
        """Find a problem with the sky of a picture."""
        try:
            shot = typed(image.record, _Shot)
        except ValueError:  # a record that was changed, which is found elsewhere
            return
        name, hdri, intrinsics = image.file_name, shot.hdri, image.intrinsics
        known = hdri in self.skies and shot.scenery in self.worlds
        if not self.reservation.owns(image.id, name) or not known or intrinsics is None:
            return
        height = max(1, round(WIDTH * image.height / image.width))
        along, sky, light = self._sky(shot, intrinsics.resized(WIDTH, height))
        seen = partial(
            radiance,
            along=along,
            yaw=math.radians(shot.hdri_yaw_deg),
            strength=shot.strength,
            weather=shot.weather,
            horizon_deg=shot.horizon_deg,
        )
        response = white_balance(shot.white_balance_k).T * 2.0**shot.exposure_ev
        sky = ndimage.binary_erosion(sky & ~_labeled(image, sky.shape), iterations=_ERODED, border_value=1)
        if np.count_nonzero(sky) < FEWEST:
            return
        resized = Pictures.fromarray(pixels).resize((WIDTH, height), Pictures.Resampling.BOX)
        small = np.asarray(resized, dtype=np.float64)

        def differs(candidate: str) -> float:
            return deviation(small, displayed((seen(self.skies[candidate]) * light) @ response), sky)

        figure = differs(hdri)
        if figure > UNLIKE:
            yield Finding(
                "error", name, f"its sky is not {hdri!r} as recorded: it differs by {figure:.1f} of 255", figure
            )
        elif figure > DOUBTFUL:
            others = {other: differs(other) for other in self.skies if other != hdri}
            nearest = min(others, key=others.__getitem__, default=None)
            if nearest is not None and others[nearest] < figure / 2.0:
                problem = f"its sky is {nearest!r}, recorded is {hdri!r}: it differs by {figure:.1f} of 255"
                yield Finding("error", name, problem, figure)

    def _sky(
        self, shot: _Shot, intrinsics: Intrinsics
    ) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], Float[np.ndarray, "h w 1"]]:
        """Return rays of the small picture: directions, which of them see sky, and transmittances."""
        width, height = intrinsics.width, intrinsics.height
        camera = Camera(intrinsics, np.array(shot.world_from_camera))
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        along = camera.ray_directions(np.stack([x.ravel(), y.ravel()], axis=1))
        sky = self.worlds[shot.scenery].sees_sky(camera)
        to_x, to_y = intrinsics.matrix[:2, 2]
        light = (shot.sensor or Sensor()).falloff(x - to_x, y - to_y, math.hypot(width, height) / 2.0)
        return along.reshape(height, width, 3), sky.reshape(height, width), light[..., None]


def sky_check(plan: Plan, coco: Coco, read: Callable[[], Library]) -> SkyCheck | None:
    """Return a check of a plan's images in a dataset; None if there are none."""
    reservation = find_reservation(coco, plan_key(plan.path))
    if reservation is None:
        return None
    library = read()
    used = {image.get("hdri") for image in coco["images"] if reservation.has_image(image["id"])}
    skies = {name: sky_map(hdri) for name, hdri in library.hdris.items() if name in used}
    sceneries = library.assets.sceneries
    worlds = {name: Scene.of(sceneries[name], fallback_z=plan.config.ground.fallback_z) for name in sceneries}
    return SkyCheck(worlds, skies, reservation)


def _labeled(image: Image, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return the boxes of all labels, in the small picture."""
    taken = np.zeros(shape, dtype=bool)
    for x, y, w, h in (label.bbox for label in image.labels):
        sides = np.array([x, y, x + w, y + h]).clip(0, max(image.size)) * WIDTH / image.width
        left, top, right, bottom = sides.tolist()
        taken[int(top) : math.ceil(bottom), int(left) : math.ceil(right)] = True
    return taken


def radiance(
    sky: Float[np.ndarray, "m k 3"],
    along: Float[np.ndarray, "*n 3"],
    *,
    yaw: float,
    strength: float,
    weather: Weather | None = None,
    horizon_deg: float | None = None,
) -> Float[np.ndarray, "*n 3"]:
    """Radiance of a sky along rays.

    `sky`: equirectangular map of radiance, the zenith in the first row, +x in the middle.
    `along`: unit directions in the scenery's frame.
    `yaw`: yaw of the sky in radians, counterclockwise seen from above.
    `strength`: factor on its radiance.
    `weather`: None: clear air.
    `horizon_deg`: elevation whose color continues below; None: the sky is unchanged. See `camera.backdrop`.
    """
    height, width = sky.shape[:2]
    x, y, z = np.moveaxis(along, -1, 0)
    column = (0.5 - (np.arctan2(y, x) - yaw) / (2.0 * np.pi)) * width
    elevation = np.arctan2(z, np.hypot(x, y))
    horizon = None if horizon_deg is None else math.radians(horizon_deg)
    if horizon is not None:
        elevation = np.maximum(elevation, horizon)
    row = (0.5 - elevation / np.pi) * height
    seen = sky[np.clip(row.astype(int), 0, height - 1), np.floor(column).astype(int) % width] * strength
    if horizon is not None and horizon > HIGH:
        low, high = fade(horizon)
        share = np.clip((high - z) / (high - low), 0.0, 1.0)[..., None]
        seen = (1.0 - share) * seen + share * even_color(sky, horizon) * strength
    if weather is None:
        return seen
    depth = np.zeros(along.shape[:-1])
    for layer in air_layers(weather.kind, weather.visibility_m):
        down = np.where(z > 0.0, layer.above, layer.reach)
        with np.errstate(divide="ignore"):
            sides = np.stack([layer.reach / np.abs(x), layer.reach / np.abs(y), down / np.abs(z)])
        depth += layer.extinction * sides.min(axis=0)
    clear = np.exp(-depth)[..., None]
    return clear * seen + (1.0 - clear) * airlight(weather.kind, even_sky(sky)) * strength


def deviation(
    picture: Float[np.ndarray, "h w 3"], expected: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]
) -> float:
    """Median difference from the expected sky over some pixels, in the largest channel, smoothed; of 255."""
    difference = (picture - expected) * where[..., None]
    share = ndimage.uniform_filter(where.astype(np.float64), _SMOOTHED)[where]
    smooth = ndimage.uniform_filter(difference, (_SMOOTHED, _SMOOTHED, 0))[where] / share[:, None]
    return float(np.median(np.abs(smooth).max(axis=1)))
