"""Other vehicles beside a target: which, where, and clear of each other; one slot of all positions at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from geometry.portable import sin_cos
from planning.draws import Draws, Purpose, between
from planning.placing import Stands, clear_of_vehicle, nowhere, stand
from planning.refusal import Refusal
from planning.schema import PlacementSection
from planning.stage import Model, Placed, Site, articulations

TRIES = 50  # places for one companion before the target is moved elsewhere
_MOST = 64  # companions; a companion's number and a try's are told apart by it


@dataclass(frozen=True, eq=False, slots=True)
class Slot:
    """The j-th companions of n positions.

    Parameters
    ----------
    model
        (n,) index of each one's vehicle among the models; -1 where a position has no j-th companion.
    stands
        Of the n positions.
    articulation
        Of the n positions.
    tries
        (n,) places tried for each.
    """

    model: Int[np.ndarray, " n"]
    stands: Stands
    articulation: list[dict[str, float]]
    tries: Int[np.ndarray, " n"]

    def placed(self, models: list[Model], rows: Int[np.ndarray, " k"]) -> Placed | None:
        """The companions of some positions, whose vehicle must be the same; None where there are none."""
        if not len(rows) or self.model[rows[0]] < 0:
            return None
        articulation = [self.articulation[i] for i in rows.tolist()]
        return Placed(models[int(self.model[rows[0]])], self.stands.world_from_vehicle[rows], articulation)


class Company:
    """The companions of the n positions of a group.

    Parameters
    ----------
    site
        Where.
    models
        All vehicles; companions are drawn from them, all alike.
    limits
        The config's.
    draws
        The plan's numbers.
    position
        (n,) the positions' numbers.
    """

    def __init__(
        self, site: Site, models: list[Model], limits: PlacementSection, draws: Draws, position: Int[np.ndarray, " n"]
    ) -> None:
        self.site, self.models, self.limits, self.draws, self.position = site, models, limits, draws, position
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
            self.slots.append(Slot(model, nowhere(n), turned, np.zeros(n, dtype=np.int64)))

    def find_places(
        self, rows: Int[np.ndarray, " p"], target: Placed, place_try: Int[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """Stand the companions of some positions about their targets; whether all of a position's found room.

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
                    found[mine] = self._stand(j, int(m), rows[mine], target.rows(mine), place_try[mine])
        return found

    def _stand(
        self, j: int, m: int, rows: Int[np.ndarray, " p"], target: Placed, place_try: Int[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """The first try that passes, for each position; looks further ahead the longer it takes."""
        slot, limits = self.slots[j], self.limits
        pending, done, ahead = np.arange(len(rows)), 0, 1
        while len(pending) and done < TRIES:
            ahead = min(2 * ahead if done else 1, TRIES - done)
            one = np.repeat(pending, ahead)
            at, attempt = rows[one], done + np.tile(np.arange(ahead), len(pending))
            uniform = self.draws.uniform(
                Purpose.COMPANION, self.position[at] * _MOST + j, place_try[one] * TRIES + attempt, count=3
            )
            distance, bearing = between(*limits.companion_distance, uniform[:, 0]), 2.0 * math.pi * uniform[:, 1]
            xy = distance[:, None] * np.stack(sin_cos(bearing)[::-1], axis=1)
            xy += target.world_from_vehicle[one, :2, 3]
            turned = [slot.articulation[i] for i in at.tolist()]
            stands = stand(self.site, self.models[m], limits, xy, 2.0 * math.pi * uniform[:, 2] - math.pi, turned)
            good = stands.refusal == Refusal.NONE
            on = np.flatnonzero(good)
            mine = Placed(self.models[m], stands.world_from_vehicle[on], [turned[i] for i in on.tolist()])
            good[on] = self._clear_of_all(j, mine, at[on], target.rows(one[on]))
            passed = good.reshape(len(pending), ahead)
            taken, first = passed.any(axis=1), passed.argmax(axis=1)
            slot.stands.put(rows[pending[taken]], stands.take(np.flatnonzero(taken) * ahead + first[taken]))
            slot.tries[rows[pending[taken]]] = done + first[taken] + 1
            pending, done = pending[~taken], done + ahead
        found = np.ones(len(rows), dtype=bool)
        found[pending] = False
        return found

    def _clear_of_all(self, j: int, mine: Placed, at: Int[np.ndarray, " q"], target: Placed) -> Bool[np.ndarray, " q"]:
        """Clear of the target and of the companions that were stood before."""
        clearance = self.limits.vehicle_clearance
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
