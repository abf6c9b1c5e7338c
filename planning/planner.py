"""A whole dataset as rows: every position planned, in blocks, by one process or several, in order.

Row i depends on the config, the assets and i alone. Blocks, workers and restarts only decide who computes it when.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from assets.library import Assets
from geometry.errors import ConfigError
from planning.budget import make_budget
from planning.draws import Draws, Purpose, choose
from planning.group import Group, HopelessPosition, plan_group
from planning.guests import framed_on, guests_at
from planning.light import draw_lights, hdri_weights
from planning.row import Row, encode_rows
from planning.rows import rows_of
from planning.schema import Config
from planning.stage import make_stage

BLOCK = 2048  # positions planned together: enough of each vehicle and site that batches are worth their overhead


class Planner:
    """Plans any run of positions; built once per process.

    Parameters
    ----------
    config
        What is wanted.
    assets
        What there is.

    Raises
    ------
    ConfigError
        If the config asks for classes or HDRIs that are not there.
    """

    def __init__(self, config: Config, assets: Assets) -> None:
        self.config, self.assets = config, assets
        self.budget = make_budget(config.budget, {name: assets.categories[name] for name in assets.vehicles})
        self._draws = Draws(config.seed)
        self._hdri_weights = hdri_weights(config.light, assets.hdris)
        self._stage = make_stage(config, assets)
        weights = {entry.name: entry.weight for entry in config.assets.sceneries}
        self._site_weights = [weights.get(name, 1.0) for name in assets.sceneries]

    def rows(self, start: int, stop: int) -> list[Row]:
        """All rows of the positions from `start` to before `stop`, in order.

        Raises
        ------
        ConfigError
            If the config cannot be met: about the first of these positions for which it cannot.
        """
        position = np.arange(start, stop)
        held = self.budget.positions(position)
        site = choose(self._site_weights, self._draws.uniform(Purpose.SCENERY, position, 0, count=1)[:, 0])
        sites = [self._stage.sites[s].name for s in site.tolist()]
        framed = framed_on(
            self.budget, self._stage, self.config, self._draws, position=position, held=held, sites=sites
        )
        kinds: dict[tuple[int, str, bool], list[int]] = {}
        for i, kind in enumerate(zip(site.tolist(), framed, held.background.tolist(), strict=True)):
            kinds.setdefault(kind, []).append(i)
        rows: list[Row] = []
        hopeless: HopelessPosition | None = None
        for (s, name, background), indices in kinds.items():
            mine = np.array(indices)
            if hopeless:
                mine = mine[position[mine] < hopeless.position]
            if not len(mine):
                continue
            model = self._stage.everything[name]
            group = Group(
                site=self._stage.sites[s],
                model=model,
                guests=guests_at(self._stage.sites[s].name, self._stage, self.config, background=background),
                background=background,
                empty=background and model.category is not None,
                position=position[mine],
                shots=held.shots[mine],
                first_image=held.first_image[mine],
            )
            try:
                planned = plan_group(group, self.config, self._draws)
            except HopelessPosition as error:
                # Another group may hold an earlier one: what is said does not depend on how the work is cut.
                hopeless = error
                continue
            lights = draw_lights(
                self.config.light, self.config.weather, self._hdri_weights, draws=self._draws, image=group.image
            )
            rows += rows_of(group, planned, lights, self.config, self.assets.hdris)
        if hopeless:
            raise ConfigError(hopeless.problem, path=hopeless.path, remedy=hopeless.remedy)
        rows.sort(key=lambda row: row.index)
        return rows

    def lines(self, start: int, stop: int) -> tuple[bytes, int]:
        """The same as lines of a plan file, and their number."""
        rows = self.rows(start, stop)
        return encode_rows(rows), len(rows)


def plan(config: Config, assets: Assets) -> Iterator[Row]:
    """Rows of the whole plan, in order, with the numbers that `plan.jsonl` holds.

    Parameters
    ----------
    config
        What is wanted.
    assets
        What there is.

    Raises
    ------
    ConfigError
        If the config cannot be met: with the counted reasons.
    """
    planner = Planner(config, assets)
    for start in range(0, planner.budget.n_positions, BLOCK):
        yield from planner.rows(start, min(start + BLOCK, planner.budget.n_positions))
