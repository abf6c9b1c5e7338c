"""Previews of a plan without Blender: one ray per pixel, shaded by normal and sun, with boxes."""

from __future__ import annotations

from collections.abc import Container, Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from hulldown.annotate.drawing import Overlay, picture_with_labels
from hulldown.assets.plan_assets import Assets
from hulldown.base.arguments import AnyPath, Count, PngFile
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.errors import ConfigError
from hulldown.base.indices import even_sample
from hulldown.base.terminal import track_items
from hulldown.camera.cameras import Cameras
from hulldown.camera.response import CARD_ALBEDO, gray_card_radiance
from hulldown.pictures.own_files import require_replaceable_picture, save_picture
from hulldown.pictures.sheets import contact_sheet
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_planned_library
from hulldown.plan.lines import PlanFile
from hulldown.plan.pictures.shading import coat_or_own_color, preview_sun_direction, preview_vehicle_color, shade_pixels
from hulldown.plan.row import Row
from hulldown.plan.row_scenes import RowScenes
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.scene.posed_scene import Scene
from hulldown.weather.kinds import Weather

TILE_WIDTH = 448  # a multiple of the tiles that rays are traced in
MAX_HEIGHT_RATIO = 4  # of a preview's height to its width


def write_preview_sheet(
    plan: AnyPath,
    output: PngFile | None = None,
    *,
    count: Count = 24,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    assets: Assets | None = None,
) -> Path:
    """Shade a plan without Blender.

    Reads a plan and the assets it names; writes a contact sheet of its images, with boxes.

    Parameters
    ----------
    plan
        The plan.
    output
        The picture; by default PLAN.preview.png, next to the plan.
    count
        Most images, evenly spread over the plan.
    cache
        Cache of assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.
    """
    rows = PlanFile.read(plan)
    path = rows.path.with_name(f"{rows.path.name}.preview.png") if output is None else Path(output)
    require_replaceable_picture(path)
    artist = Artist(rows, assets or load_planned_library(rows, cache=cache, limits=limits).assets)
    chosen = even_sample(len(rows), count).tolist()
    shaded = track_items("shading", chosen, len(chosen))
    save_picture(artist.draw_sheet(shaded, columns=4, tile_width=TILE_WIDTH), path)
    return path


def image_caption(row: Row) -> str:
    """Return the caption of an image: number, target, scenery, distance, and weather."""
    target = row.target
    distance = np.linalg.norm(row.world_from_camera[:3, 3] - target.world_from_vehicle[:3, 3])
    color = next((f", {coat.color}" for coat in target.paint if coat.color and not row.hides_target), "")
    return (
        f"{row.image_id}: {'nothing' if row.hides_target else target.vehicle}{color} "
        f"in {row.scenery}, {distance:.0f} m, "
        f"{'' if row.hides_target else f'{100 * target.visible_fraction:.0f} % visible, '}"
        f"{row.hdri}{_weather_words(row.weather)}"
    )


def _weather_words(weather: Weather | None) -> str:
    if weather is None:
        return ""
    rate = f"{weather.rain_mm_h:.0f} mm/h, " if weather.kind == "rain" else ""
    return f", {weather.kind} {rate}{weather.visibility_m:.0f} m"


class Artist:
    """Draws rows of a plan with its assets."""

    def __init__(self, plan: PlanFile, assets: Assets) -> None:
        self._plan, self._assets = plan, assets
        self.shapes = {**assets.vehicles, **assets.distractors}
        self._scenes = RowScenes(self.shapes, assets.sceneries, fallback_z=Config.of_plan(plan).ground.fallback_z)
        self.class_ids = {name: i + 1 for i, name in enumerate(plan.header.categories)}

    def draw_sheet(self, indices: Iterable[int], *, columns: int, tile_width: int) -> Image.Image:
        """Return a contact sheet with `columns` images in a row."""
        pictures, captions = [], []
        for index in indices:
            row = self._plan[index]
            pictures.append(self.picture(row, width=tile_width))
            captions.append(image_caption(row))
        return contact_sheet(pictures, columns=columns, tile_width=tile_width, captions=captions)

    def picture(self, row: Row, *, width: int = TILE_WIDTH, labels: bool = True) -> Image.Image:
        """Return a picture of a row at this width, with the boxes and classes of its labels if `labels`."""
        # Very tall images become narrower: a row may have 1 x 65536 pixels.
        scale = min(width / row.width, MAX_HEIGHT_RATIO * width / row.height)
        width, height = max(1, round(row.width * scale)), max(1, round(row.height * scale))
        image = Image.fromarray((255.0 * self.shade(row, width, height)).round().astype(np.uint8))
        if not labels:
            return image
        boxes = [
            Overlay(
                scale * np.array(vehicle.bbox),
                self.class_ids[vehicle.category],
                vehicle.category,
                ignored=vehicle.label == "ignored",
            )
            for vehicle in row.labeled
            if vehicle.bbox is not None and vehicle.category is not None
        ]
        return picture_with_labels(image, boxes)

    def scene(self, row: Row) -> Scene:
        """Return a row's scenery with its vehicles."""
        named: list[tuple[str, str, Container[str]]] = [("scenery", row.scenery, self._assets.sceneries)]
        named += [("vehicle", vehicle.vehicle, self.shapes) for vehicle in row.vehicles]
        named += [("class", vehicle.category, self.class_ids) for vehicle in row.vehicles if vehicle.category]
        parts = [(v, name) for v in row.vehicles if v.vehicle in self.shapes for name in v.articulation]
        named += [("part", name, self.shapes[v.vehicle].part_names[1:]) for v, name in parts]
        for kind, name, allowed in named:
            if name not in allowed:
                raise ConfigError(
                    f"image {row.index}: {kind} {name!r:.60} is not known to the plan",
                    path=self._plan.path,
                    remedy="plan again with `hulldown plan`",
                )
        return self._scenes.scene(row)

    def shade(self, row: Row, width: int, height: int) -> Float[np.ndarray, "h w 3"]:
        """Return colors from 0 to 1, without boxes."""
        camera = Cameras(row.intrinsics.with_size(width, height), row.world_from_camera)
        colors = shade_pixels(
            self.scene(row),
            camera,
            paints=[
                coat_or_own_color(preview_vehicle_color(v.vehicle, distractor=v.vehicle in self._assets.distractors), v.paint)
                for v in row.vehicles
            ],
            sun=preview_sun_direction(row.hdri, row.hdri_yaw_deg),
            strength=self._card_brightness(row),
            weather=row.weather,
        )
        return colors.reshape(height, width, 3)

    def _card_brightness(self, row: Row) -> float:
        irradiance = np.array(self._assets.hdri_skylight(row.hdri).irradiance)
        return float(gray_card_radiance(irradiance, row.strength) @ LUMINANCE_WEIGHTS) / CARD_ALBEDO * 2.0**row.exposure_ev
