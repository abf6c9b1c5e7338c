"""Other vehicles beside a target: which, where, and clear of each other; one slot of all positions at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from geometry.portable import sin_cos
from placement.rejection import Rejection
from placement.settle import Settled
from planning.aiming import Views, no_views
from planning.columns import put, take
from planning.draws import Draws, Purpose, between
from planning.limits import COMPANION_TRIES
from planning.placing import clear_of_vehicle, settle_clear, unsettled
from planning.schema import Config
from planning.stage import Model, Placed, Site, articulations

_MOST = 64  # companions; a companion's number and a try's are told apart by it


@dataclass(frozen=True, eq=False, slots=True)
class Slot:
    """The j-th companions of n positions.

    Parameters
    ----------
    model
        (n,) index of each one's vehicle among the models; -1 where a position has no j-th companion.
    settled
        Of the n positions.
    articulation
        Of the n positions.
    tries
        (n,) places tried for each.
    views
        What the cameras of the m images see of them.
    """

    model: Int[np.ndarray, " n"]
    settled: Settled
    articulation: list[dict[str, float]]
    tries: Int[np.ndarray, " n"]
    views: Views

    def placed(self, models: list[Model], rows: Int[np.ndarray, " k"]) -> Placed | None:
        """The companions of some positions, whose vehicle must be the same; None where there are none."""
        if not len(rows) or self.model[rows[0]] < 0:
            return None
        articulation = [self.articulation[i] for i in rows.tolist()]
        return Placed(models[int(self.model[rows[0]])], self.settled.world_from_vehicle[rows], articulation)


class Company:
    """The companions of the n positions of a group.

    Parameters
    ----------
    site
        Where.
    models
        All vehicles; companions are drawn from them, all alike.
    config
        What is wanted.
    draws
        The plan's numbers.
    position
        (n,) the positions' numbers.
    images
        How many images they have in all.
    """

    def __init__(
        self,
        site: Site,
        models: list[Model],
        config: Config,
        *,
        draws: Draws,
        position: Int[np.ndarray, " n"],
        images: int,
    ) -> None:
        self.site, self.models, self.config, self.draws, self.position = site, models, config, draws, position
        limits = config.placement
        low, high = limits.vehicles_per_image
        n = len(position)
        size = draws.uniform(Purpose.COMPANY, position, 0, count=1)[:, 0]
        self.count = low - 1 + np.minimum((size * (high - low + 1)).astype(np.int64), high - low)
        self.slots: list[Slot] = []
        for j in range(high - 1):
            uniform = draws.uniform(Purpose.COMPANY, position, 1 + j, count=1 + _MOST)
            model = np.minimum((uniform[:, 0] * len(models)).astype(np.int64), len(models) - 1)
            model[self.count <= j] = -1
            turned: list[dict[str, float]] = [{}] * n
            for m in np.unique(model[model >= 0]) if limits.articulate else ():
                mine = np.flatnonzero(model == m)
                shape = models[m].shape
                angles = articulations(shape, uniform[mine, 1 : 1 + len(shape.part_names)])
                for i, angle in zip(mine.tolist(), angles, strict=True):
                    turned[i] = angle
            self.slots.append(Slot(model, unsettled(n), turned, np.zeros(n, dtype=np.int64), no_views(images)))

    def find_places(
        self, rows: Int[np.ndarray, " p"], target: Placed, place_try: Int[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """Settle the companions of some positions about their targets; whether all of a position's found room.

        Parameters
        ----------
        rows
            The positions.
        target
            Where their targets stand.
        place_try
            Which try of the position that was: another one gets other companions' places.
        """
        found = np.ones(len(rows), dtype=bool)
        for j, slot in enumerate(self.slots):
            for m in np.unique(slot.model[rows[found]]):
                if m >= 0:
                    mine = np.flatnonzero(found & (slot.model[rows] == m))
                    found[mine] = self._settle(j, int(m), rows[mine], target.rows(mine), place_try[mine])
        return found

    def _settle(
        self, j: int, m: int, rows: Int[np.ndarray, " p"], target: Placed, place_try: Int[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """The first try that passes, for each position; looks further ahead the longer it takes."""
        slot, limits = self.slots[j], self.config.placement
        pending, done, ahead = np.arange(len(rows)), 0, 1
        while len(pending) and done < COMPANION_TRIES:
            ahead = min(2 * ahead if done else 1, COMPANION_TRIES - done)
            one = np.repeat(pending, ahead)
            at, attempt = rows[one], done + np.tile(np.arange(ahead), len(pending))
            uniform = self.draws.uniform(
                Purpose.COMPANION, self.position[at] * _MOST + j, place_try[one] * COMPANION_TRIES + attempt, count=3
            )
            distance, bearing = between(*limits.companion_distance, uniform[:, 0]), 2.0 * math.pi * uniform[:, 1]
            xy = distance[:, None] * np.stack(sin_cos(bearing)[::-1], axis=1)
            xy += target.world_from_vehicle[one, :2, 3]
            turned = [slot.articulation[i] for i in at.tolist()]
            yaw = 2.0 * math.pi * uniform[:, 2] - math.pi
            settled = settle_clear(self.site, self.models[m], self.config, xy=xy, yaw=yaw, articulation=turned)
            good = settled.rejection == Rejection.NONE
            on = np.flatnonzero(good)
            mine = Placed(self.models[m], settled.world_from_vehicle[on], [turned[i] for i in on.tolist()])
            good[on] = self._clear_of_all(j, mine, at[on], target.rows(one[on]))
            passed = good.reshape(len(pending), ahead)
            taken, first = passed.any(axis=1), passed.argmax(axis=1)
            put(slot.settled, rows[pending[taken]], take(settled, np.flatnonzero(taken) * ahead + first[taken]))
            slot.tries[rows[pending[taken]]] = done + first[taken] + 1
            pending, done = pending[~taken], done + ahead
        found = np.ones(len(rows), dtype=bool)
        found[pending] = False
        return found

    def _clear_of_all(self, j: int, mine: Placed, at: Int[np.ndarray, " q"], target: Placed) -> Bool[np.ndarray, " q"]:
        """Clear of the target and of the companions that were settled before."""
        clearance = self.config.placement.vehicle_clearance
        clear = clear_of_vehicle(mine, target, clearance) & clear_of_vehicle(target, mine, clearance)
        for slot in self.slots[:j]:
            for m in np.unique(slot.model[at]):
                rows = np.flatnonzero(slot.model[at] == m)
                other = slot.placed(self.models, at[rows])
                if other is not None:
                    one = mine.rows(rows)
                    clear[rows] &= clear_of_vehicle(one, other, clearance) & clear_of_vehicle(other, one, clearance)
        return clear

    def together(self, rows: Int[np.ndarray, " p"]) -> list[Int[np.ndarray, " q"]]:
        """`rows` cut into runs whose positions have the same vehicles in the same slots; indices into `rows`."""
        if not self.slots:
            return [np.arange(len(rows))]
        kinds = np.stack([slot.model[rows] for slot in self.slots], axis=1)
        _, kind = np.unique(kinds, axis=0, return_inverse=True)
        order = np.argsort(kind.reshape(-1), kind="stable")
        return [part for part in np.split(order, np.flatnonzero(np.diff(kind.reshape(-1)[order])) + 1) if len(part)]

    def placed(self, rows: Int[np.ndarray, " p"]) -> list[Placed]:
        """The companions of positions of one kind (`together`)."""
        return [other for slot in self.slots if (other := slot.placed(self.models, rows)) is not None]
