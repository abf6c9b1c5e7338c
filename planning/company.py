"""Companions and distractors beside a target: where, and clear of each other; one slot of all positions at a time."""

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
from planning.draws import Draws
from planning.guests import MOST, Guests
from planning.placing import clear_of_vehicle, settle_clear, unsettled
from planning.schema import Config
from planning.search_limits import COMPANION_TRIES
from planning.stage import Placed, Site, articulations


@dataclass(frozen=True, eq=False, slots=True)
class Slot:
    """The j-th guests of one kind at n positions.

    Parameters
    ----------
    guests
        Their kind.
    number
        j.
    model
        (n,) index of each one's model among `guests.models`; -1 where a position has no j-th guest.
    settled
        Of the n positions.
    articulation
        Of the n positions.
    tries
        (n,) places tried for each.
    views
        What the cameras of the m images see of them.
    pixels
        (m,) whether those that have a class are at the centre of any pixel.
    """

    guests: Guests
    number: int
    model: Int[np.ndarray, " n"]
    settled: Settled
    articulation: list[dict[str, float]]
    tries: Int[np.ndarray, " n"]
    views: Views
    pixels: Bool[np.ndarray, " m"]

    def placed(self, rows: Int[np.ndarray, " k"]) -> Placed:
        """The guests of some positions, which must have one, and the same model."""
        articulation = [self.articulation[i] for i in rows.tolist()]
        model = self.guests.models[int(self.model[rows[0]])]
        return Placed(model, self.settled.world_from_vehicle[rows], articulation)


class Company:
    """The companions and distractors of the n positions of a group.

    Parameters
    ----------
    site
        Where.
    guests
        What they are drawn from; the first kind is placed first.
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
        guests: tuple[Guests, ...],
        config: Config,
        *,
        draws: Draws,
        position: Int[np.ndarray, " n"],
        images: int,
    ) -> None:
        self.site, self.config, self.draws, self.position = site, config, draws, position
        n = len(position)
        self.slots: list[Slot] = []
        for kind in guests:
            models, turns = kind.drawn(draws, position)
            for j in range(models.shape[1]):
                model = models[:, j]
                turned: list[dict[str, float]] = [{}] * n
                for m in np.unique(model[model >= 0]) if config.placement.articulate else ():
                    mine = np.flatnonzero(model == m)
                    shape = kind.models[m].shape
                    angles = articulations(shape, turns[mine, j, : len(shape.part_names)])
                    for i, angle in zip(mine.tolist(), angles, strict=True):
                        turned[i] = angle
                slot = Slot(
                    guests=kind,
                    number=j,
                    model=model,
                    settled=unsettled(n),
                    articulation=turned,
                    tries=np.zeros(n, dtype=np.int64),
                    views=no_views(images),
                    pixels=np.zeros(images, dtype=bool),
                )
                self.slots.append(slot)
        self._drawn = [slot.model.copy() for slot in self.slots]

    @property
    def left_out(self) -> Int[np.ndarray, " n"]:
        """Guests of each position that found no room and are left out."""
        out = np.zeros(len(self.position), dtype=np.int64)
        for slot, drawn in zip(self.slots, self._drawn, strict=True):
            out += slot.model != drawn
        return out

    def find_places(
        self,
        rows: Int[np.ndarray, " p"],
        target: Placed,
        place_try: Int[np.ndarray, " p"],
        *,
        leave_out: Bool[np.ndarray, " p"],
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
        leave_out
            Whether companions without room are left out of a position, which then is one where all found room.
        """
        for slot, drawn in zip(self.slots, self._drawn, strict=True):
            slot.model[rows] = drawn[rows]  # what was left out at another place gets its chance here
        found = np.ones(len(rows), dtype=bool)
        for j, slot in enumerate(self.slots):
            for m in np.unique(slot.model[rows[found]]):
                if m >= 0:
                    mine = np.flatnonzero(found & (slot.model[rows] == m))
                    roomy = self._settle(j, int(m), rows[mine], target.rows(mine), place_try[mine])
                    slot.model[rows[mine[~roomy & leave_out[mine]]]] = -1
                    found[mine] = roomy | leave_out[mine]
        return found

    def _settle(
        self, j: int, m: int, rows: Int[np.ndarray, " p"], target: Placed, place_try: Int[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """The first try that passes, for each position; looks further ahead the longer it takes."""
        slot = self.slots[j]
        guests, model = slot.guests, slot.guests.models[m]
        pending, done, ahead = np.arange(len(rows)), 0, 1
        while len(pending) and done < COMPANION_TRIES:
            ahead = min(2 * ahead if done else 1, COMPANION_TRIES - done)
            one = np.repeat(pending, ahead)
            at, attempt = rows[one], done + np.tile(np.arange(ahead), len(pending))
            item, attempt = self.position[at] * MOST + slot.number, place_try[one] * COMPANION_TRIES + attempt
            uniform = self.draws.uniform(guests.place, item, attempt, count=3)
            distance, bearing = guests.distances(uniform[:, 0]), 2.0 * math.pi * uniform[:, 1]
            xy = distance[:, None] * np.stack(sin_cos(bearing)[::-1], axis=1)
            xy += target.world_from_vehicle[one, :2, 3]
            turned = [slot.articulation[i] for i in at.tolist()]
            yaw = 2.0 * math.pi * uniform[:, 2] - math.pi
            settled = settle_clear(self.site, model, self.config, xy=xy, yaw=yaw, articulation=turned)
            good = settled.rejection == Rejection.NONE
            on = np.flatnonzero(good)
            mine = Placed(model, settled.world_from_vehicle[on], [turned[i] for i in on.tolist()])
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
            for m in np.unique(slot.model[at][slot.model[at] >= 0]):
                rows = np.flatnonzero(slot.model[at] == m)
                one, other = mine.rows(rows), slot.placed(at[rows])
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

    def placed(self, rows: Int[np.ndarray, " p"]) -> list[tuple[Slot, Placed]]:
        """The guests of positions of one kind (`together`), each with its slot."""
        return [(slot, slot.placed(rows)) for slot in self.slots if len(rows) and slot.model[rows[0]] >= 0]
