"""What follows from the poses of vehicles and cameras in a plan's rows."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, UInt8

from annotate.boxes import Boxes
from camera.intrinsics import Lenses
from placement.footprint import contact_samples
from placement.settle import Settled, gap_and_penetration
from planning.aiming import air_contrasts, camera_rejections, lenses_of, visible_shares
from planning.placing import CONTACT, clear_of_obstacles, clear_of_vehicle, depth_in_water, sees_sky, settle_at
from planning.row import Row
from planning.schema import Config
from planning.search_limits import METRES, SHARE
from planning.sizing import fraction_of
from planning.source import Source
from planning.stage import Placed, Site

PIXELS = 1e-6


class RecomputedPoses:
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
        Which vehicle of `Row.planned`: 0 is the one that the camera is framed on.
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

    @property
    def kind(self) -> str:
        """What the vehicle is: target, companion or distractor."""
        return "target" if not self.k else "companion" if self.k <= len(self.rows[0].companions) else "distractor"

    @property
    def place(self) -> str:
        """Where rows have the vehicle, as the beginning of a key."""
        if self.kind == "target":
            return ""
        companions = len(self.rows[0].companions)
        return f"companions[{self.k - 1}]." if self.kind == "companion" else f"distractors[{self.k - 1 - companions}]."

    def said(self, key: str, *, of_image: bool = False) -> np.ndarray:
        """The rows' numbers, of the vehicle or of the image."""
        return np.array([getattr(row if of_image else row.planned[self.k], key) for row in self.rows], dtype=np.float64)

    def says(self, key: str, found: Float[np.ndarray, " n"], tolerance: float) -> Bool[np.ndarray, " n"]:
        """Whether the rows say of the vehicle what was found."""
        return np.abs(self.said(key) - found) <= tolerance

    def says_box(self, key: str, found: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
        """Whether the rows have the box that was found, or none where none was."""
        boxes = [getattr(row.planned[self.k], key) for row in self.rows]
        said = np.array([[np.nan] * 4 if box is None else box for box in boxes], dtype=np.float64)
        return ((np.abs(found - said) <= PIXELS) | (np.isnan(found) & np.isnan(said))).all(axis=1)

    @property
    def says_its_bounds(self) -> Bool[np.ndarray, " n"]:
        """Whether the rows have the box that holds the vehicle."""
        found = self.placed.bounds()
        said = [row.planned[self.k].bounds for row in self.rows]
        return (np.abs(np.array(said, dtype=np.float64) - found) <= METRES).all(axis=(1, 2))

    # Vehicles.

    @cached_property
    def vehicles(self) -> list[Placed]:
        """All vehicles in their poses, the one that the camera is framed on first."""
        return [self._placed(k) for k in range(len(self.rows[0].planned))]

    def _placed(self, k: int) -> Placed:
        said = [row.planned[k] for row in self.rows]
        poses = np.array([vehicle.world_from_vehicle for vehicle in said], dtype=np.float64)
        model = self.source.stage.everything[said[0].vehicle]
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
    def in_the_way(self) -> list[Placed]:
        """The other vehicles that are in the picture."""
        return self.others[1:] if self.rows[0].empty and self.k else self.others

    @property
    def rigid(self) -> Bool[np.ndarray, " n"]:
        """Whether its pose is one."""
        return _rigid(self.placed.world_from_vehicle)

    @property
    def category_is_the_vehicles(self) -> Bool[np.ndarray, " n"]:
        """Whether its class is that of the config."""
        return np.array([row.planned[self.k].category == self.placed.model.category for row in self.rows])

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
    def distance_from_target(self) -> Float[np.ndarray, " n"]:
        """Metres between the origins, seen from above."""
        away = self.placed.world_from_vehicle[:, :2, 3] - self.vehicles[0].world_from_vehicle[:, :2, 3]
        return np.linalg.norm(away, axis=1)

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

    @property
    def visibility_m(self) -> Float[np.ndarray, " n"]:
        """How far one sees; nan in clear air."""
        weather = [row.weather for row in self.rows]
        return np.array([np.nan if one is None else one.visibility_m for one in weather], dtype=np.float64)

    @property
    def air_contrast(self) -> Float[np.ndarray, " n"]:
        """What the air leaves of the vehicle's contrast."""
        return air_contrasts(self.placed, self.cameras, self.visibility_m)

    @property
    def says_its_air_contrast(self) -> Bool[np.ndarray, " n"]:
        """Whether the rows say it."""
        said, found = (row.planned[self.k].air_contrast for row in self.rows), self.air_contrast.tolist()
        return np.array([abs(x - own) <= SHARE for x, own in zip(said, found, strict=True)])

    @cached_property
    def visible_fraction(self) -> Float[np.ndarray, " n"]:
        """Share of the vehicle's outline that nothing hides."""
        return visible_shares(
            self.site,
            self.placed,
            self.in_the_way,
            self.cameras,
            intrinsics=self.lens,
            rays=self.config.camera.visibility_rays,
        )


def _rigid(poses: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
    rotation = poses[:, :3, :3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    upright = (poses[:, 3] == [0.0, 0.0, 0.0, 1.0]).all(axis=1)
    return (off <= SHARE) & (np.linalg.det(rotation) > 0.0) & upright


def _inclination_deg(up: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.degrees(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2].copy()))
