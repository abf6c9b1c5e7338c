"""Poses and cameras of a block: every step is one batch over the instances or images of all its positions.

The result for a position depends only on config, assets, and the position's number. Each of its tries has its own
random numbers, and the first that meets all limits is taken. Tries are counted for each position, and an error is about
the first position without tries left. So batches decide when something is tried, but never the result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from hulldown.base.columns import join_rows, put_rows, take
from hulldown.base.errors import ConfigError
from hulldown.base.indices import index_batches, matching_pairs
from hulldown.camera.cameras import Cameras
from hulldown.placement.candidates import sample_candidates
from hulldown.placement.settle import Settled
from hulldown.plan.rejection import (
    CAMERA_REJECTIONS,
    PLACE_REJECTIONS,
    REJECTION_KINDS,
    Rejection,
    first_accepted_and_counts,
    rejection_sentence,
)
from hulldown.planning.search.likeness import QUARTER_PLACES, PhotographedPoses, companion_poses, direction_streams
from hulldown.planning.search.placing import clear_of_vehicles_mask, extra_offsets, settle_instances
from hulldown.planning.search.random_streams import Purpose, RowStreams
from hulldown.planning.search.tables import (
    MAX_ROLE_EXTRAS,
    Block,
    CameraTries,
    ExtraViews,
    InstanceRole,
    InstanceTable,
    PlaceState,
    Views,
    nan_views,
    sample_instances,
    sample_weathers,
)
from hulldown.planning.search.views import sample_lenses, views_of_camera_tries, views_of_extras_and_shown_mask
from hulldown.weather.kinds import Weather

# Candidates settled together, and cameras aimed together: they bound a worker's memory.
MAX_BATCH_PLACES = 8192
MAX_BATCH_CAMERAS = 2048
COMPANION_FOLLOWING_TRIES = 20  # over these, a companion's place moves from that in the photograph to any
MAX_EXTRA_TRIES = 50  # for one companion or distractor; then the target is moved elsewhere, or the extra is left out
# Places of a position without a camera before it's given up.
MAX_PLACES_WITHOUT_CAMERA = 40
# Places of a position without room for all extras before some of them are left out.
MAX_PLACES_WITHOUT_ROOM = 40
# A plan begins with the first positions of each vehicle, so that an impossible config fails within seconds.
EARLY_POSITIONS_PER_MODEL = 4
EARLY_POSITIONS = 256
FIRST_BATCH_TRIES = 2  # each later batch of an extra has twice as many


class HopelessPosition(ConfigError):
    """The error of a position without tries left, with the position's number."""

    def __init__(self, position: int, problem: str, *, path: Path | None, remedy: str) -> None:
        super().__init__(problem, path=path, remedy=remedy)
        self.position = position


@dataclass(frozen=True, eq=False, slots=True)
class Planned:
    """Poses and cameras of a block."""

    block: Block
    # whether the position has no place; the other attributes hold values for the other positions only
    is_abandoned: Bool[np.ndarray, " n"]
    table: InstanceTable
    views: Views  # views of the m images' targets
    extra_views: ExtraViews
    # counts of rejections; those of places are with the first image of the position
    rejected: Int[np.ndarray, "m kinds"]
    weathers: list[Weather | None]  # weather of the images; None where it is clear
    problems: Mapping[int, HopelessPosition]  # row of a position without a place -> the error that names its rejections
    # the error of the first position that isn't movable; None without one. With one, other values are incomplete.
    hopeless: HopelessPosition | None


def plan_block(block: Block) -> Planned:
    """Search for the poses and cameras of a block."""
    search, number = _BlockSearch(block), block.positions.number
    early = number.min(initial=EARLY_POSITIONS) < EARLY_POSITIONS
    ranks = np.empty(len(block.model), dtype=np.int64)
    for model in np.unique(block.model):
        of_model = np.flatnonzero(block.model == model)
        ranks[of_model] = np.arange(len(of_model))
    scouts = early & (ranks < EARLY_POSITIONS_PER_MODEL)
    search.search_positions(np.flatnonzero(scouts))
    search.search_positions(np.flatnonzero(~scouts))
    fixed = [error for row, error in search.problems.items() if not block.movable[row]]
    rejected = search.camera_rejections.copy()
    rejected[block.shot == 0] += search.place_rejections
    return Planned(
        block=block,
        is_abandoned=search.abandoned_mask,
        table=search.table,
        views=search.views,
        extra_views=search.compute_extra_views(),
        rejected=rejected,
        weathers=search.weathers,
        problems=search.problems,
        hopeless=min(fixed, key=lambda error: error.position, default=None),
    )


class _BlockSearch:
    """The state of the search in a block; `Planned` has its results."""

    def __init__(self, block: Block) -> None:
        self.block, self.config, self.draws = block, block.config, block.draws
        self.weathers = sample_weathers(block.config.weather, draws=block.draws, image=block.light_image_indices)
        self._visibility_m = np.array([weather.visibility_m if weather else np.nan for weather in self.weathers])
        self.fleet, self.number = block.stage.fleet, block.positions.number
        n = len(self.number)
        self.owner, self.image = block.position_rows, block.image
        self.problems: dict[int, HopelessPosition] = {}
        self.table = sample_instances(block)
        self.target = np.flatnonzero(self.table.role == InstanceRole.TARGET)  # the first instance of each position
        self.end = np.append(self.target[1:], len(self.table))
        self.views = nan_views(len(self.image))
        self.place_rejections = np.zeros((n, REJECTION_KINDS), dtype=np.int64)
        self.camera_rejections = np.zeros((len(self.image), REJECTION_KINDS), dtype=np.int64)

    @property
    def abandoned_mask(self) -> Bool[np.ndarray, " n"]:
        """Positions without a place or a view."""
        return self.table.state[self.target] == PlaceState.ABANDONED

    @property
    def tries(self) -> Int[np.ndarray, " n"]:
        """Places tried for each position so far."""
        return self.table.tries[self.target]

    def search_positions(self, pending: Int[np.ndarray, " p"]) -> None:
        """Find places, extras, and cameras for these positions."""
        while len(pending := self._hopeful_positions(pending)):
            self._place_targets(pending)
            pending = self._hopeful_positions(pending)
            crowded = self.place_rejections[pending, Rejection.COMPANION] >= MAX_PLACES_WITHOUT_ROOM
            crowded |= 2 * self.tries[pending] >= self.config.placement.max_tries
            roomy = self._place_extras(pending, leave_out=crowded)
            self.place_rejections[pending[~roomy], Rejection.COMPANION] += 1
            blind = self._fill_views_and_find_blind(pending[roomy])
            self.place_rejections[blind, Rejection.NO_VIEW] += 1
            self._abandon_blind_positions(blind)
            pending = np.union1d(pending[~roomy], blind)

    def _place_targets(self, pending: Int[np.ndarray, " p"]) -> None:
        """Take the next acceptable try of each position; each batch has twice as many tries."""
        limit, ahead, table = self.config.placement.max_tries, 1, self.table
        given = self.block.given_poses(self.block.positions.first_image)
        self._abandon_placeless_positions(pending)
        while len(pending := self._hopeful_positions(pending)):
            now = pending[: max(1, MAX_BATCH_PLACES // ahead)]
            left = limit - self.tries[now]
            ahead = min(ahead, int(left.max()))
            row = np.repeat(now, ahead)
            attempt = (self.tries[now, None] + np.arange(ahead)).ravel()
            rng = RowStreams(self.draws, Purpose.PLACE, self.number[row], attempt)
            xy, yaw = sample_candidates(self.block.site.bounds, len(row), rng=rng, margin=self.config.placement.margin)
            here = take(given, row)
            xy = np.where(here.has_position[:, None], here.xyz[:, :2], xy)
            yaw = np.where(here.has_heading, here.yaw, yaw)
            settled = settle_instances(
                self.block.site,
                self.table.take(self.target[row]),
                self.config.placement,
                xy=xy,
                yaw=yaw,
                upright=here.has_height,
                z=here.xyz[:, 2],
            )
            taken, chosen, counts = first_accepted_and_counts(settled.rejection.reshape(-1, ahead), left)
            self.place_rejections[now] += counts
            put_rows(table.settled, self.target[now[taken]], take(settled, chosen))
            table.state[self.target[now[taken]]] = PlaceState.PLACED
            table.tries[self.target[now]] += counts.sum(axis=1) + taken
            # Further tries at a given place would fail, too.
            table.tries[self.target[now[~taken & given.has_place[now]]]] = limit
            self._abandon_placeless_positions(now[~taken])
            pending = np.concatenate([now[~taken], pending[len(now) :]])
            ahead = min(2 * ahead, MAX_BATCH_PLACES // 8)

    def _place_extras(self, positions: Int[np.ndarray, " p"], *, leave_out: Bool[np.ndarray, " p"]) -> Bool[np.ndarray, " p"]:
        """Place the extras of these positions by their first clear try, and return which positions are settled.

        Without room for an extra, a position isn't settled, unless `leave_out`: then the extra is left out.
        """
        table = self.table
        extras = np.flatnonzero(np.isin(table.row, positions) & table.is_extra)
        table.state[extras] = PlaceState.PENDING  # extras that were left out at another place are tried again
        photographed = self._photographed_companion_poses(extras)
        roomy = np.ones(len(positions), dtype=bool)
        extra = self.target[positions] + 1  # the next extra of each position
        while (pending := roomy & (extra < self.end[positions])).any():
            placed = self._place_one_extra_each(extra[pending], photographed)
            table.state[extra[pending][~placed & leave_out[pending]]] = PlaceState.LEFT_OUT
            roomy[pending] = placed | leave_out[pending]
            extra += 1
        return roomy

    def _place_one_extra_each(self, extras: Int[np.ndarray, " q"], photographed: PhotographedPoses) -> Bool[np.ndarray, " q"]:
        """Place at most one extra of each position, in batches that double their tries; return which have a place."""
        table, pending, done, ahead = self.table, extras, 0, FIRST_BATCH_TRIES
        while len(pending) and done < MAX_EXTRA_TRIES:
            ahead = min(ahead, MAX_EXTRA_TRIES - done)
            tried = np.repeat(pending, ahead)
            attempt = done + np.tile(np.arange(ahead), len(pending))
            settled = self._settle_extras(tried, attempt, photographed)
            stands = np.flatnonzero(settled.rejection == Rejection.NONE)
            clear = self._clear_of_others_mask(tried[stands], take(settled, stands))
            settled.rejection[stands[~clear]] = Rejection.VEHICLE
            taken, chosen, _ = first_accepted_and_counts(settled.rejection.reshape(-1, ahead))
            put_rows(table.settled, pending[taken], take(settled, chosen))
            table.tries[pending[taken]], table.state[pending[taken]] = attempt[chosen] + 1, PlaceState.PLACED
            pending, done, ahead = pending[~taken], done + ahead, 2 * ahead
        return table.is_placed[extras]

    def _photographed_companion_poses(self, extras: Int[np.ndarray, " q"]) -> PhotographedPoses:
        """Return where the photographs of the positions' first images show these companions."""
        table, likeness, k = self.table, self.block.likeness, len(self.table)
        poses = PhotographedPoses(np.zeros((k, 3)), np.zeros(k, dtype=bool))
        extras = extras[table.role[extras] == InstanceRole.COMPANION]
        if likeness is None or not len(extras):
            return poses
        row = table.row[extras]
        image, attempt = self.block.positions.first_image[row], self.tries[row] * self.config.camera.max_tries
        targets = self.table.take(self.target[row])
        first = RowStreams(self.draws, Purpose.CAMERA, image, attempt).random((len(row), 3))
        shown = companion_poses(
            likeness,
            targets,
            self.table.take(extras),
            likeness.sample_target_boxes(self.draws, targets, image=image, attempt=attempt, quarter=np.zeros_like(row)),
            number=table.rank_in_role[extras],
            lenses=sample_lenses(self.config.intrinsics, self.config.camera.fov_x_deg, first[:, 0]),
            rng=direction_streams(self.draws, image, attempt),
        )
        put_rows(poses, extras, shown)
        return poses

    def _settle_extras(
        self, which: Int[np.ndarray, " q"], attempt: Int[np.ndarray, " q"], photographed: PhotographedPoses
    ) -> Settled:
        """Settle tries of extras around targets, from the photograph's places to random ones as tries go on."""
        table, limits, tries = self.table, self.config.placement, []
        for batch in index_batches(len(which), MAX_BATCH_PLACES):
            extras = which[batch]
            role, row = table.role[extras], table.row[extras]
            uniform = self.draws.uniform(
                np.where(role == InstanceRole.COMPANION, Purpose.COMPANION, Purpose.DISTRACTOR),
                self.number[row] * MAX_ROLE_EXTRAS + table.rank_in_role[extras],
                # All places of the target count, so that every place has new random numbers.
                self.tries[row] * MAX_EXTRA_TRIES + attempt[batch],
                count=3,
            )
            yaw = 2.0 * math.pi * uniform[:, 2] - math.pi
            pose = np.column_stack([extra_offsets(role, limits, uniform[:, :2]), yaw])
            anywhere = np.minimum(attempt[batch] / COMPANION_FOLLOWING_TRIES, 1.0)[:, None]
            shown = take(photographed, extras)
            pose = np.where(shown.is_shown[:, None], shown.xy_yaw + anywhere * (pose - shown.xy_yaw), pose)
            xy, yaw = pose[:, :2] + table.world_from_vehicle[self.target[row], :2, 3], pose[:, 2]
            tries.append(settle_instances(self.block.site, self.table.take(extras), limits, xy=xy, yaw=yaw))
        return join_rows(tries)

    def _clear_of_others_mask(self, which: Int[np.ndarray, " q"], settled: Settled) -> Bool[np.ndarray, " q"]:
        tried = replace(self.table.take(which), world_from_vehicle=settled.world_from_vehicle)
        standing = self.table.take(np.flatnonzero(self.table.is_placed))
        of_tried, of_standing = matching_pairs(tried.row, standing.row)
        clear = np.ones(len(which), dtype=bool)
        apart = clear_of_vehicles_mask(
            tried.take(of_tried), standing.take(of_standing), self.config.placement.vehicle_clearance
        )
        clear[of_tried[~apart]] = False
        return clear

    def _fill_views_and_find_blind(self, positions: Int[np.ndarray, " p"]) -> Int[np.ndarray, " q"]:
        """Find cameras for all images of these positions; return the positions with an image without one."""
        max_tries = self.config.camera.max_tries
        extras = self.table.take(np.flatnonzero(self.table.is_placed & self.table.is_extra))
        blind = self.place_rejections[:, Rejection.NO_VIEW] // QUARTER_PLACES
        pending, done, ahead = np.flatnonzero(np.isin(self.owner, positions)), 0, 1
        while len(pending) and done < max_tries:
            ahead = min(ahead, max_tries - done)
            now = np.repeat(pending, ahead)
            attempt, views = done + np.tile(np.arange(ahead), len(pending)), []
            for batch in index_batches(len(now), MAX_BATCH_CAMERAS):
                rows, owner = now[batch], self.owner[now[batch]]
                tries = CameraTries(
                    self.table.take(self.target[owner]),
                    extras.take_rows(owner),
                    self.block.given_poses(self.image[rows]),
                    self.image[rows],
                    # The number counts all places of the position, so that every place has new cameras.
                    attempt=self.tries[owner] * max_tries + attempt[batch],
                    quarter=np.maximum(4 * attempt[batch] // max_tries, blind[owner]),
                    visibility_m=self._visibility_m[rows],
                )
                views.append(views_of_camera_tries(self.block, tries))
            tried = join_rows(views)
            taken, chosen, counts = first_accepted_and_counts(tried.rejection.reshape(-1, ahead))
            put_rows(self.views, pending[taken], take(tried, chosen))
            self.camera_rejections[pending] += counts
            pending, done = pending[~taken], done + ahead
            ahead = max(1, min(2 * ahead, MAX_BATCH_CAMERAS // max(len(pending), 1)))
        return np.unique(self.owner[pending])

    def compute_extra_views(self) -> ExtraViews:
        """Return the cameras' views of the extras."""
        table, shown = self.table, np.flatnonzero(~self.abandoned_mask[self.owner])
        present = np.flatnonzero(table.is_placed & (table.is_extra | ~self.block.empty[table.row]))
        extras = np.flatnonzero(table.is_placed & table.is_extra)
        pair, of = matching_pairs(self.owner[shown], table.row[extras])
        image, instance = shown[pair], extras[of]
        seen, standing = [], self.table.take(present)
        for batch in index_batches(len(image), MAX_BATCH_CAMERAS):
            row, which = matching_pairs(self.owner[image[batch]], standing.row)
            others = replace(standing.take(which), row=row)
            not_itself = np.flatnonzero(present[which] != instance[batch][others.row])
            views = take(self.views, image[batch])
            views, pixels = views_of_extras_and_shown_mask(
                self.block.site,
                self.table.take(instance[batch]).in_own_rows(),
                others.take(not_itself),
                views=views,
                cameras=Cameras(self.config.intrinsics(views.fov_x_deg), views.world_from_camera),
                visibility_m=self._visibility_m[image[batch]],
                rays=self.config.camera.visibility_rays,
            )
            seen.append(ExtraViews(image[batch], instance[batch], views, pixels))
        return join_rows(seen)

    def _hopeful_positions(self, rows: Int[np.ndarray, " p"]) -> Int[np.ndarray, " q"]:
        return rows[~self.abandoned_mask[rows]]

    def _abandon_placeless_positions(self, rows: Int[np.ndarray, " p"]) -> None:
        self._abandon_positions(
            rows[self.tries[rows] >= self.config.placement.max_tries],
            "finds no place to stand",
            PLACE_REJECTIONS,
            "widen the limits in [placement]",
        )

    def _abandon_blind_positions(self, rows: Int[np.ndarray, " p"]) -> None:
        self._abandon_positions(
            rows[self.place_rejections[rows, Rejection.NO_VIEW] >= MAX_PLACES_WITHOUT_CAMERA],
            "cannot be seen as wanted",
            CAMERA_REJECTIONS,
            "widen the limits in [camera] or those of visibility in [weather], or raise camera.max_tries",
        )

    def _abandon_positions(self, rows: Int[np.ndarray, " p"], what: str, kinds: tuple[Rejection, ...], remedy: str) -> None:
        """Give up these positions, and all after the first of them that isn't movable."""
        rows, block = self._hopeful_positions(rows), self.block
        given = block.given_poses(block.positions.first_image)
        self.table.state[np.isin(self.table.row, rows)] = PlaceState.ABANDONED
        for row in rows.tolist():
            counts = self.place_rejections[row] + self.camera_rejections[self.owner == row].sum(axis=0)
            model, position = self.fleet.models[block.model[row]], int(self.number[row])
            found = [kind for kind in kinds if counts[kind]]
            one = given.has_place[row] and len(found) == 1 and found[0] in PLACE_REJECTIONS  # all tries are equal
            self.problems[row] = HopelessPosition(
                position,
                f"vehicle {model.shape.name!r} on scenery {block.site.name!r} {what}: "
                + (
                    f"all tries at its given place {found[0].phrase}"
                    if one
                    else rejection_sentence({kind: int(counts[kind]) for kind in kinds})
                ),
                path=self.config.path,
                remedy=remedy,
            )
            if not block.movable[row]:
                self.table.state[self.number[self.table.row] > position] = PlaceState.ABANDONED
