"""What `hulldown inspect` shows of a file: the report about it, and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageOps

from hulldown.annotate.drawing import label_font
from hulldown.assets.picture_files import read_pixels
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError
from hulldown.camera.response import CARD_ALBEDO, metered_exposures_ev
from hulldown.pictures.own_files import save_picture
from hulldown.pictures.sheets import contact_sheet
from hulldown.reading.hdri import Hdri
from hulldown.reading.pieces.asset_report import FileReport, SkyReport
from hulldown.reading.scenery.top_view import water_hit_mask
from hulldown.reading.vehicle.seen_colors import BACKGROUND_LEVEL
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.rays import Hits, RayList, SurfaceKind

# Colors that color-blind people tell apart: Okabe, Ito, Color universal design, 2008.
ROLE_COLORS = np.array([(0, 114, 178), (230, 159, 0), (213, 94, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233)], float)
OBSTACLE_COLOR = np.array([150.0, 150.0, 150.0])
MAX_FULL_SIZE_ASSETS = 12  # in one picture; more are drawn half as large
FRONT_LEFT = "from the front left"
# Name, direction of sight, direction that is up in the picture.
SHEET_VIEWS = (
    ("from the left", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    ("from the front", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    (FRONT_LEFT, (-1.0, -1.0, -0.7), (0.0, 0.0, 1.0)),
    ("from above, nose up", (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
)


@dataclass(frozen=True, eq=False, slots=True)
class Inspected:
    """The report and picture of an inspected file."""

    name: str  # name of the vehicle, scenery, or HDRI
    report: FileReport | SkyReport  # the report about its file
    picture: Image.Image | None = None  # a picture of it (see `draw_asset`); None if not requested, and of an HDRI


def sky_report(path: Path, hdri: Hdri) -> SkyReport:
    """Return the report about the HDRI in a file."""
    light = hdri.light
    ev = float(metered_exposures_ev(np.array([light.irradiance]) * (CARD_ALBEDO / np.pi))[0])
    doubts = (*hdri.misfit_doubts, *hdri.doubts)
    return SkyReport(str(path), light.irradiance, round(ev, 4), light.horizon_deg, hdri.notes, doubts)


def write_inspection_picture(inspected: Sequence[Inspected], path: Path) -> None:
    """Write the pictures side by side, each under its name, or one picture alone."""
    drawn = [(one.name, one.picture) for one in inspected if one.picture]
    sheet = drawn[0][1]
    if len(drawn) > 1:
        names, pictures = zip(*drawn, strict=True)
        columns = 3 if len(drawn) <= MAX_FULL_SIZE_ASSETS else 6
        sheet = contact_sheet(pictures, columns=columns, tile_width=3 * sheet.width // columns, captions=names)
    try:
        save_picture(sheet, path)
    except (OSError, ValueError) as error:
        raise AssetError(f"cannot be written ({error})", path=path, remedy="name a .png file in a folder") from None


def draw_asset(
    asset: VehicleShape | Scenery, picture: Path | None = None, differences: Path | None = None, *, size: int = 480
) -> Image.Image:
    """Return a vehicle or scenery shaded from four sides; parts, or ground and obstacles, in colors; pivots marked.

    `picture`, `differences`: of its export, to be shown among and below these.
    """
    if isinstance(asset, VehicleShape):
        world, bounds = (Scene(vehicles=[PosedVehicle(VehicleCaster(asset), np.eye(4)[None], {})]), asset.surface[0].bounds)
        colors = dict(zip(asset.part_names, ROLE_COLORS, strict=False))
    else:
        world = Scene.from_scenery(asset)
        bounds = _bounds_worth_seeing(asset, world.obstacles.bounds)
        ground = f"ground ({len(asset.ground_names)})" if asset.ground else "no ground"
        wet = int(asset.instance_is_water.sum())
        colors = {ground: ROLE_COLORS[3], f"obstacles ({len(asset.instance_names) - wet})": OBSTACLE_COLOR}
        colors |= {f"water ({wet})": ROLE_COLORS[5]} if wet else {}

    sheet = Image.new("RGB", (2 * size, 2 * size), (int(BACKGROUND_LEVEL),) * 3)
    for i, (title, sight, up) in enumerate(SHEET_VIEWS):
        at = (i % 2 * size, i // 2 * size)
        if title == FRONT_LEFT and picture is not None:
            tile = Image.fromarray(read_pixels(picture)).resize((size, size), Image.Resampling.BICUBIC)
            _draw_tile_title(tile, f"{title}, as rendered")
            sheet.paste(tile, at)
            continue
        view = _SheetView(np.array(sight), np.array(up), bounds, size)
        hits, light = view.hits_and_brightness(world)
        number = hits.part
        if isinstance(asset, Scenery):
            number = (hits.kind == SurfaceKind.OBSTACLE).astype(int) + water_hit_mask(asset, hits)
        shaded = np.array(list(colors.values()))[number] * light[:, None]
        image = np.where(hits.hit[:, None], shaded, BACKGROUND_LEVEL)
        tile = Image.fromarray(image.reshape(size, size, 3).astype(np.uint8))
        if isinstance(asset, VehicleShape):
            _mark_pivots(tile, view, asset)
        _draw_tile_title(tile, title if isinstance(asset, VehicleShape) else title.partition(",")[0])
        _draw_scale_bar(tile, view)
        sheet.paste(tile, at)
    pen, font = ImageDraw.Draw(sheet), label_font(14)
    for i, (name, color) in enumerate(colors.items()):
        pen.rectangle((10, 34 + 20 * i, 22, 46 + 20 * i), fill=tuple(int(c) for c in color))
        pen.text((28, 32 + 20 * i), name, fill=(0, 0, 0), font=font)
    if differences is not None:
        tile = Image.fromarray(read_pixels(differences))
        tile = tile.resize((2 * size, 2 * size * tile.height // tile.width), Image.Resampling.NEAREST)
        _draw_tile_title(tile, "the file in Blender, above what was read of it: orange is lost, blue is added")
        sheet = ImageOps.expand(sheet, (0, 0, 0, tile.height))
        sheet.paste(tile, (0, 2 * size))
    return sheet


def _bounds_worth_seeing(scenery: Scenery, boxes: Float[np.ndarray, "k 2 3"]) -> Float[np.ndarray, "2 3"]:
    """Return bounds of the ground and the objects on it without hills on the horizon; of everything without ground."""
    if scenery.ground is not None:
        low, high = scenery.ground.bounds
        middle = boxes.mean(axis=1)
        boxes = boxes[((middle >= low) & (middle <= high))[:, :2].all(axis=1)]
        # A hill on the horizon may have its middle here; pieces larger than the ground aren't on it.
        boxes = boxes[((boxes[:, 1] - boxes[:, 0]) <= high - low)[:, :2].all(axis=1)]
        boxes = np.concatenate([boxes, scenery.ground.bounds[None]])
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


class _SheetView:
    """An orthographic view of a box that fills a square picture."""

    def __init__(
        self, sight: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"], bounds: Float[np.ndarray, "2 3"], size: int
    ) -> None:
        self.size = size
        self.sight = sight / np.linalg.norm(sight)
        right = np.cross(self.sight, up)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.right, self.sight)
        self.middle = bounds.mean(axis=0)
        corners = np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        flat = (corners - self.middle) @ np.stack([self.right, self.up], axis=1)
        # Captions and legend need room above and below.
        self.scale = size / max(float(np.ptp(flat, axis=0).max()) * 1.25, 1e-9)  # pixels a meter
        self.depth = float(np.linalg.norm(bounds[1] - bounds[0]))

    def hits_and_brightness(self, world: Scene) -> tuple[Hits, Float[np.ndarray, " n"]]:
        """Return the hit of each pixel, and its brightness by the angle between surface and light."""
        center = (np.arange(self.size) + 0.5 - self.size / 2) / self.scale
        x, y = np.meshgrid(center, -center)
        start = self.middle + x[..., None] * self.right + y[..., None] * self.up - self.depth * self.sight
        origins = start.reshape(-1, 3)
        hits = world.first_hits(RayList(origins, np.broadcast_to(self.sight, origins.shape)))
        # From over the viewer's left shoulder, so that no side is dark.
        light = 0.6 * self.up - 0.6 * self.sight - 0.4 * self.right
        return hits, 0.35 + 0.65 * np.clip(np.nan_to_num(hits.normal) @ light / np.linalg.norm(light), 0.0, 1.0)

    def pixel(self, point: Float[np.ndarray, "3"]) -> tuple[float, float]:
        x, y = (point - self.middle) @ self.right, (point - self.middle) @ self.up
        return self.size / 2 + x * self.scale, self.size / 2 - y * self.scale


def _mark_pivots(tile: Image.Image, view: _SheetView, shape: VehicleShape) -> None:
    pen = ImageDraw.Draw(tile)
    reach = 0.15 * float(shape.size_xyz.max())
    for pivot, axis in zip(shape.part_pivot[1:], shape.part_axis[1:], strict=True):
        ends = [view.pixel(pivot + s * reach * axis) for s in (-1, 1)]
        x, y = view.pixel(pivot)
        pen.line(ends, fill=(0, 0, 0), width=1)
        pen.ellipse((x - 3, y - 3, x + 3, y + 3), fill=(255, 255, 255), outline=(0, 0, 0))


def _draw_tile_title(tile: Image.Image, title: str) -> None:
    ImageDraw.Draw(tile).text((10, 8), title, fill=(0, 0, 0), font=label_font(14))


def _draw_scale_bar(tile: Image.Image, view: _SheetView) -> None:
    pen, font = ImageDraw.Draw(tile), label_font(14)
    room = view.size / view.scale / 3
    bar = 10.0 ** np.floor(np.log10(room))
    bar *= next((f for f in (5.0, 2.0) if f * bar <= room), 1.0)
    low = view.size - 12
    pen.line((10, low, 10 + bar * view.scale, low), fill=(0, 0, 0), width=2)
    pen.text((10, low - 20), f"{bar:g} m", fill=(0, 0, 0), font=font)
