"""Positions on one scenery that are planned together: what they hold, their instances, and what is found for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.geometry.errors import ConfigError
from hulldown.placement.settle import Settled, unsettled
from hulldown.planning.config.schema import Config
from hulldown.planning.search.aiming import Views
from hulldown.planning.search.columns import take
from hulldown.planning.search.draws import Purpose, RandomStreams
from hulldown.planning.search.extras import MOST, Extras, Role
from hulldown.planning.search.given import Given, nothing_given
from hulldown.planning.search.instances import drawn_angles
from hulldown.planning.search.likeness import Likeness
from hulldown.planning.search.stage import Fleet, Site


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """n positions on one scenery, with m images in all.

    Parameters
    ----------
    site, fleet
        Where, and what there is.
    extras
        What may stand beside targets, and what at backgrounds.
    model
        (n,) what the cameras are framed on: an index in the fleet.
    background, empty
        (n,) whether the images show no target, and whether what the cameras are framed on is left out of them.
    movable
        (n,) whether a position that finds no place here may be planned elsewhere.
    position
        (n,) their numbers, ascending.
    shots
        (n,) images of each.
    first_image
        (n,) index of each one's first image.
    likeness
        The photographs that cameras follow, if any.
    given
        What users give of all images of the plan, if any.
    """

    site: Site
    fleet: Fleet
    extras: dict[bool, tuple[Extras, ...]]
    model: Int[np.ndarray, " n"]
    background: Bool[np.ndarray, " n"]
    empty: Bool[np.ndarray, " n"]
    movable: Bool[np.ndarray, " n"]
    position: Int[np.ndarray, " n"]
    shots: Int[np.ndarray, " n"]
    first_image: Int[np.ndarray, " n"]
    likeness: Likeness | None = None
    given: Given | None = None

    @property
    def owner(self) -> Int[np.ndarray, " m"]:
        """For each image the row of its position."""
        return np.repeat(np.arange(len(self.position)), self.shots)

    @property
    def shot(self) -> Int[np.ndarray, " m"]:
        """For each image its number at its position."""
        return np.arange(int(self.shots.sum())) - np.repeat(np.cumsum(self.shots) - self.shots, self.shots)

    @property
    def image(self) -> Int[np.ndarray, " m"]:
        """Index of each image."""
        return self.first_image[self.owner] + self.shot

    @property
    def scene(self) -> Int[np.ndarray, " m"]:
        """Index of the image that each one has its light, weather, and lens of: of a sequence's first."""
        sequence = self.given_of(self.image).sequence
        return np.where(sequence >= 0, sequence, self.image)

    def given_of(self, image: Int[np.ndarray, " k"]) -> Given:
        """What is given of the images with these indices."""
        return nothing_given(len(image)) if self.given is None else take(self.given, image)


def before(block: Block, position: int) -> Block:
    """The block of those positions that come before one."""
    n = int(np.searchsorted(block.position, position))
    columns = ("model", "background", "empty", "movable", "position", "shots", "first_image")
    return replace(block, **{name: getattr(block, name)[:n] for name in columns})


@dataclass(frozen=True, eq=False, slots=True)
class InstanceTable:
    """The k instances of a block's positions, ordered by position, role and number.

    Parameters
    ----------
    row
        (k,) the position's row in the block.
    role, number
        (k,) what each is, and the how manieth of its role.
    model, angles
        (k,) index in the fleet, (k, p) radians of its parts.
    distance
        (k, 2) least and largest distance of an extra from its target, meters.
    settled
        (k,) where each stands.
    tries
        (k,) places tried so far; of those found the last one is theirs.
    found
        (k,) whether it has a place.
    """

    row: Int[np.ndarray, " k"]
    role: Int[np.ndarray, " k"]
    number: Int[np.ndarray, " k"]
    model: Int[np.ndarray, " k"]
    angles: Float[np.ndarray, "k p"]
    distance: Float[np.ndarray, "k 2"]
    settled: Settled
    tries: Int[np.ndarray, " k"]
    found: Bool[np.ndarray, " k"]


def instances_of(block: Block, config: Config, draws: RandomStreams) -> InstanceTable:
    """What stands at a block's positions, as it is drawn, without places."""
    n, fleet = len(block.position), block.fleet
    turns = draws.uniform(Purpose.ARTICULATION, block.position, 0, count=fleet.parts)
    zero, photographed, likeness = np.zeros(n, dtype=np.int64), np.full(n, -1), block.likeness
    if likeness is not None:
        photographed = likeness.companions(likeness.sampled(draws, fleet, model=block.model, image=block.first_image))
    columns = [(np.arange(n), zero, zero, block.model, turns, np.zeros((n, 2)))]
    for background, kinds in block.extras.items():
        rows = np.flatnonzero(block.background == background)
        for kind in kinds if len(rows) else ():
            wanted = photographed[rows] if kind.role == Role.COMPANION else np.full(len(rows), -1)
            models, numbers = kind.drawn(draws, block.position[rows], wanted)
            i, j = np.nonzero(models >= 0)
            turned = np.zeros((len(i), fleet.parts))
            turned[:, :MOST] = numbers[i, j, : fleet.parts]
            distance = np.tile(np.array(kind.distance, dtype=np.float64), (len(i), 1))
            columns.append((rows[i], np.full(len(i), kind.role), j, models[i, j], turned, distance))
    row, role, number, model, turns, distance = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((number, role, row))
    row, role, number, model = row[order], role[order], number[order], model[order]
    angles = drawn_angles(fleet, model, turns[order]) if config.placement.articulate else np.zeros(turns.shape)
    k = len(row)
    return InstanceTable(
        row, role, number, model, angles, distance[order], unsettled(k), np.zeros(k, dtype=np.int64), np.zeros(k, bool)
    )


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """What cameras see of extras, p pairs of an image and an extra in it, by image and then by instance.

    Parameters
    ----------
    image, instance
        (p,) rows of the block's images and of its table.
    views
        Of the p pairs.
    pixels
        (p,) whether those that have a class are at the center of any pixel.
    """

    image: Int[np.ndarray, " p"]
    instance: Int[np.ndarray, " p"]
    views: Views
    pixels: Bool[np.ndarray, " p"]


@dataclass(frozen=True, eq=False, slots=True)
class Planned:
    """Poses and cameras of a block.

    Parameters
    ----------
    found
        (n,) whether a place was found; what follows is of those alone.
    instances
        Targets and extras of the n positions; what found no room is not found.
    views
        Of the m images' targets.
    seen
        What the images show of extras.
    rejected
        (m, kinds) how often each rejection was met; a position's own are with its first image.
    problems
        Row of a position without a place -> what was tried.
    """

    found: Bool[np.ndarray, " n"]
    instances: InstanceTable
    views: Views
    seen: Seen
    rejected: Int[np.ndarray, "m kinds"]
    problems: dict[int, HopelessPosition]


class HopelessPosition(ConfigError):
    """A position for which the config's tries are used up.

    Parameters
    ----------
    position
        Its number.
    problem, path, remedy
        As of any `ConfigError`.
    """

    def __init__(self, position: int, problem: str, *, path: Path | None, remedy: str) -> None:
        super().__init__(problem, path=path, remedy=remedy)
        self.position = position
