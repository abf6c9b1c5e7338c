"""Query objects of a plan's sceneries and vehicles, built once per process."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Float

from hulldown.annotate.boxes import VehicleBoxes
from hulldown.assets.plan_assets import Assets, content_key
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.hulls import extreme_point_indices
from hulldown.geometry.transforms import BOX_CORNERS
from hulldown.placement.clearance import CameraRoom
from hulldown.placement.footprint import vehicle_underside
from hulldown.placement.settle import Footing, SettleRules, stack_samples
from hulldown.placement.terrain import Terrain
from hulldown.plan.config.scene_sections import PlacementSection
from hulldown.plan.config.schema import Config
from hulldown.scene.ground import Plane
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import VehicleCaster

_BARE_EXTENT_M = 50.0  # to each side of the origin, for a scenery without ground and obstacles
_BOUND_FUNCTIONS = (np.min, np.max)


@dataclass(frozen=True, eq=False, slots=True)
class Site:
    """A scenery, prepared for queries."""

    name: str
    terrain: Terrain  # top hits on its ground, or on the fallback plane
    world: Scene  # ground, with vertical walls, and obstacles for rays in any direction
    water: Terrain | None  # top hits on its water; None without any
    # obstacles, camera_room: clearance from obstacles, and of cameras from ground, water, and obstacles
    obstacles: Obstacles
    camera_room: CameraRoom
    bounds: Float[np.ndarray, "2 2"]  # lowest and highest (x, y) for vehicles, before the margin
    origin: Float[np.ndarray, "3"]  # origin, crs: the scenery's coordinates on a map
    crs: str


@dataclass(frozen=True, eq=False)
class FleetModel:
    """A vehicle or distractor, prepared for queries."""

    shape: VehicleShape  # shape, category: the vehicle and its class; None for a distractor without one
    category: str | None
    boxes: VehicleBoxes  # boxes, caster: its bounding boxes in cameras, and its surface for rays
    caster: VehicleCaster
    footing: Footing  # the points where it meets the ground

    @cached_property
    def part_hull_vertices(self) -> tuple[Float[np.ndarray, "h 3"], ...]:
        """Vertices of the convex hull of each part's visible vertices; of all of `caster`'s, if none are visible."""
        if self.shape.seen is None:
            return tuple(part.hull for part in self.caster.parts)
        seen = [(part, self.shape.seen_part_vertices(part.index)) for part in self.caster.parts]
        return tuple(points[extreme_point_indices(points)] if len(points) else part.hull for part, points in seen)


class Fleet:
    """All vehicles and distractors, with tables of their parts' boxes (vehicle frame, at rest), padded by the first."""

    def __init__(self, models: tuple[FleetModel, ...]) -> None:
        self.models = models
        self.index = {model.shape.name: i for i, model in enumerate(self.models)}
        self.classed = np.array([model.category is not None for model in self.models])
        self.size = np.array([model.shape.size_xyz for model in self.models])
        self.center = np.array([model.shape.surface[0].bounds.mean(axis=0) for model in self.models])
        self.footings = tuple(model.footing for model in self.models)
        self.contacts = stack_samples([footing.contact for footing in self.footings])
        self.max_parts = max(len(model.shape.part_names) for model in self.models)
        parts = [list(zip(model.caster.parts, model.part_hull_vertices, strict=True)) for model in self.models]
        self.box_counts = np.array([len(of_model) for of_model in parts])
        padded = [[*of_model, *[of_model[0]] * (self.box_counts.max() - len(of_model))] for of_model in parts]
        self.box_part = np.array([[part.index for part, _ in of_model] for of_model in padded])
        low, high = (
            np.array([[bound(hull, axis=0) for _, hull in of_model] for of_model in padded]) for bound in _BOUND_FUNCTIONS
        )
        self.half, self.box_center = (high - low) / 2, (low + high) / 2
        self.corners = np.where(BOX_CORNERS > 0.0, high[..., None, :], low[..., None, :])
        self.reach = np.array([_sphere_radius(model.shape) for model in self.models])


def _sphere_radius(shape: VehicleShape) -> float:
    """Return the radius of a sphere about the origin that contains all parts in any articulation."""
    reach = 0.0
    for part in range(len(shape.part_names)):
        part_vertices = shape.seen_part_vertices(part)
        if len(part_vertices):
            low, high = part_vertices.min(axis=0), part_vertices.max(axis=0)
            points = np.array(list(product(*np.stack([low, high]).T)))
            away, at = 0.0, points
            # A turning part stays in a sphere about its pivot; follow the pivots up to the hull, which doesn't turn.
            while part > 0:
                pivot = shape.part_pivot[part]
                farthest = np.linalg.norm(at - pivot, axis=1).max() + away
                away, at, part = farthest, pivot[None], int(shape.part_parent[part])
            reach = max(reach, float(np.linalg.norm(at, axis=1).max() + away))
    return reach * (1 + 1e-9)


@dataclass(frozen=True, eq=False, slots=True)
class PlanStage:
    """A plan's config, and its sites and models in the order of the config."""

    config: Config
    sites: tuple[Site, ...]
    fleet: Fleet  # the models: vehicles, then distractors
    vehicle_count: int


def make_stage(config: Config, assets: Assets) -> PlanStage:
    """Prepare all assets for queries."""
    listed: list[tuple[VehicleShape, str | None]] = [(v, assets.categories[name]) for name, v in assets.vehicles.items()]
    listed += [(assets.distractors[entry.name], entry.category) for entry in config.assets.distractors]
    shapes = {content_key(shape): shape for shape, _ in listed}
    models = {key: _make_fleet_model(shape, config) for key, shape in shapes.items()}
    fleet = Fleet(tuple(replace(models[content_key(shape)], shape=shape, category=name) for shape, name in listed))
    lands = {content_key(scenery): scenery for scenery in assets.sceneries.values()}
    sites = {key: _make_site(scenery, config.ground.fallback_z) for key, scenery in lands.items()}
    of_sceneries = tuple(replace(sites[content_key(land)], name=name) for name, land in assets.sceneries.items())
    return PlanStage(config, of_sceneries, fleet, len(assets.vehicles))


def _make_site(scenery: Scenery, fallback_z: float) -> Site:
    world = Scene.from_scenery(scenery, fallback_z=fallback_z)
    ground, scene = world.ground, world.obstacles
    assert ground is not None
    terrain = Terrain(ground.z) if isinstance(ground, Plane) else Terrain(ground.mesh, caster=ground)
    surface = scenery.water_surface()
    water = Terrain(surface) if surface else None
    bounds = terrain.bounds[:, :2]
    if not np.isfinite(bounds).all():
        bounds = np.array([[-_BARE_EXTENT_M] * 2, [_BARE_EXTENT_M] * 2])
        if len(scene.bounds):
            bounds = np.stack([scene.bounds[:, 0, :2].min(axis=0), scene.bounds[:, 1, :2].max(axis=0)])
    obstacles = Obstacles(scene, solid=scenery.solid_instance_mask, extent=bounds)
    return Site(
        name=scenery.name,
        terrain=terrain,
        world=world,
        water=water,
        obstacles=obstacles,
        camera_room=CameraRoom(terrain, obstacles, water),
        bounds=bounds,
        origin=scenery.origin,
        crs=scenery.crs,
    )


def settle_rules(limits: PlacementSection) -> SettleRules:
    """Return the config's limits of resting poses."""
    return SettleRules(
        limits.rule,
        max_slope=math.radians(limits.max_slope_deg),
        max_gap=limits.max_gap,
        max_penetration=limits.max_penetration,
    )


def _make_fleet_model(shape: VehicleShape, config: Config) -> FleetModel:
    return FleetModel(
        shape=shape,
        category=None,
        boxes=VehicleBoxes(shape),
        caster=VehicleCaster(shape),
        footing=Footing.from_footprint(
            vehicle_underside(shape.surface[0], known=shape.underside), settle_rules(config.placement)
        ),
    )
