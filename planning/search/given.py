"""Poses that users give, as arrays, and the budget of a plan with a line for each image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.plan.given_poses import GivenPoses
from hulldown.planning.inputs.poses import refused
from hulldown.planning.search.budget import Budget, Positions
from hulldown.planning.search.stage import Site


@dataclass(frozen=True, eq=False, slots=True)
class Given:
    """Given poses of n images, in the worlds of their sceneries; what isn't given is nan, and is planned."""

    xyz: Float[np.ndarray, "n 3"]  # xyz, yaw: meters and (n,) radians of the vehicles
    yaw: Float[np.ndarray, " n"]
    camera: Float[np.ndarray, "n 3"]  # camera, look_at: meters
    look_at: Float[np.ndarray, "n 3"]
    sequence: Int[np.ndarray, " n"]  # index of the first image of each image's sequence; -1 without one
    name: np.ndarray  # the sequence's; None without one

    @property
    def has_position(self) -> Bool[np.ndarray, " n"]:
        """Whether x and y of an image's vehicle are given."""
        return ~np.isnan(self.xyz[:, 0])

    @property
    def has_heading(self) -> Bool[np.ndarray, " n"]:
        """Whether the heading of an image's vehicle is given."""
        return ~np.isnan(self.yaw)

    @property
    def has_place(self) -> Bool[np.ndarray, " n"]:
        """Whether position and heading of an image's vehicle are given: every try is the same."""
        return self.has_position & self.has_heading

    @property
    def has_camera(self) -> Bool[np.ndarray, " n"]:
        """Whether the camera's place is given."""
        return ~np.isnan(self.camera[:, 0])

    @property
    def has_look_at(self) -> Bool[np.ndarray, " n"]:
        """Whether a point on the camera's optical axis is given."""
        return ~np.isnan(self.look_at[:, 0])

    @property
    def in_sequence(self) -> Bool[np.ndarray, " n"]:
        """Whether an image is part of a sequence."""
        return self.sequence >= 0


def nothing_given(n: int) -> Given:
    """Return n images without given poses."""
    points = np.full((3, n, 3), np.nan)
    return Given(points[0], points[0, :, 0].copy(), points[1], points[2], np.full(n, -1), np.full(n, None))


def given_of(poses: GivenPoses, sites: Sequence[Site], starts: Int[np.ndarray, " p"]) -> Given:
    """Return the arrays of a file's lines, given the index of each position's first line."""
    given, origins = nothing_given(len(poses.lines)), {site.name: site.origin for site in sites}
    path = Path(poses.path)
    for i, line in enumerate(poses.lines):
        origin = origins.get(line.scenery or sites[0].name)
        if origin is None:
            what = f"column scenery: {line.scenery!r:.60} is none"
            raise refused(path, line.line, what, f"they are {list(origins)}")
        if line.scenery is None and len(sites) > 1 and (line.x is not None or line.look_at is not None):
            raise refused(path, line.line, "gives coordinates but no scenery", f"name one of {list(origins)}")
        given.xyz[i] = np.array([line.x, line.y, line.z], dtype=np.float64) - origin  # None becomes nan
        given.yaw[i] = np.nan if line.yaw_deg is None else np.radians(line.yaw_deg)
        for table, point in ((given.camera, line.camera), (given.look_at, line.look_at)):
            if point is not None:
                table[i] = np.array(point) - origin
        if line.sequence is not None:
            given.sequence[i] = starts[np.searchsorted(starts, i, side="right") - 1]
            given.name[i] = line.sequence
    return given


def pose_budget(poses: GivenPoses, budget: Budget) -> Budget:
    """Return the budget of a file's lines: a position for each sequence and for each other line.

    Lines without a vehicle take the vehicles of `budget` in turn. `images` counts images without a given scenery: their
    vehicles need a place on some scenery.
    """
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
            raise refused(Path(poses.path), line.line, what, f"they are {list(index)}")
        vehicle[k], ordinal[k] = v, before[v]
        before[v] += 1
        images[v] += shots[k] if line.scenery is None else 0
    positions = Positions(np.arange(len(starts)), vehicle, ordinal, shots, starts)
    return Budget(budget.vehicles, budget.class_starts, images, positions)
