"""Light and exposure of each image, and coats of paint of each vehicle of a position, which its shots share."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.assets.plan_assets import Assets
from hulldown.base.errors import ConfigError
from hulldown.base.indices import even_sample
from hulldown.camera.cameras import Cameras
from hulldown.camera.response import MAX_EV, gray_card_radiance, metered_exposures_ev
from hulldown.plan.coats import Coat
from hulldown.plan.config.asset_sections import OWN_COLOR, PaintEntry
from hulldown.plan.config.scene_sections import LightSection
from hulldown.plan.config.schema import Config
from hulldown.plan.lines import PlanFile
from hulldown.plan.row import Row, round_field
from hulldown.planning.search.random_streams import Purpose, RandomStreams, choose_weighted_indices, scale_uniform
from hulldown.planning.search.tables import MAX_ROLE_EXTRAS
from hulldown.scene.posed_scene import Scene
from hulldown.scene.rays import RayList
from hulldown.weather.kinds import WEATHER_KINDS, Weather

MAX_EXAMINED_IMAGES = 1000  # spread over the plan
RAY_COLUMNS, RAY_ROWS = 24, 16  # rays through an image
MAX_DOWNWARD_SINE = math.sin(math.radians(-1.0))  # a ray that points lower should meet ground
MIN_LAND_SHARE = 0.01  # in an image with less, the land doesn't count as visible
FIRST_COMPANION, FIRST_DISTRACTOR = 1, 1 + MAX_ROLE_EXTRAS  # in a row; the target's number is 0


def hdri_weights(light: LightSection, names: tuple[str, ...]) -> Float[np.ndarray, "2 h"]:
    """Return HDRIs' weights by the first match in `light.hdris`, and in rain and snow, when `light.overcast` counts."""
    for key, patterns in (("hdris", [choice.name for choice in light.hdris]), ("overcast", light.overcast)):
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise ConfigError(
                    f"light.{key}: {pattern!r} matches no HDRI",
                    remedy=f"assets.hdris gives {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}",
                )
    listed = [next((c.weight for c in light.hdris if fnmatchcase(name, c.name)), None) for name in names]
    usual = np.array([(0.0 if light.hdris else 1.0) if weight is None else weight for weight in listed])
    if not usual.any():
        raise ConfigError("light.hdris: all weights are 0", remedy="give at least one HDRI a weight above 0")
    if not light.overcast:
        return np.stack([usual, usual])
    cloudy = np.array([1.0 if weight is None else weight for weight in listed])
    cloudy[[not any(fnmatchcase(name, pattern) for pattern in light.overcast) for name in names]] = 0.0
    if not cloudy.any():
        raise ConfigError(
            "light.overcast: all weights are 0", remedy="give one of them a weight above 0 in light.hdris, or none"
        )
    return np.stack([usual, cloudy])


def sample_light_columns(
    light: LightSection,
    weathers: Sequence[Weather | None],
    weights: Float[np.ndarray, "2 h"],
    *,
    assets: Assets,
    draws: RandomStreams,
    image: Int[np.ndarray, " n"],
) -> dict[str, Sequence[object]]:
    """Draw light and exposure of images; the random numbers are independent of rotation and weather."""
    u = draws.uniform(Purpose.LIGHT, image, 0, count=3)
    errors = draws.uniform(Purpose.EXPOSURE, image, 0, count=2)
    overcast = np.array([weather is not None and WEATHER_KINDS[weather.kind].overcast for weather in weathers], dtype=np.int64)
    hdris = [assets.hdris[i] for i in choose_weighted_indices(weights[overcast], u[:, 0]).tolist()]
    skies = {name: assets.hdri_skylight(name) for name in set(hdris)}
    strength = round_field("strength", scale_uniform(*light.strength, u[:, 2]))
    if light.exposure == "auto":
        irradiance = np.array([skies[name].irradiance for name in hdris]).reshape(-1, 3)
        ev = metered_exposures_ev(gray_card_radiance(irradiance, strength[:, None]))
    else:
        ev = np.full(len(image), light.exposure)
    cut = {
        name: light.backdrop == "sky" or (light.backdrop == "auto" and (sky.shows_land or bool(sky.misfits)))
        for name, sky in skies.items()
    }
    numbers = {
        "hdri_yaw_deg": np.degrees(np.radians(scale_uniform(*light.yaw_deg, u[:, 1]))),
        "strength": strength,
        "exposure_ev": np.clip(ev + scale_uniform(*light.exposure_error_ev, errors[:, 0]), -MAX_EV, MAX_EV),
        "white_balance_k": scale_uniform(*light.white_balance_error_k, errors[:, 1]),
    }
    return {
        "hdri": hdris,
        "horizon_deg": [float(skies[name].horizon_deg) if cut[name] else None for name in hdris],
        **{key: round_field(key, values).tolist() for key, values in numbers.items()},
    }


def count_hdri_land_images(plan: PlanFile, assets: Assets) -> tuple[int, int]:
    """Return how many images show an HDRI's land in place of terrain, and how many were examined."""
    fallback_z = Config.of_plan(plan).ground.fallback_z
    chosen = even_sample(len(plan), MAX_EXAMINED_IMAGES).tolist()
    rows: dict[str, list[Row]] = defaultdict(list)
    for index in chosen:
        row = plan[index]
        if row.horizon_deg is None and assets.hdri_skylight(row.hdri).shows_land:
            rows[row.scenery].append(row)
    count = 0
    for scenery, of_scenery in rows.items():
        world = Scene.from_scenery(assets.sceneries[scenery], fallback_z=fallback_z)
        for row in of_scenery:
            camera = Cameras(row.intrinsics.with_size(RAY_COLUMNS, RAY_ROWS), row.world_from_camera)
            along = camera.rays(camera.lenses.pixel_centers)[1]
            down = along[along[:, 2] < MAX_DOWNWARD_SINE]
            missed = ~world.first_hits(RayList(np.tile(camera.position, (len(down), 1)), down)).hit
            count += int(missed.sum()) > MIN_LAND_SHARE * RAY_COLUMNS * RAY_ROWS
    return count, len(chosen)


def sample_coats(
    paint: Sequence[PaintEntry], draws: RandomStreams, *, position: Int[np.ndarray, " n"], place: ArrayLike
) -> list[list[Coat]]:
    """Draw a vehicle's coats at n positions; `place`: 0 (target), `FIRST_COMPANION` + k, or `FIRST_DISTRACTOR` + k."""
    n, kinds = len(position), len(paint)
    if not kinds:
        return [[] for _ in range(n)]
    sizes = np.array([len(entry.colors) for entry in paint])
    drawn = draws.uniform(Purpose.PAINT, position, place, count=kinds).reshape(n, kinds)
    choices = np.minimum((drawn * sizes).astype(np.int64), sizes - 1).tolist()
    return [[_make_coat(entry, choice) for entry, choice in zip(paint, row, strict=True)] for row in choices]


def _make_coat(entry: PaintEntry, choice: int) -> Coat:
    color = entry.colors[choice]
    return Coat(list(entry.materials), None if color == OWN_COLOR else color)
