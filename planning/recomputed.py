"""What follows from the poses in a plan's rows, to be held against the limits (`planning.limits`) and what rows say."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from annotate.boxes import Boxes
from camera.intrinsics import Lenses
from placement.footprint import contact_samples
from placement.settle import Settled, gap_and_penetration
from planning.aiming import camera_rejections, lenses_of, visible_shares
from planning.light import Lights, draw_lights
from planning.limits import METRES, SHARE
from planning.placing import CONTACT, clear_of_obstacles, clear_of_vehicle, depth_in_water, sees_sky, settle_at
from planning.rejections import AIMING, PLACING
from planning.row import PlannedVehicle, Row
from planning.schema import Config
from planning.sizing import fraction_of
from planning.source import Source
from planning.stage import Placed, Site

PIXELS = 1e-6


class Recomputed:
    """Values of n rows for one of their vehicles, each computed when it is first asked for.

    Parameters
    ----------
    source
        What the plan was made from.
    site
        Where all of the rows are.
    rows
        n of them, with the same vehicles in the same slots.
    first_shots
        For each row the first row of its position.
    vehicle
        Which vehicle: 0 is the target, k the k-th companion.
    """

    def __init__(
        self,
        source: Source,
        site: Site,
        rows: list[Row],
        *,
        first_shots: list[Row],
        vehicle: int,
    ) -> None:
        self.source, self.site = source, site
        self.config: Config = source.config
        self.rows, self.first_shots, self.k = rows, first_shots, vehicle

    def said(self, key: str, *, of_image: bool = False) -> np.ndarray:
        """The rows' numbers, of the vehicle or of the image."""
        return np.array(
            [getattr(row if of_image else _vehicle(row, self.k), key) for row in self.rows], dtype=np.float64
        )

    def says(self, key: str, found: Float[np.ndarray, " n"], tolerance: float) -> Bool[np.ndarray, " n"]:
        """Whether the rows say of the vehicle what was found."""
        return np.abs(self.said(key) - found) <= tolerance

    def says_box(self, key: str, found: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
        """Whether the rows have the box that was found, or none where none was."""
        boxes = [getattr(_vehicle(row, self.k), key) for row in self.rows]
        said = np.array([[np.nan] * 4 if box is None else box for box in boxes], dtype=np.float64)
        return ((np.abs(found - said) <= PIXELS) | (np.isnan(found) & np.isnan(said))).all(axis=1)

    # Vehicles.

    @cached_property
    def vehicles(self) -> list[Placed]:
        """All vehicles in their poses, the target first."""
        return [self._placed(k) for k in range(1 + len(self.rows[0].companions))]

    def _placed(self, k: int) -> Placed:
        said = [_vehicle(row, k) for row in self.rows]
        poses = np.array([vehicle.world_from_vehicle for vehicle in said], dtype=np.float64)
        model = self.source.stage.models[said[0].vehicle]
        return Placed(model, poses, [vehicle.articulation for vehicle in said])

    @property
    def placed(self) -> Placed:
        """The vehicle."""
        return self.vehicles[self.k]

    @property
    def others(self) -> list[Placed]:
        """The other vehicles."""
        return self.vehicles[: self.k] + self.vehicles[self.k + 1 :]

    @property
    def rigid(self) -> Bool[np.ndarray, " n"]:
        """Whether its pose is one."""
        return _rigid(self.placed.world_from_vehicle)

    @property
    def category_is_the_vehicles(self) -> Bool[np.ndarray, " n"]:
        """Whether its class is that of the config."""
        return np.array([_vehicle(row, self.k).category == self.placed.model.category for row in self.rows])

    @property
    def inside_the_area(self) -> Bool[np.ndarray, " n"]:
        """Whether it is in the area that vehicles are placed in."""
        bounds = self.site.bounds
        half = self.config.placement.margin * np.ptp(bounds, axis=0) / 2
        away = np.abs(self.placed.world_from_vehicle[:, :2, 3] - bounds.mean(axis=0))
        return (away <= half + METRES).all(axis=1)

    @property
    def slope_deg(self) -> Float[np.ndarray, " n"]:
        """Inclination of its up axis."""
        return _inclination_deg(self.placed.world_from_vehicle[:, :3, 2])

    @property
    def slope_at_spot_deg(self) -> Float[np.ndarray, " n"]:
        """Inclination of the ground below its origin."""
        return _inclination_deg(self.site.terrain.top_hits(self.placed.world_from_vehicle[:, :2, 3]).normal)

    @cached_property
    def settled(self) -> Settled:
        """The vehicle settled once more at its place, with its heading."""
        return settle_at(self.site, self.placed.model, self.config, self.placed.world_from_vehicle)

    @property
    def at_rest(self) -> Bool[np.ndarray, " n"]:
        """Whether its pose is the one that it settles in."""
        return np.abs(self.settled.world_from_vehicle - self.placed.world_from_vehicle).max(axis=(1, 2)) <= METRES

    @cached_property
    def contact(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Gap under what it stands on, and penetration of all of its underside."""
        underside = self.placed.model.undersides[self.config.placement.contact]
        looked_at = contact_samples(underside, CONTACT)
        return gap_and_penetration(self.site.terrain, self.placed.world_from_vehicle, looked_at)

    @property
    def depth_in_water(self) -> Float[np.ndarray, " n"]:
        """How far its underside is below water."""
        return depth_in_water(self.site, self.placed, self.config.placement.contact)

    @property
    def sees_sky(self) -> Bool[np.ndarray, " n"]:
        """Whether it is not shut in."""
        return sees_sky(self.site, self.placed)

    @property
    def articulation_is_possible(self) -> Bool[np.ndarray, " n"]:
        """Whether all its movable parts are turned within their limits; none are where the config turns none."""
        shape = self.placed.model.shape
        names = set(shape.part_names[1:]) if self.config.placement.articulate else set()
        limits = dict(zip(shape.part_names, shape.part_limits.tolist(), strict=True))
        return np.array(
            [
                set(turned) == names
                and all(limits[name][0] - SHARE <= turned[name] <= limits[name][1] + SHARE for name in names)
                for turned in self.placed.articulation
            ]
        )

    @property
    def clear_of_obstacles(self) -> Bool[np.ndarray, " n"]:
        """Whether it keeps clear of obstacles."""
        return clear_of_obstacles(self.site, self.placed, self.config.placement.obstacle_clearance)

    @property
    def clear_of_vehicles(self) -> Bool[np.ndarray, " n"]:
        """Whether it keeps clear of the other vehicles."""
        clear = np.ones(len(self.rows), dtype=bool)
        for other in self.others:
            clear &= clear_of_vehicle(self.placed, other, self.config.placement.vehicle_clearance)
        return clear

    @property
    def vehicle_count(self) -> Int[np.ndarray, " n"]:
        """Vehicles in the image."""
        return np.full(len(self.rows), len(self.vehicles))

    @property
    def distance_from_target(self) -> Float[np.ndarray, " n"]:
        """Metres between the origins, seen from above."""
        away = self.placed.world_from_vehicle[:, :2, 3] - self.vehicles[0].world_from_vehicle[:, :2, 3]
        return np.linalg.norm(away, axis=1)

    @property
    def tries_add_up(self) -> Bool[np.ndarray, " n"]:
        """Whether a position was tried as often as it was rejected, and once more."""
        rejected = np.array([_count(row, PLACING) for row in self.first_shots])
        return self.said("tries") == rejected + 1

    # Cameras.

    @cached_property
    def cameras(self) -> Float[np.ndarray, "n 4 4"]:
        """Their poses."""
        return np.array([row.world_from_camera for row in self.rows], dtype=np.float64)

    @property
    def camera_is_rigid(self) -> Bool[np.ndarray, " n"]:
        """Whether the camera's pose is one."""
        return _rigid(self.cameras)

    @cached_property
    def fov_x(self) -> Float[np.ndarray, " n"]:
        """Horizontal fields of view, radians."""
        return np.radians(self.said("fov_x_deg", of_image=True))

    @cached_property
    def lens(self) -> Lenses:
        """The insides of the cameras."""
        return lenses_of(self.config.render, self.fov_x)

    @property
    def away(self) -> Float[np.ndarray, "n 3"]:
        """From the centre of the target's box to the camera."""
        return self.cameras[:, :3, 3] - self.vehicles[0].centres

    @property
    def distance(self) -> Float[np.ndarray, " n"]:
        """Metres between them."""
        return np.linalg.norm(self.away, axis=1)

    @property
    def elevation_deg(self) -> Float[np.ndarray, " n"]:
        """The camera above the horizon of the target's centre."""
        x, y, z = np.ascontiguousarray(self.away.T)
        return np.degrees(np.arctan2(z, np.hypot(x, y)))

    @property
    def baseline_distance(self) -> Float[np.ndarray, " n"]:
        """D of equation 6 at a target fraction of 1."""
        render = self.config.render
        return Lenses.of(render.width, render.height, self.fov_x).distance_for(self.vehicles[0].model.smallest, 1.0)

    @cached_property
    def camera_rejection(self) -> UInt8[np.ndarray, " n"]:
        """Why a camera may not be there."""
        return camera_rejections(self.site, self.cameras[:, :3, 3], self.vehicles, self.config.camera)

    @cached_property
    def boxes(self) -> Boxes:
        """The vehicle's boxes."""
        placed = self.placed
        return placed.model.boxes.boxes(placed.world_from_vehicle, self.cameras, self.lens, placed.articulation)

    @property
    def share_of_image(self) -> Float[np.ndarray, " n"]:
        """What share of the image's height, width, diagonal or area the box fills."""
        measure = self.config.camera.size_measure
        assert measure != "paper"
        return fraction_of(self.boxes.amodal, measure, self.config.render)

    @cached_property
    def visible_fraction(self) -> Float[np.ndarray, " n"]:
        """Share of the vehicle's outline that nothing hides."""
        return visible_shares(
            self.site,
            self.placed,
            self.others,
            self.cameras,
            intrinsics=self.lens,
            rays=self.config.camera.visibility_rays,
        )

    @property
    def cameras_tried(self) -> Float[np.ndarray, " n"]:
        """Cameras tried for the image at the place that took most of them, at least."""
        rejected = np.array([_count(row, AIMING) for row in self.rows])
        blind = np.array([row.rejected.get("no_view", 0) for row in self.first_shots])
        return np.ceil((rejected + 1) / (blind + 1))

    # Light, and the plan as a whole.

    @cached_property
    def lights(self) -> Lights:
        """What is drawn for images with these indices."""
        index = np.array([row.index for row in self.rows])
        weights = np.array(list(self.source.hdri_weights.values()))
        return draw_lights(self.config.light, self.config.weather, weights, draws=self.source.draws, image=index)

    @property
    def hdri_has_weight(self) -> Bool[np.ndarray, " n"]:
        """Whether the HDRI is one that may be drawn."""
        return np.array([self.source.hdri_weights[row.hdri] > 0.0 for row in self.rows])

    @property
    def scenery_has_weight(self) -> Bool[np.ndarray, " n"]:
        """Whether the scenery is one that may be drawn."""
        return np.full(len(self.rows), self.source.scenery_weights.get(self.site.name, 1.0) > 0.0)

    @property
    def visibility_m(self) -> Float[np.ndarray, " n"]:
        """How far one sees; nan without fog."""
        weather = [row.weather for row in self.rows]
        return np.array([np.nan if one is None else one.visibility_m for one in weather], dtype=np.float64)

    @property
    def foggy_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether there is fog where it was drawn."""
        return np.isnan(self.visibility_m) == np.isnan(self.lights.visibility_m)

    @property
    def seed_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether Cycles' seed is the one drawn."""
        return np.array([row.sample_seed for row in self.rows]) == self.lights.sample_seed

    @property
    def image_size_is_the_configs(self) -> Bool[np.ndarray, " n"]:
        """Whether pictures are as large as the config wants them."""
        render = self.config.render
        return np.array([(row.width, row.height) == (render.width, render.height) for row in self.rows])

    @property
    def in_budget(self) -> Bool[np.ndarray, " n"]:
        """Whether the budget gives this image to this shot of this position, with this vehicle."""
        budget = self.source.budget
        position = np.array([row.position for row in self.rows])
        known = (position >= 0) & (position < budget.n_positions)
        held = budget.positions(np.where(known, position, 0))
        shot, index = (np.array([getattr(row, key) for row in self.rows]) for key in ("shot", "index"))
        vehicle = np.array([budget.vehicles[v] for v in held.vehicle.tolist()])
        mine = np.array([row.vehicle for row in self.rows])
        return known & (shot < held.shots) & (index == held.first_image + shot) & (vehicle == mine)

    @property
    def shares_with_first_shot(self) -> Bool[np.ndarray, " n"]:
        """Whether the shots of one position share everything but the camera and the light."""
        return np.array(
            [_shared(row) == _shared(first) for row, first in zip(self.rows, self.first_shots, strict=True)]
        )


def _vehicle(row: Row, k: int) -> PlannedVehicle:
    return row.vehicles[k]


def _count(row: Row, kinds: tuple[Any, ...]) -> int:
    return sum(row.rejected.get(kind.key, 0) for kind in kinds)


def _shared(row: Row) -> list[Any]:
    """What the shots of a position have in common, poses as lists."""
    keys = ("vehicle", "articulation", "slope_deg", "gap", "penetration", "tries")
    poses = [vehicle.world_from_vehicle.tolist() for vehicle in row.vehicles]
    return [row.scenery, row.position, poses, [[getattr(vehicle, key) for key in keys] for vehicle in row.vehicles]]


def _rigid(poses: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
    rotation = poses[:, :3, :3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    upright = (poses[:, 3] == [0.0, 0.0, 0.0, 1.0]).all(axis=1)
    return (off <= SHARE) & (np.linalg.det(rotation) > 0.0) & upright


def _inclination_deg(up: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.degrees(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2].copy()))
