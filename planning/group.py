"""Positions that share a site and a vehicle, planned together: every step is one batch over those still unsettled.

What comes out for a position depends on the config, the assets and the position's own number alone. A position's tries
are numbered, each draws its own numbers, and the first that passes everything is taken, whatever else is in the batch.
How many tries a position has is counted for it alone, and what is said when they are used up is about the first such
position: batches change when something is tried, never whether.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from geometry.errors import ConfigError
from placement.rejection import Rejection
from placement.settle import Settled
from planning.aiming import Views, no_views, try_cameras, views_of_companion
from planning.columns import put, take
from planning.company import Company
from planning.draws import Draws, Purpose
from planning.guests import Guests
from planning.labels import pixels_shown
from planning.placing import try_candidates, unsettled
from planning.rejections import AIMING, KINDS, PLACING, sentence, tally
from planning.row import rounded
from planning.schema import Config
from planning.search_limits import PLACE_TRIES
from planning.stage import Model, Placed, Site, articulations

# Candidates settled together, and cameras aimed together: what keeps a worker's memory flat.
CANDIDATES = 8192
CAMERAS = 1024
# Places that no camera can see, at one position, before it is given up on.
BLIND_PLACES = 40
# Places where companions find no room, at one position, before those without room are left out.
CROWDED_PLACES = 40
# The first positions of a plan go alone, so that a hopeless config is known in seconds.
SCOUTS = 4
BEGINNING = 256


@dataclass(frozen=True, eq=False, slots=True)
class Group:
    """What n positions with m images in all have in common, and where they differ.

    Parameters
    ----------
    site, model
        Where, and what the cameras are framed on.
    guests
        What may stand beside it.
    background, empty
        Whether the images show no target, and whether what the cameras are framed on is left out of them.
    position
        (n,) their numbers.
    shots
        (n,) images of each.
    first_image
        (n,) index of each one's first image.
    movable
        Whether a position that finds no place here may be planned elsewhere.
    """

    site: Site
    model: Model
    guests: tuple[Guests, ...]
    background: bool
    empty: bool
    position: Int[np.ndarray, " n"]
    shots: Int[np.ndarray, " n"]
    first_image: Int[np.ndarray, " n"]
    movable: bool = False

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

    def before(self, position: int) -> Group:
        """The group of those positions that come before one; they are in order."""
        n = int(np.searchsorted(self.position, position))
        return replace(self, position=self.position[:n], shots=self.shots[:n], first_image=self.first_image[:n])


@dataclass(frozen=True, eq=False, slots=True)
class Planned:
    """Poses and cameras of a group.

    Parameters
    ----------
    found
        (n,) whether a place was found; what follows is of those alone.
    settled
        Of the n positions.
    articulation
        Of the n positions.
    tries
        (n,) places tried at each position, the taken one included.
    views
        Of the m images.
    companions
        Of the n positions; those of one position share its number.
    rejected
        (m, kinds) how often each rejection was met; a position's own are with its first image.
    """

    found: Bool[np.ndarray, " n"]
    settled: Settled
    articulation: list[dict[str, float]]
    tries: Int[np.ndarray, " n"]
    views: Views
    companions: Company
    rejected: Int[np.ndarray, "m kinds"]


def plan_group(group: Group, config: Config, draws: Draws, *, visibility_m: Float[np.ndarray, " m"]) -> Planned:
    """Poses and cameras for every position of a group; `visibility_m` is that of its images, nan where it is clear.

    Raises
    ------
    HopelessPosition
        If a position of a group that is not movable finds no place, or no place with a view, within the config's
        tries: the first such position, with the counted reasons.
    """
    return _Search(group, config, draws, visibility_m).run()


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


class _Search:
    def __init__(self, group: Group, config: Config, draws: Draws, visibility_m: Float[np.ndarray, " m"]) -> None:
        self.group, self.config, self.draws, self.visibility_m = group, config, draws, visibility_m
        self.hopeless: HopelessPosition | None = None  # the first one known so far
        self.given_up = np.zeros(len(group.position), dtype=bool)
        n = len(group.position)
        self.settled, self.views = unsettled(n), no_views(len(group.image))
        self.tries = np.zeros(n, dtype=np.int64)  # of each position, so far
        self.place_rejections = np.zeros((n, KINDS), dtype=np.int64)
        self.camera_rejections = np.zeros((len(group.image), KINDS), dtype=np.int64)
        uniform = draws.uniform(Purpose.ARTICULATION, group.position, 0, count=len(group.model.shape.part_names))
        if not config.placement.articulate:
            self.articulation: list[dict[str, float]] = [{}] * n
        else:
            self.articulation = articulations(group.model.shape, uniform)
        self.company = Company(
            group.site, group.guests, config, draws=draws, position=group.position, images=len(group.image)
        )

    def run(self) -> Planned:
        everywhere = np.arange(len(self.group.position))
        scouts = SCOUTS if self.group.position.min() < BEGINNING else 0
        self._settle(everywhere[:scouts])
        self._settle(everywhere[scouts:])
        if self.hopeless and not self.group.movable:
            raise self.hopeless
        if self.company.slots:
            self._view_companions()
        rejected = self.camera_rejections
        first = np.cumsum(self.group.shots) - self.group.shots
        rejected[first] += self.place_rejections
        return Planned(~self.given_up, self.settled, self.articulation, self.tries, self.views, self.company, rejected)

    def _settle(self, pending: Int[np.ndarray, " p"]) -> None:
        """Places, companions and cameras for these positions."""
        while len(pending := self._hopeful(pending)):
            self._find_places(pending)
            pending = self._hopeful(pending)
            crowded = self.place_rejections[pending, Rejection.COMPANION] >= CROWDED_PLACES
            crowded |= 2 * self.tries[pending] >= PLACE_TRIES.highest(self.config)
            targets, tries = self._targets(pending), self.tries[pending]
            roomy = self.company.find_places(pending, targets, tries, leave_out=crowded)
            self.place_rejections[pending[~roomy], Rejection.COMPANION] += 1
            blind = self._aim(pending[roomy])
            self.place_rejections[blind, Rejection.NO_VIEW] += 1
            self._give_up_if_blind(blind)
            pending = np.union1d(pending[~roomy], blind)

    def _targets(self, rows: Int[np.ndarray, " p"]) -> Placed:
        """Where the vehicles of these positions, which may repeat, stand now."""
        articulation = [self.articulation[i] for i in rows.tolist()]
        return Placed(self.group.model, self.settled.world_from_vehicle[rows], articulation)

    def _find_places(self, pending: Int[np.ndarray, " p"]) -> None:
        """The first acceptable try, from where each position stopped; looks further ahead the longer it takes."""
        limit, ahead = int(PLACE_TRIES.highest(self.config)), 1
        self._give_up_if_placeless(pending)
        while len(pending := self._hopeful(pending)):
            now = pending[: max(1, CANDIDATES // ahead)]
            left = limit - self.tries[now]
            ahead = min(ahead, int(left.max()))
            row = np.repeat(now, ahead)
            attempt = (self.tries[now, None] + np.arange(ahead)).ravel()
            found = try_candidates(
                self.group.site,
                self.group.model,
                self.config,
                draws=self.draws,
                position=self.group.position[row],
                attempt=attempt,
                articulation=[self.articulation[i] for i in row.tolist()],
            )
            rejection = found.rejection.reshape(-1, ahead)
            allowed = np.arange(ahead) < left[:, None]
            good = allowed & (rejection == Rejection.NONE)
            taken, first = good.any(axis=1), good.argmax(axis=1)
            used = np.where(taken, first, np.minimum(left, ahead))
            before = np.arange(ahead) < used[:, None]
            at, column = np.nonzero(before)
            self.place_rejections[now] += tally(rejection[at, column].astype(np.int64), at, len(now))
            put(self.settled, now[taken], take(found, np.flatnonzero(taken) * ahead + first[taken]))
            self.tries[now] += used + taken
            self._give_up_if_placeless(now[~taken])
            pending = np.concatenate([now[~taken], pending[len(now) :]])
            ahead = min(2 * ahead, CANDIDATES // 8)

    def _aim(self, positions: Int[np.ndarray, " p"]) -> Int[np.ndarray, " q"]:
        """Cameras for all images of these positions; answers with the positions where one found none."""
        group, max_tries = self.group, self.config.camera.max_tries
        waiting = np.zeros(len(group.position), dtype=bool)
        waiting[positions] = True
        owner, image = group.owner, group.image
        pending = np.flatnonzero(waiting[owner])
        for attempt in range(max_tries):
            refused = []
            for rows in self._batches(pending):
                positions = owner[rows]
                found = try_cameras(
                    group.site,
                    self._targets(positions),
                    self.config,
                    draws=self.draws,
                    image=image[rows],
                    # Numbered through all places of the position, so that a new place gets new cameras.
                    attempt=self.tries[positions] * max_tries + attempt,
                    others=[vehicle for _, vehicle in self.company.placed(positions)],
                    visibility_m=self.visibility_m[rows],
                )
                good = found.rejection == Rejection.NONE
                put(self.views, rows[good], take(found, np.flatnonzero(good)))
                np.add.at(self.camera_rejections, (rows[~good], found.rejection[~good]), 1)
                refused.append(rows[~good])
            pending = np.concatenate(refused) if refused else pending[:0]
            if not len(pending):
                break
        return np.unique(owner[pending])

    def _batches(self, images: Int[np.ndarray, " p"]) -> Iterator[Int[np.ndarray, " q"]]:
        """These images, cut into batches whose positions have the same companions."""
        for part in self.company.together(self.group.owner[images]):
            for start in range(0, len(part), CAMERAS):
                yield images[part[start : start + CAMERAS]]

    def _view_companions(self) -> None:
        """What the cameras see of the companions, once all of both have their places."""
        owner, site = self.group.owner, self.group.site
        for rows in self._batches(np.flatnonzero(~self.given_up[owner])):
            target = [] if self.group.empty else [self._targets(owner[rows])]
            cameras = take(self.views, rows)
            beside = self.company.placed(owner[rows])
            for slot, vehicle in beside:
                others = target + [other for _, other in beside if other is not vehicle]
                seen = views_of_companion(
                    site, vehicle, others, cameras=cameras, visibility_m=self.visibility_m[rows], config=self.config
                )
                put(slot.views, rows, seen)
                if vehicle.model.category is not None:
                    slot.pixels[rows] = pixels_shown(
                        site,
                        vehicle,
                        others,
                        world_from_camera=seen.world_from_camera,
                        fov_x=seen.fov_x,
                        bbox=rounded("bbox", seen.bbox),
                        config=self.config,
                    )

    def _hopeful(self, rows: Int[np.ndarray, " p"]) -> Int[np.ndarray, " q"]:
        """Those of these positions that are not given up."""
        return rows[~self.given_up[rows]]

    def _give_up_if_placeless(self, rows: Int[np.ndarray, " p"]) -> None:
        self._give_up(
            rows[self.tries[rows] >= self.config.placement.max_tries],
            "finds no place to stand",
            PLACING,
            "widen the limits in [placement]",
        )

    def _give_up_if_blind(self, rows: Int[np.ndarray, " p"]) -> None:
        self._give_up(
            rows[self.place_rejections[rows, Rejection.NO_VIEW] >= BLIND_PLACES],
            "cannot be seen as wanted",
            AIMING,
            "widen the limits in [camera] or those of visibility in [weather], or raise camera.max_tries",
        )

    def _give_up(self, rows: Int[np.ndarray, " p"], what: str, kinds: tuple[Rejection, ...], remedy: str) -> None:
        """Give these positions up; if the first is to be reported, those after it, too, and say what was tried."""
        rows, group = self._hopeful(rows), self.group
        self.given_up[rows] = True
        if not len(rows) or group.movable:
            return
        row = int(rows.min())
        self.given_up |= group.position > group.position[row]
        counts = self.place_rejections[row] + self.camera_rejections[group.owner == row].sum(axis=0)
        position = int(group.position[row])
        self.hopeless = HopelessPosition(
            position,
            f"vehicle {group.model.shape.name!r} on scenery {group.site.name!r} {what}: "
            + sentence({kind: int(counts[kind]) for kind in kinds}),
            path=self.config.path,
            remedy=remedy,
        )
