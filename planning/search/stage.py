"""What the planner asks its questions to: terrain, obstacles and boxes of every asset, built once per process."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from hulldown.annotate.boxes import VehicleBoxes
from hulldown.assets.library import Assets
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.clearance import CameraRoom
from hulldown.camera.target import VehicleTarget
from hulldown.camera.world import Plane, World
from hulldown.geometry.rays import RayCaster
from hulldown.placement.clearance import Obstacles
from hulldown.placement.contact import Footing, stacked
from hulldown.placement.footprint import underside
from hulldown.placement.rules import SettleRules
from hulldown.placement.terrain import Terrain
from hulldown.planning.config.schema import Config, PlacementSection

_BARE_EXTENT = 50.0  # meters to each side of the origin, where a scenery has neither ground nor obstacles


@dataclass(frozen=True, eq=False, slots=True)
class Site:
    """A scenery, ready for questions.

    Parameters
    ----------
    name
        The scenery's.
    terrain
        Its ground, or the fallback plane: where tops are.
    world
        Ground and obstacles for rays of any direction; vertical walls, which are no top, are ground here.
    water
        Its water surfaces, or None if it has none.
    vehicle_room
        Answers whether vehicles are clear of the obstacles.
    camera_room
        Answers whether cameras are clear of ground, water and obstacles.
    bounds
        (2, 2) lowest and highest (x, y) that vehicles are placed in, before the margin.
    origin, crs
        The scenery's: where on a map it is.
    """

    name: str
    terrain: Terrain
    world: World
    water: Terrain | None
    vehicle_room: Obstacles
    camera_room: CameraRoom
    bounds: Float[np.ndarray, "2 2"]
    origin: Float[np.ndarray, "3"]
    crs: str


@dataclass(frozen=True, eq=False, slots=True)
class Model:
    """A vehicle, ready for questions.

    Parameters
    ----------
    shape
        The vehicle.
    category
        Its class; None of a distractor without one.
    boxes
        Answers for its boxes.
    target
        Answers for rays at it.
    center
        (3,) center of its bounding box, vehicle frame.
    footing
        What meets the ground, by `placement.contact`: its underside, or a plate as large as its box.
    corners
        (b, 8, 3) corners of the bounding boxes of its parts at rest, vehicle frame.
    half
        (b, 3) half the sizes of those boxes.
    part
        (b,) the parts they belong to.
    """

    shape: VehicleShape
    category: str | None
    boxes: VehicleBoxes
    target: VehicleTarget
    center: Float[np.ndarray, "3"]
    footing: Footing
    corners: Float[np.ndarray, "b 8 3"]
    half: Float[np.ndarray, "b 3"]
    part: Int[np.ndarray, " b"]


class Fleet:
    """All vehicles and distractors of a plan. Arrays have a line for each, and repeat its first box where it has fewer.

    Parameters
    ----------
    models
        They.

    Attributes
    ----------
    models
        They.
    index
        Name -> index among them.
    size, center
        (m, 3) of their bounding boxes at rest.
    parts
        Most parts that one of them has.
    boxes
        (m,) number of parts that have faces, and so a box.
    footings, contacts
        What meets the ground: of each, and the points of contact of all as one table.
    reach
        (m,) meters from the origin that no part reaches beyond, however it is turned.
    half, box_center, box_part, corners
        (m, b, 3), (m, b, 3), (m, b) and (m, b, 8, 3): those boxes; see `Model`.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        self.index = {model.shape.name: i for i, model in enumerate(self.models)}
        self.size = np.array([model.shape.size_xyz for model in self.models])
        self.center = np.array([model.center for model in self.models])
        self.footings = tuple(model.footing for model in self.models)
        self.contacts = stacked([footing.contact for footing in self.footings])
        self.parts = max(len(model.shape.part_names) for model in self.models)
        self.boxes = np.array([len(model.half) for model in self.models])
        filled = [np.where(np.arange(self.boxes.max()) < n, np.arange(self.boxes.max()), 0) for n in self.boxes]
        self.half = np.stack([model.half[i] for model, i in zip(self.models, filled, strict=True)])
        self.corners = np.stack([model.corners[i] for model, i in zip(self.models, filled, strict=True)])
        self.box_part = np.stack([model.part[i] for model, i in zip(self.models, filled, strict=True)])
        self.reach = np.array([_reach(model.shape) for model in self.models])
        self.box_center = (self.corners.min(axis=2) + self.corners.max(axis=2)) / 2


def _reach(shape: VehicleShape) -> float:
    """A part that turns stays within a sphere about its pivot, which turns with the part it rides on."""
    reach = 0.0
    for part in range(len(shape.part_names)):
        part_vertices = shape.mesh.vertices[shape.vertex_part == part]
        if len(part_vertices):
            low, high = part_vertices.min(axis=0), part_vertices.max(axis=0)
            points = np.array(list(product(*np.stack([low, high]).T)))
            away, at = 0.0, points
            # Up the chain of pivots to the hull, which does not turn.
            while part > 0:
                pivot = shape.part_pivot[part]
                farthest = np.linalg.norm(at - pivot, axis=1).max() + away
                away, at, part = farthest, pivot[None], int(shape.part_parent[part])
            reach = max(reach, float(np.linalg.norm(at, axis=1).max() + away))
    return reach * (1 + 1e-9)


@dataclass(frozen=True, eq=False, slots=True)
class PlanStage:
    """All sites, vehicles and distractors of a plan, in the order of the config."""

    sites: tuple[Site, ...]
    models: dict[str, Model]
    distractors: dict[str, Model]
    fleet: Fleet

    @property
    def everything(self) -> dict[str, Model]:
        """Vehicles and distractors."""
        return {**self.models, **self.distractors}


def make_stage(config: Config, assets: Assets) -> PlanStage:
    """Build every hierarchy that planning needs."""
    models = {name: _model(shape, assets.categories[name], config) for name, shape in assets.vehicles.items()}
    distractors = {
        entry.name: _model(assets.distractors[entry.name], entry.category, config)
        for entry in config.assets.distractors
    }
    return PlanStage(
        sites=tuple(_site(scenery, config.ground.fallback_z) for scenery in assets.sceneries.values()),
        models=models,
        distractors=distractors,
        fleet=Fleet([*models.values(), *distractors.values()]),
    )


def _site(scenery: Scenery, fallback_z: float) -> Site:
    world = World.of(scenery, fallback_z=fallback_z)
    ground, obstacles = world.ground, world.obstacles
    assert ground is not None
    terrain = (
        Terrain.flat(ground.z)
        if isinstance(ground, Plane)
        else Terrain(ground.mesh, caster=ground if isinstance(ground, RayCaster) else None)
    )
    surface, solid = scenery.water(), scenery.solid
    water = Terrain(surface) if surface else None
    bounds = terrain.bounds[:, :2]
    if not np.isfinite(bounds).all():
        bounds = np.array([[-_BARE_EXTENT] * 2, [_BARE_EXTENT] * 2])
        if len(obstacles.bounds):
            bounds = np.stack([obstacles.bounds[:, 0, :2].min(axis=0), obstacles.bounds[:, 1, :2].max(axis=0)])
    return Site(
        name=scenery.name,
        terrain=terrain,
        world=world,
        water=water,
        vehicle_room=Obstacles(obstacles, solid=solid),
        camera_room=CameraRoom(terrain, obstacles, solid=solid, water=water),
        bounds=bounds,
        origin=scenery.origin,
        crs=scenery.crs,
    )


def settle_rules(limits: PlacementSection) -> SettleRules:
    """The config's limits of resting poses."""
    return SettleRules(
        limits.rule,
        n=limits.footprint,
        max_slope=math.radians(limits.max_slope_deg),
        min_share=limits.min_valid_share,
        max_gap=limits.max_gap,
        max_penetration=limits.max_penetration,
    )


def _model(shape: VehicleShape, category: str | None, config: Config) -> Model:
    target, limits = VehicleTarget(shape), config.placement
    bounds = np.array([[part.hull.min(axis=0), part.hull.max(axis=0)] for part in target.parts])
    plate = np.stack([-shape.size_xyz[:2], shape.size_xyz[:2]]) / 2
    under = underside(shape.mesh, known=shape.underside) if limits.contact == "footprint" else plate
    return Model(
        shape=shape,
        category=category,
        boxes=VehicleBoxes(shape),
        target=target,
        center=shape.mesh.bounds.mean(axis=0),
        footing=Footing.of(under, settle_rules(limits)),
        corners=np.array([list(product(*corners.T)) for corners in bounds]),
        half=np.ptp(bounds, axis=1) / 2,
        part=np.array([part.index for part in target.parts]),
    )
