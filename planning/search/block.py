"""A block of positions on one scenery that are planned together, and their instances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from hulldown.geometry.columns import take
from hulldown.geometry.indices import numbered
from hulldown.placement.settle import Settled, unsettled
from hulldown.plan.config.schema import Config
from hulldown.planning.search.budget import Positions
from hulldown.planning.search.extras import MOST_EXTRAS, Extras, Role
from hulldown.planning.search.given import Given, nothing_given
from hulldown.planning.search.instance_table import Instances, boxes_at, drawn_angles
from hulldown.planning.search.likeness import Likeness
from hulldown.planning.search.random_streams import Purpose, RandomStreams
from hulldown.planning.search.stage import PlanStage, Site


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """n positions on one scenery, with m images in all."""

    stage: PlanStage  # stage, draws: the plan's config, vehicles, and distractors, and its random numbers
    draws: RandomStreams
    site: Site
    # companions and distractors that may occur, by whether the position is of backgrounds
    extras: Mapping[bool, Sequence[Extras]]
    positions: Positions  # the n positions, ascending by number
    model: Int[np.ndarray, " n"]  # index in the fleet of the vehicle that the cameras are framed on
    movable: Bool[np.ndarray, " n"]  # whether another scenery may be tried if this one has no place
    likeness: Likeness | None = None  # the photographs that cameras follow
    given: Given | None = None  # the poses that users give of all images of the plan

    @property
    def config(self) -> Config:
        """The plan's config."""
        return self.stage.config

    @property
    def empty(self) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle that a position's images are framed on is left out."""
        return self.positions.background & self.stage.fleet.classed[self.model]

    @property
    def owner(self) -> Int[np.ndarray, " m"]:
        """The row of each image's position."""
        return numbered(self.positions.shots)[0]

    @property
    def shot(self) -> Int[np.ndarray, " m"]:
        """Number of each image at its position."""
        return numbered(self.positions.shots)[1]

    @property
    def image(self) -> Int[np.ndarray, " m"]:
        """Index of each image."""
        return self.positions.first_image[self.owner] + self.shot

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
    """The k instances of a block's positions, ordered by position, role, and number; their rows are the positions'."""

    role: Int[np.ndarray, " k"]  # role, number: role of each instance, and its number among those of this role
    number: Int[np.ndarray, " k"]
    settled: Settled  # resting poses, which share the array `world_from_vehicle`
    tries: Int[np.ndarray, " k"]  # places tried so far; an instance with a place has the last one
    found: Bool[np.ndarray, " k"]  # whether it has a place


def instances_of(block: Block) -> InstanceTable:
    """Draw targets, companions, and distractors of a block's positions; none has a place yet."""
    positions, fleet, draws = block.positions, block.stage.fleet, block.draws
    n = len(positions.number)
    turns = draws.uniform(Purpose.ARTICULATION, positions.number, 0, count=fleet.parts)
    zero, photographed, likeness = np.zeros(n, dtype=np.int64), np.full(n, -1), block.likeness
    if likeness is not None:
        sampled = likeness.sample_boxes(draws, fleet, model=block.model, image=positions.first_image)
        photographed = likeness.companion_counts(sampled)
    columns = [(np.arange(n), zero, zero, block.model, turns)]
    for background, kinds in block.extras.items():
        rows = np.flatnonzero(positions.background == background)
        for kind in kinds if len(rows) else ():
            wanted = photographed[rows] if kind.role == Role.COMPANION else np.full(len(rows), -1)
            models, numbers = kind.drawn(draws, positions.number[rows], wanted)
            i, j = np.nonzero(models >= 0)
            turned = np.zeros((len(i), fleet.parts))
            turned[:, :MOST_EXTRAS] = numbers[i, j, : fleet.parts]
            columns.append((rows[i], np.full(len(i), kind.role), j, models[i, j], turned))
    row, role, number, model, turns = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((number, role, row))
    row, role, number, model = row[order], role[order], number[order], model[order]
    angles = drawn_angles(fleet, model, turns[order]) if block.config.placement.articulate else np.zeros(turns.shape)
    k, settled = len(row), unsettled(len(row))
    center = boxes_at(fleet, model, angles).mean(axis=1)
    tries, found = np.zeros(k, dtype=np.int64), np.zeros(k, dtype=bool)
    poses = settled.world_from_vehicle
    return InstanceTable(fleet, row, model, poses, angles, center, role, number, settled, tries, found)
