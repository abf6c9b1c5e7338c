"""What a picture by Cycles must show of its row: the planned sky, and steps along the outlines of its vehicles.

`assert_shows_plan` checks each dataset that a test renders, so a new Blender with another sky, another pose, or other
colors doesn't pass unseen. Skies are compared with `NAME.npy` beside each `NAME.exr`: the radiance that was written.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from hulldown.camera.backdrop import HIGH_HORIZON_RADIANS, backdrop_color, backdrop_fade_sines
from hulldown.camera.response import display_levels, white_balance_matrix
from hulldown.dataset.row_records import Segmenter
from hulldown.dataset.store.document import read_coco
from hulldown.dataset.store.reservations import find_reservation, plan_file_key
from hulldown.plan.row_scenes import RowScenes
from hulldown.scene.rays import RayList
from hulldown.tests.builders.blender_plans import pixels
from hulldown.weather.kinds import air_layers, airlight_radiance, even_sky_radiance

MIN_SKY_PX = 40
MAX_SKY_DIFFERENCE = 6.0  # of 255: median; sound pictures had 4.9 at most
MIN_MASK_PX = 30
MIN_OUTLINE_STEP = 0.8  # of the best outline: 495 sound pictures had 1.57 or more, those of another row 0.8 in a third
SHIFTS = (0.25, 0.5, 0.8, 1.2)  # of a mask's extent: how far its outline is moved to compare it
DIRECTIONS, SECTORS = 16, 12  # in which it is moved; about a mask's center, in which steps are averaged
MIN_COPY_SHARE, MIN_COPIES = 0.3, 8  # a moved outline must be this far visible, and so many must be
_MIXED = np.array([[3, 1, 0], [1, 2, 1], [0, 1, 3]]) / 8  # of red, green, and blue


def assert_shows_plan(folder, plan, library):
    """Check the pictures of a plan in a dataset."""
    coco = read_coco(folder)
    reservation = find_reservation(coco, plan_file_key(plan.path))
    names = {image["id"]: image["file_name"] for image in coco["images"]}
    rows = {row.file_name: row for n, row in enumerate(plan, start=reservation.image_offset + 1) if n in names}
    assert rows
    for name, row in rows.items():
        assert_shows_row(pixels(folder / reservation.dataset_file_name(name)), row, library)


def assert_shows_row(picture, row, library):
    """Check a picture (h, w, 3) of a row."""
    radiance = np.load(library.hdris[row.hdri].path.with_suffix(".npy"))
    scene = RowScenes(library.shapes, library.assets.sceneries).scene(row)
    difference = sky_difference(picture, row, scene, radiance[..., None].repeat(3, axis=2))
    assert not difference > MAX_SKY_DIFFERENCE, f"{row.file_name} has another sky than {row.hdri}"
    segmenter = Segmenter(library.shapes, library.assets.sceneries)
    steps = outline_steps(picture, [segmenter.mask(row, vehicle) for vehicle in row.vehicles if vehicle.bbox])
    assert not (np.array(steps) < MIN_OUTLINE_STEP).any(), f"{row.file_name} shows no vehicle at an outline: {steps}"


def sky_difference(picture, row, scene, sky):
    """Median difference of a picture's sky from the planned one, smoothed, of 255; nan without a sky."""
    camera = row.camera
    along = camera.rays(camera.lenses.pixel_centers)[1]
    free = ~scene.occlusion(RayList(np.broadcast_to(camera.position, along.shape), along)).reshape(picture.shape[:2])
    free = ndimage.binary_erosion(free, border_value=1)  # leaves and wires that rays miss
    if np.count_nonzero(free) < MIN_SKY_PX:
        return math.nan
    seen = radiance(
        sky, along, yaw=math.radians(row.hdri_yaw_deg), strength=row.strength, weather=row.weather,
        horizon_deg=row.horizon_deg,
    )  # fmt: skip
    expected = display_levels(seen @ (white_balance_matrix(row.white_balance_k).T * 2.0**row.exposure_ev))
    smoothed = ndimage.uniform_filter((picture - expected.reshape(picture.shape)) * free[..., None], (5, 5, 0))
    share = ndimage.uniform_filter(free.astype(np.float64), 5)
    return float(np.median(np.abs(smoothed[free] / share[free][:, None]).max(axis=1)))


def radiance(sky, along, *, yaw, strength, weather=None, horizon_deg=None):
    """Radiance (n, 3) of an equirectangular map, the zenith in its first row, along unit directions (n, 3).

    Air is a box around the camera; a horizon's color continues below it. See `weather` and `camera.backdrop`.
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
    if horizon is not None and horizon > HIGH_HORIZON_RADIANS:
        low, high = backdrop_fade_sines(horizon)
        share = np.clip((high - z) / (high - low), 0.0, 1.0)[..., None]
        seen = (1.0 - share) * seen + share * backdrop_color(sky, horizon) * strength
    if weather is None:
        return seen
    depth = np.zeros(along.shape[:-1])
    for layer in air_layers(weather.kind, weather.visibility_m):
        down = np.where(z > 0.0, layer.above, layer.reach)
        with np.errstate(divide="ignore"):
            sides = np.stack([layer.reach / np.abs(x), layer.reach / np.abs(y), down / np.abs(z)])
        depth += layer.extinction * sides.min(axis=0)
    clear = np.exp(-depth)[..., None]
    return clear * seen + (1.0 - clear) * airlight_radiance(weather.kind, even_sky_radiance(sky)) * strength


def outline_steps(picture, masks):
    """How much steeper a picture is across the outline of each mask than across moved copies of it.

    In standard deviations of the moved copies, so about 0 for the outline of something else; nan if the mask or its
    surroundings are too small. Copies count where they are outside of all masks.
    """
    covered = np.any(masks, axis=0) if masks else None
    return [_outline_step(picture, mask, ~covered) for mask in masks]


def _outline_step(picture, mask, around):
    if np.count_nonzero(mask) < MIN_MASK_PX:
        return math.nan
    soft = ndimage.gaussian_filter(mask.astype(np.float64), 1.0)
    facing = np.stack([ndimage.sobel(soft, axis) for axis in (0, 1)])
    length = np.hypot(*facing)
    edge = length > 0.5 * length.max()
    (y, x), facing = np.nonzero(edge), facing[:, edge] / length[edge]
    sector = (SECTORS * (np.arctan2(y - y.mean(), x - x.mean()) / (2.0 * np.pi) + 0.5)).astype(int) % SECTORS
    far, turn = np.meshgrid(SHIFTS, np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False), indexing="ij")
    down, right = np.maximum(4.0, far * np.ptp(y)) * np.sin(turn), np.maximum(4.0, far * np.ptp(x)) * np.cos(turn)
    free = around & ~ndimage.binary_dilation(mask, iterations=2)
    gradients = [[ndimage.sobel(channel, axis) for axis in (0, 1)] for channel in np.moveaxis(picture.astype(float), -1, 0)]

    def step(rows, columns):
        """Mean step where a copy is free; within a sector, steps up and down (noise, snow) cancel out."""
        inside = (rows >= 0) & (rows < mask.shape[0]) & (columns >= 0) & (columns < mask.shape[1])
        inside[inside] = free[rows[inside], columns[inside]] if rows is not y else True
        if inside.sum() < MIN_COPY_SHARE * len(y):
            return math.nan
        at = rows[inside], columns[inside]
        across = [below[at] * facing[0, inside] + beside[at] * facing[1, inside] for below, beside in gradients]
        sums = [np.bincount(sector[inside], each, minlength=SECTORS) for each in across]
        return np.abs(_MIXED @ np.array(sums)).max(axis=0).sum() / inside.sum()

    moves = zip(down.ravel().round().astype(int), right.ravel().round().astype(int), strict=True)
    copies = np.array([step(y + dy, x + dx) for dy, dx in moves])
    copies = copies[~np.isnan(copies)]
    if len(copies) < MIN_COPIES:
        return math.nan
    return float((step(y, x) - np.median(copies)) / (copies.std() + 0.05))
