"""Numbers of images per vehicle and position: exact and balanced.

A class's images go to its models by turns and weights, a model's images to its positions in order. Positions of
different classes alternate, and those of backgrounds are spread evenly between them, so that any beginning of the plan
is as balanced as the whole.

Paper, equation 1 (I = V * I_p * P_v) and section 2.1.8 (a number of images per class, by round robin over its models).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.errors import ConfigError
from hulldown.base.indices import group_and_rank
from hulldown.plan.config.scene_sections import BudgetSection
from hulldown.plan.given_poses import GivenPoses
from hulldown.planning.inputs.poses import pose_line_error
from hulldown.planning.search.stage import Site

SHARE_ROUNDING = 1e-9  # rounding error of the shares of a class's images


@dataclass(frozen=True, eq=False, slots=True)
class Positions:
    """The vehicles and images of n positions."""

    number: Int[np.ndarray, " n"]
    vehicle: Int[np.ndarray, " n"]  # index into `Budget.vehicles`; -1 for backgrounds
    ordinal: Int[np.ndarray, " n"]  # number of earlier positions of this vehicle, or of backgrounds
    shots: Int[np.ndarray, " n"]  # shots, first_image: number of images, at least 1, and the index of the first of them
    first_image: Int[np.ndarray, " n"]

    @property
    def background(self) -> Bool[np.ndarray, " n"]:
        """Whether a position's images are backgrounds."""
        return self.vehicle < 0


@dataclass(frozen=True, eq=False, slots=True)
class Budget:
    """The number of images of every vehicle, and the positions of a plan."""

    vehicles: tuple[str, ...]  # names, grouped by class, in the order of the config
    class_starts: Int[np.ndarray, " c_plus_1"]  # index in `vehicles` of each class's first, and their number
    # images of each vehicle; within a class of equal weights they don't increase, and differ by at most 1
    images: Int[np.ndarray, " v"]
    positions: Positions  # all positions, in the order of the plan

    @property
    def n_images(self) -> int:
        """The number of all images."""
        return int(self.positions.shots.sum())

    @property
    def n_planned_positions(self) -> int:
        """The number of all positions."""
        return len(self.positions.shots)


def make_budget(
    section: BudgetSection, categories: Mapping[str, str], weights: Mapping[str, float] = MappingProxyType({})
) -> Budget:
    """Return the budget of a config, given the class of each vehicle in the order of the config."""
    classes = tuple(dict.fromkeys(categories.values()))
    members = {c: [v for v, category in categories.items() if category == c] for c in classes}
    wanted = section.images_per_class
    if isinstance(wanted, dict):
        if unknown := sorted(set(wanted) - set(classes)):
            raise ConfigError(
                f"budget.images_per_class: no vehicle has the class {unknown[0]!r}", remedy=f"classes are {list(classes)}"
            )
        if lacking := [c for c in classes if c not in wanted]:
            raise ConfigError(
                f"budget.images_per_class: no number for the class {lacking[0]!r}", remedy="give it one; 0 is allowed"
            )
    images: list[int] = []
    for c in classes:
        weight = np.array([weights.get(v, 1.0) for v in members[c]])
        if wanted is None:
            of_each = np.rint((section.positions_per_vehicle or 0) * weight) * section.images_per_position
        else:
            quota = wanted[c] if isinstance(wanted, dict) else wanted
            if quota and not weight.any():
                raise ConfigError(f"assets.vehicles: all of class {c!r} have weight 0", remedy="give one a weight above 0")
            share = quota * weight / max(weight.sum(), 1e-300)
            of_each = np.floor(share + SHARE_ROUNDING)
            # The largest remainders get the rest.
            rest = np.argsort(np.rint((of_each - share) / SHARE_ROUNDING), kind="stable")[: quota - int(of_each.sum())]
            of_each[rest] += 1
        images += of_each.astype(np.int64).tolist()
    if not sum(images):
        raise ConfigError("budget: no image would be made", remedy="ask for at least one")
    class_starts = np.cumsum([0, *(len(members[c]) for c in classes)])
    counts = np.array(images, dtype=np.int64)
    backgrounds = round(sum(images) * section.background_share / (1.0 - section.background_share))
    positions = _plan_positions(counts, class_starts, backgrounds, section.images_per_position)
    return Budget(tuple(v for c in classes for v in members[c]), class_starts, counts, positions)


def _plan_positions(
    images: Int[np.ndarray, " v"], class_starts: Int[np.ndarray, " c_plus_1"], backgrounds: int, most: int
) -> Positions:
    """Return positions with up to `most` images each: those of vehicles by turns, and backgrounds between them."""
    counts, starts = np.append(images, backgrounds), np.append(class_starts, len(images) + 1)  # backgrounds come last
    vehicle, ordinal = group_and_rank(-(-counts // most))
    of_class = np.searchsorted(starts, vehicle, side="right") - 1
    # Each vehicle's positions are spread evenly over its class's turns.
    by_turn = np.lexsort((vehicle, (ordinal + 0.5) / -(-counts // most)[vehicle], of_class))
    turn = np.empty(len(vehicle), dtype=np.int64)
    turn[by_turn] = group_and_rank(np.bincount(of_class, minlength=len(starts)))[1]
    empty, n = vehicle == len(images), len(vehicle)
    background = np.diff(np.arange(n + 1) * np.count_nonzero(empty) // n) > 0
    order = np.empty(n, dtype=np.int64)
    order[np.argsort(background, kind="stable")] = np.lexsort((of_class, turn, empty))
    vehicle, ordinal = vehicle[order], ordinal[order]
    shots = np.minimum(counts[vehicle] - ordinal * most, most)
    return Positions(np.arange(n), np.where(background, -1, vehicle), ordinal, shots, np.cumsum(shots) - shots)


@dataclass(frozen=True, eq=False, slots=True)
class Given:
    """Given poses of n images in their sceneries' worlds; missing values are 0 and will be planned."""

    xyz: Float[np.ndarray, "n 3"]  # xyz, yaw: meters and (n,) radians of the vehicles
    yaw: Float[np.ndarray, " n"]
    camera: Float[np.ndarray, "n 3"]  # camera, look_at: meters
    look_at: Float[np.ndarray, "n 3"]
    first: Int[np.ndarray, " n"]  # index of the first image of each image's sequence
    name: np.ndarray  # name of the sequence; None without one
    has_position: Bool[np.ndarray, " n"]  # whether x and y of the vehicle are given
    has_height: Bool[np.ndarray, " n"]  # whether z of the vehicle is given
    has_heading: Bool[np.ndarray, " n"]
    has_camera: Bool[np.ndarray, " n"]  # whether the camera's place is given
    has_look_at: Bool[np.ndarray, " n"]  # whether a point on the camera's optical axis is given
    in_sequence: Bool[np.ndarray, " n"]

    @property
    def has_place(self) -> Bool[np.ndarray, " n"]:
        """Whether position and heading of an image's vehicle are given, so that every try is the same."""
        return self.has_position & self.has_heading

    @property
    def has_view(self) -> Bool[np.ndarray, " n"]:
        """Whether the camera's place or direction is given, so that it follows no photograph."""
        return self.has_camera | self.has_look_at


def empty_given_poses(n: int) -> Given:
    """Return the `Given` of n images without given poses."""
    points = np.zeros((3, n, 3))
    return Given(
        points[0], np.zeros(n), points[1], points[2], np.zeros(n, dtype=np.int64), np.full(n, None),
        *np.zeros((6, n), dtype=bool),
    )  # fmt: skip


def given_pose_arrays(poses: GivenPoses, sites: Sequence[Site], starts: Int[np.ndarray, " p"]) -> Given:
    """Return the arrays of a file's lines, given the index of each position's first line."""
    given, origins = empty_given_poses(len(poses.lines)), {site.name: site.origin for site in sites}
    path = Path(poses.path)
    for i, line in enumerate(poses.lines):
        origin = origins.get(line.scenery or sites[0].name)
        if origin is None:
            what = f"column scenery: {line.scenery!r:.60} is none"
            raise pose_line_error(path, line.line, what, f"they are {list(origins)}")
        if line.scenery is None and len(sites) > 1 and (line.x is not None or line.look_at is not None):
            raise pose_line_error(path, line.line, "gives coordinates but no scenery", f"name one of {list(origins)}")
        if line.x is not None and line.y is not None:
            given.xyz[i, :2], given.has_position[i] = np.array([line.x, line.y]) - origin[:2], True
        if line.z is not None:
            given.xyz[i, 2], given.has_height[i] = line.z - origin[2], True
        if line.yaw_deg is not None:
            given.yaw[i], given.has_heading[i] = np.radians(line.yaw_deg), True
        if line.camera is not None:
            given.camera[i], given.has_camera[i] = np.array(line.camera) - origin, True
        if line.look_at is not None:
            given.look_at[i], given.has_look_at[i] = np.array(line.look_at) - origin, True
        if line.sequence is not None:
            given.first[i] = starts[np.searchsorted(starts, i, side="right") - 1]
            given.name[i], given.in_sequence[i] = line.sequence, True
    return given


def pose_budget(poses: GivenPoses, budget: Budget) -> Budget:
    """Return the budget of a file's lines, a position per sequence or single line; missing vehicles go by turns."""
    names = [line.sequence for line in poses.lines]
    starts = np.array([i for i, name in enumerate(names) if not i or name is None or name != names[i - 1]])
    shots = np.diff(np.append(starts, len(names)))
    index = {name: v for v, name in enumerate(budget.vehicles)}
    turns, turn = np.flatnonzero(budget.images > 0), 0
    vehicle, ordinal = np.zeros(len(starts), dtype=np.int64), np.zeros(len(starts), dtype=np.int64)
    images, before = np.zeros(len(index), dtype=np.int64), np.zeros(len(index), dtype=np.int64)
    for k, start in enumerate(starts.tolist()):
        line = poses.lines[start]
        if line.vehicle is None:
            v, turn = int(turns[turn % len(turns)]), turn + 1
        elif line.vehicle in index:
            v = index[line.vehicle]
        else:
            what = f"column vehicle: {line.vehicle!r:.60} is none"
            raise pose_line_error(Path(poses.path), line.line, what, f"they are {list(index)}")
        vehicle[k], ordinal[k] = v, before[v]
        before[v] += 1
        images[v] += shots[k] if line.scenery is None else 0
    positions = Positions(np.arange(len(starts)), vehicle, ordinal, shots, starts)
    return Budget(budget.vehicles, budget.class_starts, images, positions)
