"""What the planner asks its questions to: terrain, obstacles and boxes of every asset, built once per process."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from annotate.boxes import VehicleBoxes
from assets.library import Assets
from assets.scenery import Scenery
from assets.vehicle import VehicleShape
from camera.clearance import CameraRoom
from camera.target import PosedVehicle, VehicleTarget
from camera.world import Plane, World
from geometry.transforms import apply, compose, rigid
from placement.clearance import Extent, Obstacles
from placement.footprint import Underside, underside
from placement.terrain import Terrain
from planning.row import rounded
from planning.schema import Config

_BARE_EXTENT = 50.0  # metres to each side of the origin, where a scenery has neither ground nor obstacles


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
    """

    name: str
    terrain: Terrain
    world: World
    water: Terrain | None
    vehicle_room: Obstacles
    camera_room: CameraRoom
    bounds: Float[np.ndarray, "2 2"]


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
    centre
        (3,) centre of its bounding box, vehicle frame.
    undersides
        What meets the ground, by the choices of `placement.contact`: the underside, or a plate as large as the box.
    corners
        (b, 8, 3) corners of the bounding boxes of its parts at rest, vehicle frame.
    extents
        (b,) those boxes, as tests of clearance take them.
    corner_part
        (b,) the parts they belong to.
    """

    shape: VehicleShape
    category: str | None
    boxes: VehicleBoxes
    target: VehicleTarget
    centre: Float[np.ndarray, "3"]
    undersides: dict[str, Underside | Float[np.ndarray, "2 2"]]
    corners: Float[np.ndarray, "b 8 3"]
    extents: tuple[Extent, ...]
    corner_part: Int[np.ndarray, " b"]

    @property
    def smallest(self) -> float:
        """The bounding box's smallest dimension: S of equation 6."""
        return float(self.shape.size_xyz.min())


@dataclass(frozen=True, eq=False, slots=True)
class Placed:
    """One vehicle in n poses, each with its own articulation.

    Parameters
    ----------
    model
        The vehicle.
    world_from_vehicle
        (n, 4, 4) rigid poses.
    articulation
        n of them: part name -> radians.
    """

    model: Model
    world_from_vehicle: Float[np.ndarray, "n 4 4"]
    articulation: list[dict[str, float]]

    def rows(self, index: Int[np.ndarray, " k"]) -> Placed:
        """Some of the poses."""
        articulation = [self.articulation[i] for i in index.tolist()]
        return Placed(self.model, self.world_from_vehicle[index], articulation)

    @property
    def posed(self) -> PosedVehicle:
        """The same as something that rays meet."""
        return PosedVehicle(self.model.target, self.world_from_vehicle, self.articulation)

    @property
    def centres(self) -> Float[np.ndarray, "n 3"]:
        """Centres of the bounding boxes, in the world."""
        return apply(self.world_from_vehicle, self.model.centre[None])[:, 0]

    def corners(self) -> Float[np.ndarray, "n k 3"]:
        """Corners of the boxes of all parts, turned and placed: no vertex of the vehicle is outside their hull."""
        corners = apply(self.world_from_parts(), self.model.corners)
        return corners.reshape(len(corners), 8 * len(self.model.corners), 3)

    def hull(self) -> Float[np.ndarray, "n k 3"]:
        """Vertices of the convex hulls of all parts, turned and placed: any projected box is theirs."""
        poses = self.world_from_parts()
        return np.concatenate([apply(poses[:, i], part.hull) for i, part in enumerate(self.model.target.parts)], axis=1)

    def bounds(self) -> Float[np.ndarray, "n 2 3"]:
        """Lowest and highest corner of each, in the vehicle's own frame with its parts turned."""
        at_home = np.broadcast_to(np.eye(4), self.world_from_vehicle.shape)
        points = Placed(self.model, at_home, self.articulation).hull()
        return np.stack([points.min(axis=1), points.max(axis=1)], axis=1)

    def world_from_parts(self) -> Float[np.ndarray, "n b 4 4"]:
        """Where each part at rest goes."""
        vehicle_from_parts = self.model.shape.vehicle_from_parts(self.articulation)[:, self.model.corner_part]
        return compose(self.world_from_vehicle[:, None], vehicle_from_parts)


@dataclass(frozen=True, eq=False, slots=True)
class PlanStage:
    """All sites, vehicles and distractors of a plan, in the order of the config."""

    sites: tuple[Site, ...]
    models: dict[str, Model]
    distractors: dict[str, Model]

    @property
    def everything(self) -> dict[str, Model]:
        """Vehicles and distractors."""
        return {**self.models, **self.distractors}


def make_stage(config: Config, assets: Assets) -> PlanStage:
    """Build every hierarchy that planning needs."""
    return PlanStage(
        sites=tuple(_site(scenery, config.ground.fallback_z) for scenery in assets.sceneries.values()),
        models={name: _model(shape, assets.categories[name]) for name, shape in assets.vehicles.items()},
        distractors={
            entry.name: _model(assets.distractors[entry.name], entry.category) for entry in config.assets.distractors
        },
    )


def _site(scenery: Scenery, fallback_z: float) -> Site:
    world = World.of(scenery, fallback_z=fallback_z)
    ground, obstacles = world.ground, world.obstacles
    assert ground is not None
    terrain = Terrain.flat(ground.z) if isinstance(ground, Plane) else Terrain(ground.mesh)
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
    )


def _model(shape: VehicleShape, category: str | None) -> Model:
    target = VehicleTarget(shape)
    bounds = [np.stack([part.hull.min(axis=0), part.hull.max(axis=0)]) for part in target.parts]
    return Model(
        shape=shape,
        category=category,
        boxes=VehicleBoxes(shape),
        target=target,
        centre=shape.mesh.bounds.mean(axis=0),
        undersides={
            "footprint": underside(shape.mesh),
            "box": np.stack([-shape.size_xyz[:2], shape.size_xyz[:2]]) / 2,
        },
        corners=np.array([list(product(*corners.T)) for corners in bounds]),
        extents=tuple(Extent((high - low)[None] / 2, rigid(np.eye(3), (low + high)[None] / 2)) for low, high in bounds),
        corner_part=np.array([part.index for part in target.parts]),
    )


def articulations(shape: VehicleShape, uniform: Float[np.ndarray, "n p"]) -> list[dict[str, float]]:
    """Angles within every part's limits, in proportion to numbers in [0, 1), one column a part."""
    low, high = shape.part_limits[:, 0], shape.part_limits[:, 1]
    angles = rounded("articulation", np.clip(low + uniform * (high - low), low, high)[:, 1:])
    return [dict(zip(shape.part_names[1:], row, strict=True)) for row in angles.tolist()]
