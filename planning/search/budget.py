"""Numbers of images per vehicle and position: exact, balanced, and in closed form.

A class's images go to its models in round robin, a model's images to its positions in order. Positions of different
classes alternate, and those of backgrounds are spread evenly between them, so that any beginning of the plan is as
balanced as the whole. Positions are computed from their numbers: memory doesn't grow with the number of images.

References
----------
Paper, equation 1 (I = V * I_p * P_v) and section 2.1.8 (a number of images per class, by round robin over its models).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from numpy.typing import ArrayLike

from hulldown.geometry.arrays import checked
from hulldown.geometry.errors import ConfigError
from hulldown.planning.config.schema import BudgetSection


@dataclass(frozen=True, eq=False, slots=True)
class Positions:
    """The vehicles and images of n positions.

    Parameters
    ----------
    vehicle
        (n,) index into `Budget.vehicles`; -1 for backgrounds.
    ordinal
        (n,) number of earlier positions of this vehicle, or of backgrounds.
    shots, first_image
        (n,) number of images, at least 1, and the index of the first of them.
    """

    vehicle: Int[np.ndarray, " n"]
    ordinal: Int[np.ndarray, " n"]
    shots: Int[np.ndarray, " n"]
    first_image: Int[np.ndarray, " n"]

    @property
    def background(self) -> Bool[np.ndarray, " n"]:
        """Whether a position holds backgrounds."""
        return self.vehicle < 0


@dataclass(frozen=True, eq=False, slots=True)
class Budget:
    """Counts of images of every vehicle, and the order of positions.

    Parameters
    ----------
    vehicles
        Names, grouped by class, in the order of the config.
    class_starts
        (c + 1,) index in `vehicles` of each class's first, and their number.
    images
        (v,) images of each vehicle; within a class they don't increase, and differ by at most 1.
    shots
        Images of a position; a vehicle's last position may have fewer.
    backgrounds
        Additional images without a target.
    """

    vehicles: tuple[str, ...]
    class_starts: Int[np.ndarray, " c_plus_1"]
    images: Int[np.ndarray, " v"]
    shots: int
    backgrounds: int = 0

    @property
    def positions_per_vehicle(self) -> Int[np.ndarray, " v"]:
        """Positions of each vehicle."""
        return -(-self.images // self.shots)

    @property
    def n_images(self) -> int:
        """Images in all."""
        return int(self.images.sum()) + self.backgrounds

    @property
    def n_positions(self) -> int:
        """Positions in all."""
        return self.n_target_positions + self.n_background_positions

    @property
    def n_target_positions(self) -> int:
        """Positions of vehicles."""
        return int(self.positions_per_vehicle.sum())

    @property
    def n_background_positions(self) -> int:
        """Positions of backgrounds."""
        return -(-self.backgrounds // self.shots)

    def positions(self, index: ArrayLike) -> Positions:
        """Return the vehicles and images of the positions with these (n,) indices."""
        k = checked(index, "index", ("n",), dtype=np.int64)
        n, ordinal = max(self.n_positions, 1), k * self.n_background_positions // max(self.n_positions, 1)
        background = (k + 1) * self.n_background_positions // n > ordinal
        held = self.target_positions(np.minimum(k - ordinal, self.n_target_positions - 1))
        # The last position of backgrounds may follow that of all vehicles.
        before = np.where(k - ordinal < self.n_target_positions, held.first_image, self.images.sum())
        return Positions(
            vehicle=np.where(background, -1, held.vehicle),
            ordinal=np.where(background, ordinal, held.ordinal),
            shots=np.where(background, np.minimum(self.backgrounds - ordinal * self.shots, self.shots), held.shots),
            first_image=before + np.minimum(ordinal * self.shots, self.backgrounds),
        )

    def turned(self, vehicle: Int[np.ndarray, " n"], turn: int) -> Int[np.ndarray, " n"]:
        """Replace each vehicle by the one `turn` places further in its class, cyclically; -1 stays."""
        last = np.searchsorted(self.class_starts, vehicle, side="right")
        start, stop = self.class_starts[last - 1], self.class_starts[np.minimum(last, len(self.class_starts) - 1)]
        return np.where(vehicle < 0, -1, start + (vehicle - start + turn) % np.maximum(stop - start, 1))

    def target_positions(self, k: Int[np.ndarray, " n"]) -> Positions:
        """Return the k-th positions of vehicles, counted without positions and images of backgrounds."""
        running = np.concatenate([[0], np.cumsum(self.positions_per_vehicle)])
        per_class = np.diff(running[self.class_starts])
        # Step t visits the t-th position of every class that has one. Between two successive totals the same classes
        # take part, so each step visits the same number of positions.
        totals = np.unique(per_class)
        active = (per_class[None, :] >= totals[:, None]).sum(axis=1)
        starts_t = np.concatenate([[0], totals])[:-1]
        starts_k = np.concatenate([[0], np.cumsum((totals - starts_t) * active)])
        segment = np.minimum(np.searchsorted(starts_k, k, side="right") - 1, len(totals) - 1)
        t = starts_t[segment] + (k - starts_k[segment]) // active[segment]
        slot = (k - starts_k[segment]) % active[segment]
        taking_part = per_class[None, :] > t[:, None]
        cls = np.argmax(np.cumsum(taking_part, axis=1) == (slot + 1)[:, None], axis=1)
        models = np.diff(self.class_starts)[cls]
        vehicle = self.class_starts[cls] + t % models
        ordinal = t // models
        shots = np.minimum(self.images[vehicle] - ordinal * self.shots, self.shots)
        earlier = np.arange(len(per_class)) < cls[:, None]
        return Positions(vehicle, ordinal, shots, self._images_before(t[:, None] + earlier))

    def position_of(self, image: int) -> int:
        """Index of the position with image `image`."""
        return bisect_right(range(self.n_positions), image, key=lambda k: int(self.positions([k]).first_image[0])) - 1

    def _images_before(self, t: Int[np.ndarray, "n c"]) -> Int[np.ndarray, " n"]:
        """Images in the first t[:, c] positions of every class c, added up."""
        total = np.zeros(len(t), dtype=np.int64)
        for c, start in enumerate(self.class_starts[:-1]):
            models = int(self.class_starts[c + 1] - start)
            for m in range(models):
                visited = (t[:, c] - m + models - 1) // models
                total += np.minimum(visited * self.shots, self.images[start + m])
        return total


def make_budget(section: BudgetSection, categories: Mapping[str, str]) -> Budget:
    """Return the budget of a config, given the class of each vehicle in the order of the config.

    Raises
    ------
    ConfigError
        If the table of classes doesn't name each class exactly once, or there are no images.
    """
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
        n = len(members[c])
        if wanted is None:
            positions = section.positions_per_vehicle or 0
            images += [positions * section.images_per_position] * n
        else:
            quota = wanted[c] if isinstance(wanted, dict) else wanted
            images += [quota // n + (m < quota % n) for m in range(n)]
    if not sum(images):
        raise ConfigError("budget: no image would be made", remedy="ask for at least one")
    return Budget(
        vehicles=tuple(v for c in classes for v in members[c]),
        class_starts=np.cumsum([0, *(len(members[c]) for c in classes)]),
        images=np.array(images, dtype=np.int64),
        shots=section.images_per_position,
        backgrounds=round(sum(images) * section.background_share / (1.0 - section.background_share)),
    )
