"""Cameras that show their targets at sizes and places by the config, before they're checked (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.camera.framing import frame_target, turned
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import draw_azimuth, draw_elevation, shell_axes, shell_place
from hulldown.geometry.columns import take
from hulldown.geometry.transforms import rigid
from hulldown.planning.config.schema import Config
from hulldown.planning.plan.row import rounded
from hulldown.planning.search.block import Block
from hulldown.planning.search.given import Given
from hulldown.planning.search.instance_table import Instances, hull_of
from hulldown.planning.search.likeness import Wishes
from hulldown.planning.search.matching_cameras import directions_of, matching_cameras
from hulldown.planning.search.random_streams import Purpose, RowStreams, between
from hulldown.planning.search.sizing import image_size, sized_cameras

NEAREST = 1e-6  # least meters from a target's center to a given camera, which keeps the direction defined


@dataclass(frozen=True, eq=False, slots=True)
class Tries:
    """n tries of cameras; row i of every field is try i."""

    targets: Instances  # targets, others: the targets, and the vehicles beside them, by `Instances.row`
    others: Instances
    given: Given  # poses given by the user
    image: Int[np.ndarray, " n"]  # image, attempt: index of each image, and number of its try
    attempt: Int[np.ndarray, " n"]
    quarter: Int[np.ndarray, " n"]  # 0 to 3: how many quarters of an image's tries are used up; see `Likeness.wishes`
    visibility_m: Float[np.ndarray, " n"]  # meters; nan in clear air

    @property
    def free(self) -> Bool[np.ndarray, " n"]:
        """Whether the camera's place isn't given."""
        return np.isnan(self.given.camera[:, 0])

    @property
    def undirected(self) -> Bool[np.ndarray, " n"]:
        """Whether neither the camera's place nor the point that it looks at is given."""
        return self.free & np.isnan(self.given.look_at[:, 0])


@dataclass(frozen=True, eq=False, slots=True)
class Aims:
    """Cameras of n tries before they're checked: sampled lenses and directions, and solved distances."""

    intrinsics: Intrinsics  # one camera's or n intrinsics
    roll: Float[np.ndarray, " n"]  # about the optical axis, radians
    # distance, azimuth, elevation: place around the target's center in meters and radians; nan: no distance gives the
    # size
    distance: Float[np.ndarray, " n"]
    azimuth: Float[np.ndarray, " n"]
    elevation: Float[np.ndarray, " n"]
    fraction: Float[np.ndarray, " n"]  # share of the image that the target should fill
    wishes: Wishes | None  # the boxes of photographs; None without photographs
    follows: Bool[np.ndarray, " n"]  # whether the camera follows such a box
    # framed poses with the wanted sizes; nan for given cameras, and for distances by the paper's rule
    sized: Float[np.ndarray, "n 4 4"]


def aims_of(block: Block, tries: Tries) -> Aims:
    """Sample the cameras of tries, and solve for their distances."""
    config, draws, likeness = block.config, block.draws, block.likeness
    n, limits, targets, free = len(tries.image), config.camera, tries.targets, tries.free
    rng = RowStreams(draws, Purpose.CAMERA, tries.image, tries.attempt)
    uniform = rng.random((n, 3))
    together = tries.given.sequence >= 0
    of_sequence = draws.uniform(Purpose.SEQUENCE, np.maximum(tries.given.sequence, 0), 0, count=2)
    uniform[:, 0] = np.where(together, of_sequence[:, 0], uniform[:, 0])
    intrinsics, fraction = sampled_intrinsics(config, uniform[:, 0]), between(*limits.target_fraction, uniform[:, 1])
    azimuth = draw_azimuth(n, rng=rng)
    elevation_bounds = (math.radians(limits.elevation_deg[0]), math.radians(limits.elevation_deg[1]))
    elevation = draw_elevation(n, elevation_bounds, rng=rng, uniform_in=limits.elevation_sampling)
    turn = np.where(together, of_sequence[:, 1], rng.random((n, 1))[:, 0])
    roll = np.radians(between(*limits.roll_deg, turn))

    wishes, follows = None, np.zeros(n, dtype=bool)
    if likeness is not None:
        wishes = likeness.wishes(draws, targets, image=tries.image, attempt=tries.attempt, quarter=tries.quarter)
        follows = tries.undirected & (wishes.box >= 0)
    measure = limits.size_measure
    sized, distance = np.full((n, 4, 4), np.nan), np.full(n, np.nan)
    if measure == "paper":
        smallest = targets.fleet.size.min(axis=1)[targets.model]
        distance = intrinsics.distance_for(smallest, fraction)
        distance *= between(*limits.distance_factor, uniform[:, 2])
    else:
        for model, i in targets.by_model():
            i = i[free[i] & ~follows[i]]
            sized[i], distance[i] = sized_cameras(
                targets.take(i),
                hull_of(model, targets.world_from_vehicle[i], targets.model_angles(model, i)),
                intrinsics=intrinsics.rows(i),
                pixels=fraction[i] * image_size(measure, config.render),
                measure=measure,
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                framed=partial(framed, block, tries, rows=i, intrinsics=intrinsics, roll=roll),
            )
    if wishes is not None:
        i = np.flatnonzero(follows)
        sized[i], distance[i] = matching_cameras(
            targets.take(i),
            take(wishes, i),
            config,
            intrinsics=intrinsics.rows(i),
            roll=roll[i],
            rng=directions_of(draws, tries.image[i], tries.attempt[i]),
        )
    place = shell_place(tries.given.camera - targets.centers)
    return Aims(
        intrinsics=intrinsics,
        roll=roll,
        distance=np.where(free, distance, np.maximum(place[0], NEAREST)),
        azimuth=np.where(free, azimuth, place[1]),
        elevation=np.where(free, elevation, place[2]),
        fraction=fraction,
        wishes=wishes,
        follows=follows,
        sized=sized,
    )


def framed(
    block: Block,
    tries: Tries,
    poses: Float[np.ndarray, "k 4 4"],
    *,
    rows: Int[np.ndarray, " k"],
    intrinsics: Intrinsics,
    roll: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "k 4 4"]:
    """Turn cameras so that their targets are in frame, or to the given points."""
    limits = block.config.camera
    intrinsics, roll = intrinsics.rows(rows), roll[rows]
    aimed = frame_target(
        poses,
        tries.targets.take(rows).corners(),
        intrinsics,
        roll=roll,
        rng=RowStreams(block.draws, Purpose.FRAMING, tries.image[rows], tries.attempt[rows]),
        spread=limits.framing,
        truncated=limits.truncated_fraction,
    )
    points = tries.given.look_at[rows]
    at = np.flatnonzero(~np.isnan(points[:, 0]))
    position, own = poses[at, :3, 3], intrinsics.rows(at)
    axes = shell_axes(*shell_place(position - points[at])[1:])[1]
    aimed[at] = turned(rigid(axes, position), own, own.center, roll[at])
    return aimed


def sampled_intrinsics(config: Config, uniform: Float[np.ndarray, " n"]) -> Intrinsics:
    """Return the calibrated camera, or n cameras with fields of view in proportion to numbers in [0, 1)."""
    return config.intrinsics(rounded("fov_x_deg", between(*config.camera.fov_x_deg, uniform)))
