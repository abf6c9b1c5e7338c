"""Check that the sky in rendered pictures is the recorded HDRI with the recorded yaw and strength."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera
from hulldown.camera.sensor import Sensor
from hulldown.camera.world import World
from hulldown.dataset.records import Finding
from hulldown.dataset.store.runs import Run, find_run, plan_key
from hulldown.dataset.verification.sky import deviation, inner, pictured, radiance
from hulldown.planning.loading import load_planned_library, planned_cache
from hulldown.planning.plan_file import Plan
from hulldown.reading.skies.hdri import sky_map

WIDTH = 96  # pixels of the small picture that is compared
FEWEST = 40  # of its pixels must be sky
UNLIKE = 6.0  # of 255: another sky, turn or strength; see docs/dataset.md for what was measured
DOUBTFUL = 3.0  # of 255: wrong too, if another sky of the plan differs by less than half of that


@dataclass(frozen=True, eq=False, slots=True)
class SkyCheck:
    """Compares the sky of a plan's pictures with a small render of the recorded HDRI.

    Parameters
    ----------
    worlds
        Ground and obstacles of each scenery, by its name.
    skies
        Equirectangular map of each HDRI, by its name; see `dataset.verification.sky.radiance`.
    run
        The plan's images in the dataset.
    """

    worlds: Mapping[str, World]
    skies: Mapping[str, Float[np.ndarray, "_ _ 3"]]
    run: Run

    def __call__(
        self, image: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], pixels: UInt8[np.ndarray, "h w 3"]
    ) -> Iterator[Finding]:
        """Find a problem with the sky of a picture."""
        name, hdri, scenery = (str(image.get(key)) for key in ("file_name", "hdri", "scenery"))
        if not self.run.owns(image["id"], name) or hdri not in self.skies or scenery not in self.worlds:
            return
        try:
            height = max(1, round(WIDTH * image["height"] / image["width"]))
            along, sky, light = self._sky(image, height)
            yaw, strength = math.radians(image["hdri_yaw_deg"]), float(image["strength"])
            weather = image["weather"]
            visibility_m = weather["visibility_m"] if weather else None
            kind = str(weather["kind"]) if weather else "fog"
            horizon_deg, exposure_ev = image["horizon_deg"], float(image["exposure_ev"])
            white_balance_k = float(image["white_balance_k"])
        except (KeyError, TypeError, ValueError):  # a record that was changed, which is found elsewhere
            return
        sky = inner(sky & ~_labeled(image, labels, sky.shape))
        if np.count_nonzero(sky) < FEWEST:
            return
        small = np.asarray(Image.fromarray(pixels).resize((WIDTH, height), Image.Resampling.BOX), dtype=np.float64)

        def differs(candidate: str) -> float:
            seen = radiance(
                self.skies[candidate],
                along,
                yaw=yaw,
                strength=strength,
                visibility_m=visibility_m,
                kind=kind,
                horizon_deg=horizon_deg,
            )
            expected = pictured(seen * light, exposure_ev=exposure_ev, white_balance_k=white_balance_k)
            return deviation(small, expected, sky)

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
        self, image: Mapping[str, Any], height: int
    ) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], Float[np.ndarray, "h w 1"]]:
        """Rays of the small picture: directions, which of them see sky, and transmittances."""
        intrinsics = Intrinsics.of_record(image).resized(WIDTH, height)
        camera = Camera(intrinsics, np.array(image["world_from_camera"], dtype=np.float64))
        x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(height) + 0.5)
        along = camera.ray_directions(np.stack([x.ravel(), y.ravel()], axis=1))
        met = self.worlds[image["scenery"]].occluded(np.broadcast_to(camera.position, along.shape), along)
        to_x, to_y = intrinsics.matrix[:2, 2]
        light = Sensor(**image.get("sensor") or {}).falloff(x - to_x, y - to_y, math.hypot(WIDTH, height) / 2.0)
        return along.reshape(height, WIDTH, 3), ~met.reshape(height, WIDTH), light[..., None]


def sky_check(plan: Plan, coco: Mapping[str, Any], *, cache: Path | None = None) -> SkyCheck | None:
    """A check of a plan's images in a dataset; None if there are none.

    Parameters
    ----------
    plan
        The plan.
    coco
        The dataset.
    cache
        The cache of the plan's assets; None: next to the plan.

    Raises
    ------
    HulldownError
        If its assets can't be read.
    """
    run = find_run(coco, plan_key(plan.path))
    if run is None:
        return None
    cache = cache or planned_cache(plan)
    library = load_planned_library(plan, cache=cache)
    used = {image.get("hdri") for image in coco["images"] if run.has_image(image["id"])}
    skies = {name: sky_map(hdri) for name, hdri in library.hdris.items() if name in used}
    sceneries = library.assets.sceneries
    worlds = {name: World.of(sceneries[name], fallback_z=plan.config.ground.fallback_z) for name in sceneries}
    return SkyCheck(worlds, skies, run)


def _labeled(
    image: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], shape: tuple[int, ...]
) -> Bool[np.ndarray, "h w"]:
    """The boxes of all labels, in the small picture."""
    taken = np.zeros(shape, dtype=bool)
    scale = WIDTH / image["width"]
    for label in labels:
        x, y, w, h = (scale * float(side) for side in label["bbox"])
        taken[max(0, int(y)) : math.ceil(y + h), max(0, int(x)) : math.ceil(x + w)] = True
    return taken
