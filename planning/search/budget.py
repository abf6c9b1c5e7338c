"""Numbers of images per vehicle and position: exact and balanced.

A class's images go to its models by turns and weights, a model's images to its positions in order. Positions of
different classes alternate, and those of backgrounds are spread evenly between them, so that any beginning of the plan
is as balanced as the whole.

References
----------
Paper, equation 1 (I = V * I_p * P_v) and section 2.1.8 (a number of images per class, by round robin over its models).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Int

from hulldown.base.errors import ConfigError
from hulldown.geometry.indices import numbered
from hulldown.plan.config.scene_sections import BudgetSection

SHARE_ROUNDING = 1e-9  # of shares of a class's images


@dataclass(frozen=True, eq=False, slots=True)
class Positions:
    """The vehicles and images of n positions."""

    number: Int[np.ndarray, " n"]
    vehicle: Int[np.ndarray, " n"]  # index into `Budget.vehicles`; -1 for backgrounds
    ordinal: Int[np.ndarray, " n"]  # number of earlier positions of this vehicle, or of backgrounds
    shots: Int[np.ndarray, " n"]  # shots, first_image: number of images, at least 1, and the index of the first of them
    first_image: Int[np.ndarray, " n"]

    @property
    def background(self) -> Bool[np.ndarray, " n"]:
        """Whether a position holds backgrounds."""
        return self.vehicle < 0


@dataclass(frozen=True, eq=False, slots=True)
class Budget:
    """Counts of images of every vehicle, and the positions of a plan."""

    vehicles: tuple[str, ...]  # names, grouped by class, in the order of the config
    class_starts: Int[np.ndarray, " c_plus_1"]  # index in `vehicles` of each class's first, and their number
    # images of each vehicle; within a class of equal weights they don't increase, and differ by at most 1
    images: Int[np.ndarray, " v"]
    positions: Positions  # all positions, in the order of the plan

    @property
    def n_images(self) -> int:
        """Images in all."""
        return int(self.positions.shots.sum())

    @property
    def n_positions(self) -> int:
        """Positions in all."""
        return len(self.positions.shots)


def make_budget(
    section: BudgetSection, categories: Mapping[str, str], weights: Mapping[str, float] = MappingProxyType({})
) -> Budget:
    """Return the budget of a config, given the class of each vehicle in the order of the config."""
    classes = tuple(dict.fromkeys(categories.values()))
    members = {c: [v for v, category in categories.items() if category == c] for c in classes}
    wanted = section.images_per_class
    if isinstance(wanted, dict):
        if unknown := sorted(set(wanted) - set(classes)):
            raise ConfigError(
                f"budget.images_per_class: no vehicle has the class {unknown[0]!r}",
                remedy=f"classes are {list(classes)}",
            )
        if lacking := [c for c in classes if c not in wanted]:
            raise ConfigError(
                f"budget.images_per_class: no number for the class {lacking[0]!r}", remedy="give it one; 0 is allowed"
            )
    images: list[int] = []
    for c in classes:
        weight = np.array([weights.get(v, 1.0) for v in members[c]])
        if wanted is None:
            of_each = np.rint((section.positions_per_vehicle or 0) * weight) * section.images_per_position
        else:
            quota = wanted[c] if isinstance(wanted, dict) else wanted
            if quota and not weight.any():
                raise ConfigError(
                    f"assets.vehicles: all of class {c!r} have weight 0", remedy="give one a weight above 0"
                )
            share = quota * weight / max(weight.sum(), 1e-300)
            of_each = np.floor(share + SHARE_ROUNDING)
            # The largest remainders get the rest.
            rest = np.argsort(np.rint((of_each - share) / SHARE_ROUNDING), kind="stable")[: quota - int(of_each.sum())]
            of_each[rest] += 1
        images += of_each.astype(np.int64).tolist()
    if not sum(images):
        raise ConfigError("budget: no image would be made", remedy="ask for at least one")
    class_starts = np.cumsum([0, *(len(members[c]) for c in classes)])
    counts = np.array(images, dtype=np.int64)
    backgrounds = round(sum(images) * section.background_share / (1.0 - section.background_share))
    positions = _positions(counts, class_starts, backgrounds, section.images_per_position)
    return Budget(tuple(v for c in classes for v in members[c]), class_starts, counts, positions)


def _positions(
    images: Int[np.ndarray, " v"], class_starts: Int[np.ndarray, " c_plus_1"], backgrounds: int, most: int
) -> Positions:
    """Return positions with up to `most` images each: those of vehicles by turns, and backgrounds between them."""
    counts, starts = np.append(images, backgrounds), np.append(class_starts, len(images) + 1)  # backgrounds come last
    vehicle, ordinal = numbered(-(-counts // most))
    of_class = np.searchsorted(starts, vehicle, side="right") - 1
    # Each vehicle's positions are spread evenly over its class's turns.
    by_turn = np.lexsort((vehicle, (ordinal + 0.5) / -(-counts // most)[vehicle], of_class))
    turn = np.empty(len(vehicle), dtype=np.int64)
    turn[by_turn] = numbered(np.bincount(of_class, minlength=len(starts)))[1]
    empty, n = vehicle == len(images), len(vehicle)
    background = np.diff(np.arange(n + 1) * np.count_nonzero(empty) // n) > 0
    order = np.empty(n, dtype=np.int64)
    order[np.argsort(background, kind="stable")] = np.lexsort((of_class, turn, empty))
    vehicle, ordinal = vehicle[order], ordinal[order]
    shots = np.minimum(counts[vehicle] - ordinal * most, most)
    return Positions(np.arange(n), np.where(background, -1, vehicle), ordinal, shots, np.cumsum(shots) - shots)
