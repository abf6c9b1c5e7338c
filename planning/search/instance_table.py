"""The table of instances: posed vehicles of any models, each in a row such as an image, their boxes and sizes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from hulldown.annotate.boxes import Boxes
from hulldown.base.columns import put_rows
from hulldown.base.indices import matching_pairs
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import pan_center_to_pixel
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import Measure, box_length_by_measure, refine_distance, solve_distance
from hulldown.geometry.transforms import compose_affine, transform_points
from hulldown.plan.config.scene_sections import RenderSection
from hulldown.plan.row import round_field
from hulldown.planning.search.stage import Fleet, FleetModel
from hulldown.scene.posed_vehicle import PosedVehicle

# Framing turns the camera, which changes the size a little; correcting the distance changes the framing less.
SIZING_ROUNDS = 4


@dataclass(frozen=True, eq=False, slots=True)
class Instances:
    """k vehicles or distractors."""

    fleet: Fleet  # all vehicles and distractors of the plan
    row: Int[np.ndarray, " k"]  # ascending: the position, image, or view of each instance
    model: Int[np.ndarray, " k"]
    world_from_vehicle: Float[np.ndarray, "k 4 4"]
    angles: Float[np.ndarray, "k p"]  # rotations of its parts, radians; 0 for parts that a model lacks
    # center of its box with these angles, in its own frame: the mean of the row's ``bounds``
    center: Float[np.ndarray, "k 3"]

    @classmethod
    def from_poses(
        cls,
        fleet: Fleet,
        names: Sequence[str],
        world_from_vehicle: Float[np.ndarray, "k 4 4"],
        articulation: Sequence[Mapping[str, float]],
    ) -> Instances:
        """Make a table of vehicles with these names, in rows 0, 1, ..."""
        model = np.array([fleet.index[name] for name in names])
        angles = np.zeros((len(model), fleet.max_parts))
        for i, (which, of_parts) in enumerate(zip(model.tolist(), articulation, strict=True)):
            shape = fleet.models[which].shape
            angles[i, : len(shape.part_names)] = shape.angles([of_parts])[0]
        center = articulated_bounds(fleet, model, angles).mean(axis=1)
        return cls(fleet, np.arange(len(model)), model, world_from_vehicle, angles, center)

    def __len__(self) -> int:
        return len(self.row)

    def take(self, index: Int[np.ndarray, " n"]) -> Instances:
        """Return some of the instances, possibly repeated."""
        columns = (self.row, self.model, self.world_from_vehicle, self.angles, self.center)
        return Instances(self.fleet, *(column[index] for column in columns))

    def in_own_rows(self) -> Instances:
        """Return the instances in rows 0, 1, ..., so that each belongs to the camera with its index."""
        return replace(self, row=np.arange(len(self)))

    def take_rows(self, owner: Int[np.ndarray, " n"]) -> Instances:
        """Return the instances of row `owner[i]` in row i, for each i."""
        row, index = matching_pairs(owner, self.row)
        return replace(self.take(index), row=row)

    def indices_by_model(self) -> Iterator[tuple[FleetModel, Int[np.ndarray, " n"]]]:
        """Yield each model of the table, and the indices of its instances."""
        for i in np.unique(self.model).tolist():
            yield self.fleet.models[i], np.flatnonzero(self.model == i)

    def articulation(self) -> list[dict[str, float]]:
        """Return the angles of each instance by part name, radians."""
        by_part: list[dict[str, float]] = [{}] * len(self)
        for model, index in self.indices_by_model():
            names = model.shape.part_names
            for i, angles in zip(index.tolist(), self.angles[index, 1 : len(names)].tolist(), strict=True):
                by_part[i] = dict(zip(names[1:], angles, strict=True))
        return by_part

    def posed_vehicles(self) -> list[PosedVehicle]:
        """Return the instances as targets for rays, a `PosedVehicle` for each model."""
        return [
            PosedVehicle(model.caster, self.world_from_vehicle[i], self.model_angles(model, i), self.row[i])
            for model, i in self.indices_by_model()
        ]

    def model_angles(self, model: FleetModel, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n q"]:
        """Return the angles of instances of one model, for the parts that it has."""
        return self.angles[index, : len(model.shape.part_names)]

    @property
    def centers_in_world(self) -> Float[np.ndarray, "k 3"]:
        """Centers of the boxes with parts turned, in the world; distance and elevation are measured from them."""
        return transform_points(self.world_from_vehicle, self.center[:, None])[:, 0]

    def world_from_part_boxes(self) -> Float[np.ndarray, "k b 4 4"]:
        """Return the poses of the fleet's boxes of parts, which are given at rest."""
        boxes = np.empty((len(self), self.fleet.half.shape[1], 4, 4))
        for model, i in self.indices_by_model():
            turned = model.shape.vehicle_from_parts(self.model_angles(model, i))
            boxes[i] = turned[:, self.fleet.box_part[self.fleet.index[model.shape.name]]]
        return compose_affine(self.world_from_vehicle[:, None], boxes)

    def part_box_corners(self) -> Float[np.ndarray, "k c 3"]:
        """Return the corners of the posed boxes of all parts; their hull contains every vertex."""
        corners = transform_points(self.world_from_part_boxes(), self.fleet.corners[self.model])
        return corners.reshape(len(self), 8 * corners.shape[1], 3)


def articulated_bounds(
    fleet: Fleet, model: Int[np.ndarray, " k"], angles: Float[np.ndarray, "k p"]
) -> Float[np.ndarray, "k 2 3"]:
    """Return lowest and highest corner of vehicles in their own frames, with parts turned, rounded as in a plan."""
    bounds = np.empty((len(model), 2, 3))
    for i in np.unique(model).tolist():
        rows, one = np.flatnonzero(model == i), fleet.models[i]
        own = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
        points = posed_hull_vertices(one, own, angles[rows, : len(one.shape.part_names)])
        bounds[rows] = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
    return round_field("bounds", bounds)


def posed_hull_vertices(
    model: FleetModel, world_from_vehicle: Float[np.ndarray, "n 4 4"], angles: Float[np.ndarray, "n q"]
) -> Float[np.ndarray, "n h 3"]:
    """Return the posed vertices of the convex hulls of what can be seen of all parts, which determine the box."""
    poses = compose_affine(world_from_vehicle[:, None], model.shape.vehicle_from_parts(angles))
    hulls = zip(model.caster.parts, model.part_hull_vertices, strict=True)
    return np.concatenate([transform_points(poses[:, part.index], hull) for part, hull in hulls], axis=1)


def part_angles_from_uniform(
    fleet: Fleet, model: Int[np.ndarray, " k"], uniform: Float[np.ndarray, "k p"]
) -> Float[np.ndarray, "k p"]:
    """Return angles within the limits of every part i, in proportion to numbers in [0, 1), rounded as in a plan."""
    angles = np.zeros((len(model), fleet.max_parts))
    for i in np.unique(model).tolist():
        rows, shape = np.flatnonzero(model == i), fleet.models[i].shape
        (low, high), p = shape.part_limits.T, len(shape.part_names)
        turned = np.clip(low + uniform[rows, :p] * (high - low), low, high)
        angles[rows, 1:p] = round_field("articulation", turned[:, 1:])
    return angles


def image_size_by_measure(measure: Measure, render: RenderSection) -> float:
    """Return height, width, or diagonal of the image in pixels, or its area in square pixels."""
    sizes = {
        "height": render.height,
        "width": render.width,
        "diagonal": math.sqrt(render.width * render.width + render.height * render.height),
        "area": render.width * render.height,
    }
    return float(sizes[measure])


def filled_fraction(amodal: Float[np.ndarray, "n 4"], measure: Measure, render: RenderSection) -> Float[np.ndarray, " n"]:
    """Return the share of the image's height, width, diagonal, or area that these boxes fill; nan without a box."""
    size = box_length_by_measure(amodal[:, 2:], measure)
    return (size**2 if measure == "area" else size) / image_size_by_measure(measure, render)


def nan_boxes(n: int) -> Boxes:
    """Allocate n boxes of nan."""
    return Boxes(np.full((n, 4), np.nan), np.full((n, 4), np.nan), np.full(n, np.nan))


def vehicle_boxes(instances: Instances, cameras: Cameras) -> Boxes:
    """Return the boxes of n vehicles, each in its own camera."""
    boxes = nan_boxes(len(instances))
    for model, i in instances.indices_by_model():
        angles = instances.model_angles(model, i)
        put_rows(boxes, i, model.boxes.boxes(instances.world_from_vehicle[i], cameras.take(i), angles))
    return boxes


def fit_cameras_to_sizes(
    targets: Instances,
    hull: Float[np.ndarray, "n h 3"],
    *,
    lenses: Intrinsics,
    pixels: Float[np.ndarray, " n"],
    measure: Measure,
    azimuth: Float[np.ndarray, " n"],
    elevation: Float[np.ndarray, " n"],
    roll: Float[np.ndarray, " n"],
    frame: Callable[[Cameras], Cameras],
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Return framed cameras in these directions, at distances with the wanted box sizes; nan where there is none."""
    centers = targets.centers_in_world
    level = Cameras(lenses, camera_pose(centers, 1.0, azimuth, elevation))
    outward = -level.world_from_camera[:, :3, 2]

    def solved(cameras: Cameras) -> Float[np.ndarray, " n"]:
        return solve_distance(cameras, hull, center=centers, pixels=pixels, measure=measure)

    distance = solved(pan_center_to_pixel(level, lenses.center, roll))
    for _ in range(SIZING_ROUNDS):
        # Rows without a distance are kept, so that every row keeps its own random numbers.
        poses = camera_pose(centers, np.where(np.isnan(distance), 1e3, distance), azimuth, elevation)
        cameras = frame(level.with_poses(poses))
        distance = np.where(np.isnan(distance), np.nan, solved(cameras))
    if lenses.is_distorted:
        # The image of an edge is a curve, which may extend beyond its end points.
        def size(at: Float[np.ndarray, " k"], rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
            moved = cameras.take(rows)
            moved.position[:] = centers[rows] + at[:, None] * outward[rows]
            amodal = vehicle_boxes(targets.take(rows), moved).amodal
            return box_length_by_measure(amodal[:, 2:], measure)

        distance = refine_distance(size, distance, np.sqrt(pixels) if measure == "area" else pixels)
    poses = cameras.world_from_camera
    poses[:, :3, 3] = centers + distance[:, None] * outward
    return poses, distance
