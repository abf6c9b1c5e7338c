"""Every limit of a plan, recomputed from the poses in its rows: what `hulldown plan --check` says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from assets.library import Assets
from camera.clearance import Spot
from camera.intrinsics import Lenses
from camera.visibility import visible_fraction
from placement.footprint import contact_spots
from placement.settle import gap_and_penetration
from planning.aiming import SIZED, intrinsics_of
from planning.budget import make_budget
from planning.config import parse_config
from planning.placing import clear_of_obstacles, clear_of_vehicle
from planning.plan_file import Plan
from planning.row import PlannedVehicle, Row
from planning.schema import Config
from planning.sizing import fraction_of
from planning.stage import Placed, PlanStage, Site, make_stage

ROWS = 2048  # checked together
MOST = 1000  # findings that are listed
# Poses are exact in the file; what is recomputed from them differs by what it was rounded to.
METRES, DEGREES, PIXELS, SHARE = 1e-6, 1e-6, 1e-6, 1e-9
CONTACT = 9  # points a side of the underside at which gap and penetration are looked at


def check_plan(plan: Plan, assets: Assets, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """What in a plan breaks a limit of its own config, or is not what follows from its poses.

    Parameters
    ----------
    plan
        The plan.
    assets
        Those it was made from.
    progress
        Called with images checked and their number.

    Returns
    -------
    One line for each finding; nothing if all is well.

    Raises
    ------
    ConfigError
        If a line of the plan is damaged.
    """
    config = parse_config(plan.header.config, path=plan.path)
    checker = _Checker(config, assets)
    rows = iter(plan)
    done = 0
    while some := list(islice(rows, ROWS)):
        checker.look_at(some)
        done += len(some)
        if progress:
            progress(done, len(plan))
    checker.look_at_counts(len(plan))
    more = len(checker.findings) - MOST
    return checker.findings[:MOST] + ([f"and {more:,} more"] if more > 0 else [])


class _Checker:
    def __init__(self, config: Config, assets: Assets) -> None:
        self.config, self.assets = config, assets
        self.stage: PlanStage = make_stage(config, assets)
        self.sites = {site.name: site for site in self.stage.sites}
        self.findings: list[str] = []
        self.images: Counter[str] = Counter()
        self.before: Row | None = None

    def look_at(self, rows: list[Row]) -> None:
        """Everything about some consecutive rows."""
        known = [row for row in rows if self._names_are_known(row)]
        for row in known:
            self.images[row.vehicle] += 1
            self._sequence(row)
        groups: dict[tuple[str, str, tuple[str, ...]], list[Row]] = {}
        for row in known:
            key = (row.scenery, row.vehicle, tuple(c.vehicle for c in row.companions))
            groups.setdefault(key, []).append(row)
        for (scenery, *_), mine in groups.items():
            site = self.sites[scenery]
            self._light(mine)
            vehicles = [self._placed(mine, k) for k in range(1 + len(mine[0].companions))]
            self._camera(mine, site, vehicles)
            for k, placed in enumerate(vehicles):
                others = vehicles[:k] + vehicles[k + 1 :]
                self._stand(mine, k, site, placed, others)
                self._view(mine, k, site, placed, others)

    def look_at_counts(self, images: int) -> None:
        """Whether every vehicle has the images that the budget gives it."""
        budget = make_budget(self.config.budget, {name: self.assets.categories[name] for name in self.assets.vehicles})
        if images != budget.n_images:
            self.findings.append(f"{images} images, the budget is {budget.n_images}")
        for vehicle, n in zip(budget.vehicles, budget.images.tolist(), strict=True):
            if self.images[vehicle] != n:
                self.findings.append(f"vehicle {vehicle!r}: {self.images[vehicle]} images, its budget is {n}")

    def _names_are_known(self, row: Row) -> bool:
        wrong = [
            f"{kind} {name!r} is not in the config"
            for kind, name, known in (
                ("scenery", row.scenery, self.sites),
                ("hdri", row.hdri, self.assets.hdris),
                *(("vehicle", vehicle.vehicle, self.stage.models) for vehicle in row.vehicles),
            )
            if name not in known
        ]
        self.findings += [f"image {row.index}: {what}" for what in wrong]
        return not wrong

    def _sequence(self, row: Row) -> None:
        """Shots of one position follow each other and share everything but the camera and the light."""
        before = self.before
        self.before = row
        if before is None or row.position != before.position:
            expected = 0 if before is None else before.position + 1
            self._demand([row], np.array([row.shot == 0 and row.position == expected]), "position and shot")
            return
        shared = ("scenery", "vehicle", "articulation", "slope_deg", "gap", "penetration")
        same = all(getattr(row, key) == getattr(before, key) for key in shared) and row.shot == before.shot + 1
        here, there = (np.array([vehicle.world_from_vehicle for vehicle in r.vehicles]) for r in (row, before))
        self._demand([row], np.array([same and np.array_equal(here, there)]), "what the shots of a position share")

    def _light(self, rows: list[Row]) -> None:
        light, weather, render = self.config.light, self.config.weather, self.config.render
        self._within(rows, "hdri_yaw_deg", _column(rows, "hdri_yaw_deg"), light.yaw_deg, slack=DEGREES)
        self._within(rows, "strength", _column(rows, "strength"), light.strength, slack=SHARE)
        foggy = [row for row in rows if row.weather is not None]
        visibility = np.array([row.weather.visibility_m for row in foggy if row.weather is not None])
        self._within(foggy, "weather.visibility_m", visibility, weather.visibility_m, slack=METRES)
        self._demand(foggy, np.full(len(foggy), weather.probability > 0.0), "weather")
        sizes = [(row.width, row.height) == (render.width, render.height) for row in rows]
        self._demand(rows, np.array(sizes), "width and height")

    def _placed(self, rows: list[Row], k: int) -> Placed:
        vehicles = [_vehicle(row, k) for row in rows]
        poses = np.array([vehicle.world_from_vehicle for vehicle in vehicles])
        return Placed(self.stage.models[vehicles[0].vehicle], poses, [vehicle.articulation for vehicle in vehicles])

    def _stand(self, rows: list[Row], k: int, site: Site, placed: Placed, others: list[Placed]) -> None:
        limits, name = self.config.placement, f"companions[{k - 1}]." if k else ""
        poses, shape = placed.world_from_vehicle, placed.model.shape
        self._demand(rows, _rigid(poses), f"{name}world_from_vehicle")
        for part, (low, high) in zip(shape.part_names[1:], shape.part_limits[1:].tolist(), strict=True):
            angle = np.array([turned.get(part, 0.0) for turned in placed.articulation])
            bounds = (low, high) if limits.articulate else (0.0, 0.0)
            self._within(rows, f"{name}articulation.{part}", angle, bounds, slack=SHARE)
        xy = poses[:, :2, 3]
        if not k:
            middle, half = site.bounds.mean(axis=0), limits.margin * np.ptp(site.bounds, axis=0) / 2
            self._demand(rows, (np.abs(xy - middle) <= half + METRES).all(axis=1), "placement.margin")
        slope = np.degrees(np.arctan2(np.hypot(poses[:, 0, 2], poses[:, 1, 2]), poses[:, 2, 2].copy()))
        self._within(rows, f"{name}slope_deg", slope, (0.0, limits.max_slope_deg), slack=DEGREES)
        said = np.array([_vehicle(row, k).slope_deg for row in rows])
        self._demand(rows, np.abs(slope - said) <= DEGREES, f"{name}slope_deg, which is not the pose's")
        spot = site.terrain.top_hits(xy)
        steep = np.degrees(np.arctan2(np.hypot(spot.normal[:, 0], spot.normal[:, 1]), spot.normal[:, 2].copy()))
        self._within(rows, f"{name}slope at the spot", steep, (0.0, limits.max_slope_deg), slack=DEGREES)
        contact = contact_spots(placed.model.undersides[limits.contact], CONTACT)
        gap, penetration = gap_and_penetration(site.terrain, placed.world_from_vehicle, contact)
        self._within(rows, f"{name}gap", gap, (0.0, limits.max_gap), slack=METRES)
        self._within(rows, f"{name}penetration", penetration, (0.0, limits.max_penetration), slack=METRES)
        for key, found in (("gap", gap), ("penetration", penetration)):
            said = np.array([getattr(_vehicle(row, k), key) for row in rows])
            self._demand(rows, np.abs(found - said) <= METRES, f"{name}{key}, which is not the pose's")
        clear = clear_of_obstacles(site, placed, limits.obstacle_clearance)
        self._demand(rows, clear, f"{name}placement.obstacle_clearance")
        for other in others:
            clear = clear_of_vehicle(placed, other, limits.vehicle_clearance)
            self._demand(rows, clear, f"{name}placement.vehicle_clearance")

    def _camera(self, rows: list[Row], site: Site, vehicles: list[Placed]) -> None:
        limits, poses = self.config.camera, _column(rows, "world_from_camera")
        self._demand(rows, _rigid(poses), "world_from_camera")
        fov = _column(rows, "fov_x_deg")
        self._within(rows, "fov_x_deg", fov, limits.fov_x_deg, slack=DEGREES)
        target = vehicles[0]
        away = poses[:, :3, 3] - target.centres
        distance = np.linalg.norm(away, axis=1)
        self._within(rows, "camera.distance_m", distance, limits.distance_m, slack=METRES)
        if limits.size_measure == "paper":
            render = self.config.render
            lens = Lenses.of(render.width, render.height, np.radians(fov))
            nearest, farthest = (
                factor * lens.distance_for(target.model.smallest, share)
                for factor, share in zip(limits.distance_factor, limits.target_fraction[::-1], strict=True)
            )
            on = (distance >= nearest * (1 - SHARE)) & (distance <= farthest * (1 + SHARE))
            self._demand(rows, on, "camera.distance_factor of equation 6")
        elevation = np.degrees(np.arctan2(away[:, 2].copy(), np.hypot(away[:, 0], away[:, 1])))
        self._within(rows, "camera.elevation_deg", elevation, limits.elevation_deg, slack=DEGREES)
        spots = site.camera_room.judge(
            poses[:, :3, 3],
            ground_clearance=limits.ground_clearance,
            obstacle_clearance=limits.obstacle_clearance,
            vehicles=[vehicle.posed for vehicle in vehicles],
            vehicle_clearance=limits.obstacle_clearance,
        )
        for spot in (Spot.OFF_GROUND, Spot.LOW, Spot.OBSTACLE, Spot.VEHICLE):
            self._demand(rows, spots != spot, f"the camera's place ({spot.name.lower().replace('_', ' ')})")

    def _view(self, rows: list[Row], k: int, site: Site, placed: Placed, others: list[Placed]) -> None:
        limits, name = self.config.camera, f"companions[{k - 1}]." if k else ""
        cameras = _column(rows, "world_from_camera")
        intrinsics = intrinsics_of(self.config.render, _column(rows, "fov_x_deg"))
        boxes = placed.model.boxes.boxes(placed.world_from_vehicle, cameras, intrinsics, placed.articulation)
        for key, found in (("bbox", boxes.xywh), ("bbox_amodal", boxes.amodal)):
            said = np.array([getattr(_vehicle(row, k), key) or [np.nan] * 4 for row in rows])
            same = (np.abs(found - said) <= PIXELS) | (np.isnan(found) & np.isnan(said))
            self._demand(rows, same.all(axis=1), f"{name}{key}, which is not the poses'")
        said = np.array([_vehicle(row, k).truncated_fraction for row in rows])
        same = np.abs(said - boxes.truncated_fraction) <= SHARE
        self._demand(rows, same, f"{name}truncated_fraction, which is not the poses'")
        seen = visible_fraction(
            placed.model.target,
            placed.world_from_vehicle,
            cameras,
            intrinsics=intrinsics,
            articulation=placed.articulation,
            world=site.world.with_vehicles([other.posed for other in others]),
            rays=limits.visibility_rays,
        )
        visible = np.nan_to_num(seen.fraction)
        said = np.array([_vehicle(row, k).visible_fraction for row in rows])
        self._demand(rows, np.abs(said - visible) <= SHARE, f"{name}visible_fraction, which is not the poses'")
        if not k:
            self._within(rows, "visible_fraction", visible, limits.visible_fraction, slack=SHARE)
            self._within(rows, "truncated_fraction", boxes.truncated_fraction, limits.truncated_fraction, slack=SHARE)
            self._demand(rows, boxes.xywh[:, 2:].min(axis=1) >= limits.min_box_px, "camera.min_box_px")
            if limits.size_measure != "paper":
                filled = fraction_of(boxes.amodal, limits.size_measure, self.config.render)
                what = f"share of the image's {limits.size_measure}"
                self._within(rows, what, filled, limits.target_fraction, slack=SIZED * limits.target_fraction[1])

    def _within(
        self,
        rows: list[Row],
        what: str,
        values: Float[np.ndarray, " n"],
        bounds: tuple[float, float],
        *,
        slack: float = 0.0,
    ) -> None:
        good = (values >= bounds[0] - slack) & (values <= bounds[1] + slack)
        for i in np.flatnonzero(~good).tolist():
            text = f"{what} is {values[i]:.6g}, allowed are {bounds[0]:.6g} to {bounds[1]:.6g}"
            self.findings.append(f"image {rows[i].index}: {text}")

    def _demand(self, rows: list[Row], good: Bool[np.ndarray, " n"], what: str) -> None:
        self.findings += [f"image {rows[i].index}: breaks {what}" for i in np.flatnonzero(~good).tolist()]


def _vehicle(row: Row, k: int) -> PlannedVehicle:
    return row.vehicles[k]


def _column(rows: list[Row], key: str) -> np.ndarray:
    return np.array([getattr(row, key) for row in rows], dtype=np.float64)


def _rigid(poses: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
    rotation = poses[:, :3, :3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    upright = (poses[:, 3] == [0.0, 0.0, 0.0, 1.0]).all(axis=1)
    return (off <= SHARE) & (np.linalg.det(rotation) > 0.0) & upright
