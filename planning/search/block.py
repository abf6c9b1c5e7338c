"""A block of positions on one scenery that are planned together, and their instances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from hulldown.geometry.arrays import numbered
from hulldown.placement.settle import Settled, unsettled
from hulldown.planning.config.schema import Config
from hulldown.planning.search.columns import take
from hulldown.planning.search.draws import Purpose, RandomStreams
from hulldown.planning.search.extras import MOST, Extras, Role
from hulldown.planning.search.given import Given, nothing_given
from hulldown.planning.search.instances import Instances, drawn_angles
from hulldown.planning.search.likeness import Likeness
from hulldown.planning.search.stage import Fleet, Site


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """n positions on one scenery, with m images in all.

    Parameters
    ----------
    config, draws
        The plan's config and random numbers.
    site, fleet
        The scenery, and all vehicles and distractors of the plan.
    extras
        Companions and distractors that may occur, by whether the position is of backgrounds.
    model
        (n,) index in the fleet of the vehicle that the cameras are framed on.
    background, empty
        (n,) whether the images show no target, and whether the vehicle that they are framed on is left out.
    movable
        (n,) whether another scenery may be tried if this one has no place.
    position, shots, first_image
        (n,) ascending number of each position, its number of images, and the index of the first of them.
    likeness
        The photographs that cameras follow.
    given
        The poses that users give of all images of the plan.
    """

    config: Config
    draws: RandomStreams
    site: Site
    fleet: Fleet
    extras: Mapping[bool, tuple[Extras, ...]]
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
        """The row of each image's position."""
        return numbered(self.shots)[0]

    @property
    def shot(self) -> Int[np.ndarray, " m"]:
        """Number of each image at its position."""
        return numbered(self.shots)[1]

    @property
    def image(self) -> Int[np.ndarray, " m"]:
        """Index of each image."""
        owner, shot = numbered(self.shots)
        return self.first_image[owner] + shot

    @property
    def scene(self) -> Int[np.ndarray, " m"]:
        """Index of the image whose light, weather, and lens each image shares: the first of its sequence, or itself."""
        sequence = self.given_of(self.image).sequence
        return np.where(sequence >= 0, sequence, self.image)

    def given_of(self, image: Int[np.ndarray, " k"]) -> Given:
        """Return the given poses of the images with these indices."""
        return nothing_given(len(image)) if self.given is None else take(self.given, image)


@dataclass(frozen=True, eq=False, slots=True)
class InstanceTable(Instances):
    """The k instances of a block's positions, ordered by position, role, and number; their rows are the positions'.

    Parameters
    ----------
    role, number
        (k,) role of each instance, and its number among those of this role.
    settled
        (k,) resting poses, which share the array `world_from_vehicle`.
    tries
        (k,) places tried so far; an instance with a place has the last one.
    found
        (k,) whether it has a place.
    """

    role: Int[np.ndarray, " k"]
    number: Int[np.ndarray, " k"]
    settled: Settled
    tries: Int[np.ndarray, " k"]
    found: Bool[np.ndarray, " k"]


def instances_of(block: Block) -> InstanceTable:
    """Draw targets, companions, and distractors of a block's positions; none has a place yet."""
    n, fleet, draws = len(block.position), block.fleet, block.draws
    turns = draws.uniform(Purpose.ARTICULATION, block.position, 0, count=fleet.parts)
    zero, photographed, likeness = np.zeros(n, dtype=np.int64), np.full(n, -1), block.likeness
    if likeness is not None:
        photographed = likeness.companions(likeness.sampled(draws, fleet, model=block.model, image=block.first_image))
    columns = [(np.arange(n), zero, zero, block.model, turns)]
    for background, kinds in block.extras.items():
        rows = np.flatnonzero(block.background == background)
        for kind in kinds if len(rows) else ():
            wanted = photographed[rows] if kind.role == Role.COMPANION else np.full(len(rows), -1)
            models, numbers = kind.drawn(draws, block.position[rows], wanted)
            i, j = np.nonzero(models >= 0)
            turned = np.zeros((len(i), fleet.parts))
            turned[:, :MOST] = numbers[i, j, : fleet.parts]
            columns.append((rows[i], np.full(len(i), kind.role), j, models[i, j], turned))
    row, role, number, model, turns = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((number, role, row))
    row, role, number, model = row[order], role[order], number[order], model[order]
    angles = drawn_angles(fleet, model, turns[order]) if block.config.placement.articulate else np.zeros(turns.shape)
    k, settled = len(row), unsettled(len(row))
    tries, found = np.zeros(k, dtype=np.int64), np.zeros(k, dtype=bool)
    return InstanceTable(fleet, row, model, settled.world_from_vehicle, angles, role, number, settled, tries, found)
