"""Plan any run of positions, in blocks by scenery; row i depends only on config, assets, and i."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool

from hulldown.assets.plan_assets import Assets
from hulldown.base.columns import take
from hulldown.base.errors import ConfigError
from hulldown.dataset.photographs import Photographs, read_photographs
from hulldown.plan.config.schema import Config
from hulldown.plan.given_poses import GivenPoses
from hulldown.plan.row import Row, encode_rows
from hulldown.planning.appearance import hdri_weights
from hulldown.planning.block_rows import block_rows
from hulldown.planning.search.budget import Positions, given_pose_arrays, make_budget, pose_budget
from hulldown.planning.search.likeness import Likeness
from hulldown.planning.search.pairs import Pairs, try_vehicle_scenery_pairs
from hulldown.planning.search.positions import HopelessPosition, plan_block
from hulldown.planning.search.random_streams import Purpose, RandomStreams, choose_weighted_indices
from hulldown.planning.search.stage import make_stage
from hulldown.planning.search.tables import Block, choose_target_models, scenery_extras_by_background

POSITIONS_PER_BLOCK = 2048  # gives large batches for each vehicle and scenery


class Planner:
    """Plans any run of positions; each process builds one."""

    def __init__(
        self,
        config: Config,
        assets: Assets,
        *,
        strict: bool = False,
        pairs: Pairs | None = None,
        poses: GivenPoses | None = None,
        photographs: Photographs | None = None,
    ) -> None:
        self.config, self.assets, self.photographs = config, assets, photographs
        if photographs is None and config.camera.like is not None:
            self.photographs = read_photographs(config.folder / config.camera.like)
        weights = {str(entry.name): entry.weight for entry in config.assets.vehicles}
        self.budget = make_budget(config.budget, {name: assets.categories[name] for name in assets.vehicles}, weights)
        if poses is not None:
            self.budget = pose_budget(poses, self.budget)
        self._draws = RandomStreams(config.seed)
        self._hdri_weights = hdri_weights(config.light, assets.hdris)
        self.stage = make_stage(config, assets)
        self.likeness = None if self.photographs is None else Likeness(self.photographs, config)
        self.strict = strict
        self.pairs = pairs or try_vehicle_scenery_pairs(self.stage, self.budget, self._draws, strict=strict)
        vehicles = [self.budget.vehicles.index(name) for name in assets.vehicles]
        present = (self.pairs.weights[vehicles] > 0.0) * np.array([[weights.get(v, 1.0)] for v in assets.vehicles])
        self._extras = [
            scenery_extras_by_background(site, self.stage, present[:, s]) for s, site in enumerate(self.stage.sites)
        ]
        self.poses = poses
        self.given = None if poses is None else given_pose_arrays(poses, self.stage.sites, self.budget.positions.first_image)

    def rows(self, start: int, stop: int) -> list[Row]:
        """Return all rows of the positions from `start` to before `stop`, in order."""
        positions = take(self.budget.positions, np.arange(start, stop))
        number = positions.number
        weights = np.where(positions.background[:, None], self.pairs.sites, self.pairs.weights[positions.vehicle])
        if self.poses is not None:
            for k, line in enumerate(self.poses.lines[i] for i in positions.first_image.tolist()):
                if line.scenery is not None:
                    weights[k] = [float(site.name == line.scenery) for site in self.stage.sites]
        rows: list[Row] = []
        hopeless: HopelessPosition | None = None
        pending, attempt = np.arange(len(number)), 0
        while len(pending):
            uniform = self._draws.uniform(Purpose.SCENERY, number[pending], attempt, count=1)[:, 0]
            site = choose_weighted_indices(weights[pending], uniform)
            weights[pending, site] = 0.0
            # A position without a place on its scenery tries the others.
            homeless = [pending[:0]]
            for s in np.unique(site).tolist():
                here = pending[site == s]
                if hopeless:
                    here = here[number[here] < hopeless.position]
                if not len(here):
                    continue
                movable = weights[here].any(axis=1) & (not self.strict)
                planned = plan_block(self._make_block(s, take(positions, here), movable))
                if planned.hopeless:
                    # Another block may hold an earlier one: the error must not depend on blocks.
                    hopeless = planned.hopeless
                    continue
                rows += block_rows(planned, self.assets, hdri_weights=self._hdri_weights)
                homeless.append(here[planned.is_abandoned])
            pending, attempt = np.sort(np.concatenate(homeless)), attempt + 1
        if hopeless:
            place, path = f"position {hopeless.position}", hopeless.path
            if self.poses is not None:
                first = int(self.budget.positions.first_image[hopeless.position])
                place, path = f"line {self.poses.lines[first].line}", Path(self.poses.path)
            raise ConfigError(f"{place}: {hopeless.problem}", path=path, remedy=hopeless.remedy)
        rows.sort(key=lambda row: row.index)
        return rows

    def _make_block(self, site: int, positions: Positions, movable: Bool[np.ndarray, " n"]) -> Block:
        """Return positions on a scenery, of which the movable ones have others left."""
        stage, draws, scenery = self.stage, self._draws, self.stage.sites[site]
        model = choose_target_models(self.budget, stage, draws, positions=positions, site=scenery)
        extras = self._extras[site]
        return Block(stage, draws, scenery, extras, positions, model, movable, self.likeness, self.given)

    def lines(self, start: int, stop: int) -> tuple[bytes, int]:
        """Return the rows of `rows` as lines of a plan file, and their number."""
        rows = self.rows(start, stop)
        return encode_rows(rows), len(rows)
