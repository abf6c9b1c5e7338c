"""Every limit of a plan, recomputed from the poses in its rows: what `hulldown check` says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from itertools import islice

import numpy as np

from assets.library import Assets
from planning.config import parse_config
from planning.limit import Limit
from planning.limits import LIMITS
from planning.plan_file import Plan
from planning.recomputed import Recomputed
from planning.row import Row
from planning.schema import Config
from planning.source import Source

ROWS = 2048  # checked together
MOST = 1000  # findings that are listed
BACKGROUNDS = ""  # stands for the vehicle where their images are counted


def check_plan(plan: Plan, assets: Assets, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """What in a plan breaks a limit of its own config, or is not what follows from its poses.

    Parameters
    ----------
    plan
        The plan.
    assets
        Those it was made from.
    progress
        Called with images checked and their number.

    Returns
    -------
    One line for each finding; nothing if all is well.

    Raises
    ------
    ConfigError
        If a line of the plan is damaged.
    """
    return check_rows(plan, Source.of(parse_config(plan.header.config, path=plan.path), assets), progress=progress)


def check_rows(plan: Plan, source: Source, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """The same of a plan whose assets are ready; many plans of one config share them.

    Parameters
    ----------
    plan
        The plan.
    source
        What it was made from.
    progress
        See `check_plan`.
    """
    checker = _Checker(source)
    rows = iter(plan)
    done = 0
    while some := list(islice(rows, ROWS)):
        checker.look_at(some)
        done += len(some)
        if progress:
            progress(done, len(plan))
    checker.look_at_counts(len(plan))
    more = len(checker.findings) - MOST
    return checker.findings[:MOST] + ([f"and {more:,} more"] if more > 0 else [])


class _Checker:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.sites = {site.name: site for site in source.stage.sites}
        self.findings: list[str] = []
        self.images: Counter[str] = Counter()
        self.first_shot: Row | None = None

    def look_at(self, rows: list[Row]) -> None:
        """Every limit of some consecutive rows."""
        groups: dict[tuple[str, ...], list[tuple[Row, Row]]] = {}
        for row in rows:
            if not self._names_are_known(row):
                continue
            self.images[BACKGROUNDS if row.background else row.vehicle] += 1
            if self.first_shot is None or row.shot == 0:
                self.first_shot = row
            kinds = (f"background {row.background}", f"{len(row.companions)} companions")
            key = (row.scenery, *kinds, *(vehicle.vehicle for vehicle in row.planned))
            groups.setdefault(key, []).append((row, self.first_shot))
        for (scenery, *_), pairs in groups.items():
            mine, first_shots = ([pair[i] for pair in pairs] for i in (0, 1))
            for k in range(len(mine[0].planned)):
                found = Recomputed(self.source, self.sites[scenery], mine, first_shots=first_shots, vehicle=k)
                for limit in LIMITS:
                    if limit.of in ("vehicle", found.kind) or (limit.of == "image" and k == 0):
                        self.findings += broken(limit, found, self.source.config)

    def look_at_counts(self, images: int) -> None:
        """Whether every vehicle has the images that the budget gives it."""
        budget = self.source.budget
        if images != budget.n_images:
            self.findings.append(f"{images} images, the budget is {budget.n_images}")
        if (found := self.images[BACKGROUNDS]) != budget.backgrounds:
            self.findings.append(f"{found} backgrounds, their budget is {budget.backgrounds}")
        for vehicle, n in zip(budget.vehicles, budget.images.tolist(), strict=True):
            if self.images[vehicle] != n:
                self.findings.append(f"vehicle {vehicle!r}: {self.images[vehicle]} images, its budget is {n}")

    def _names_are_known(self, row: Row) -> bool:
        stage = self.source.stage
        named: list[tuple[str, str, Collection[str]]] = [
            ("vehicle", row.vehicle, stage.everything if row.background else stage.models),
            ("scenery", row.scenery, self.sites),
            ("hdri", row.hdri, self.source.hdri_weights),
            *(("vehicle", vehicle.vehicle, stage.models) for vehicle in row.companions),
            *(("distractor", vehicle.vehicle, stage.distractors) for vehicle in row.distractors),
        ]
        wrong = [f"{kind} {name!r} is not in the config" for kind, name, known in named if name not in known]
        for vehicle in row.planned if not wrong else ():
            there = stage.everything[vehicle.vehicle].shape.part_names[1:]
            for part in sorted(vehicle.articulation.keys() - set(there)):
                wrong.append(f"vehicle {vehicle.vehicle!r} has no part {part!r} to turn")
        self.findings += [f"image {row.index}: {what}" for what in wrong]
        return not wrong


def broken(limit: Limit, found: Recomputed, config: Config) -> list[str]:
    """A line for each row that breaks a limit."""
    bounds = limit.bounds(config)
    if bounds is None:
        return []
    values = limit.measure(found)
    name = found.place + limit.name
    lines = []
    for i in np.flatnonzero(~limit.kept(values, config)).tolist():
        what = f"{name} is {values[i]:.6g}, allowed are {bounds[0]:.6g} to {bounds[1]:.6g}"
        lines.append(f"image {found.rows[i].index}: " + (f"breaks {name}" if values.dtype == bool else what))
    return lines
