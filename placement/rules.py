"""The rules of settling, and the limits of a resting pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hulldown.geometry.arrays import whole_number

RULES = ("averaged", "support")


@dataclass(frozen=True, eq=False, slots=True)
class SettleRules:
    """The rules of settling, and the limits of a resting pose."""

    # how the rest plane follows from the footprint: "averaged" takes the mean height and mean normal (the paper's),
    # "support" finds the plane that a rigid footprint comes to rest on
    rule: str = "support"
    # the footprint is sampled by n x n vertical rays, border included. If it is an `Underside`, the support rule sends
    # each to the lowest spot near its place, and lets the ground reach the underside there.
    n: int = 5
    # gap and penetration are measured at contact_n x contact_n points of the tilted underside; 0 leaves them nan
    contact_n: int = 9
    # greatest inclination in radians, of the ground at (x, y) and of the rest plane
    max_slope: float = math.radians(30.0)
    min_share: float = 0.8  # least share of the n x n rays that must meet ground
    max_gap: float = math.inf  # max_gap, max_penetration: largest `Settled.gap` and `Settled.penetration`, in meters
    max_penetration: float = math.inf

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ValueError(f"rule: expected one of {', '.join(RULES)}, got {self.rule!r}")
        if not 2 <= whole_number(self.n, "n") <= 9:
            raise ValueError(f"n: expected 2 to 9 rays a side, got {self.n}")
        if whole_number(self.contact_n, "contact_n") < 0:
            raise ValueError(f"contact_n: expected 0 or more points a side, got {self.contact_n}")
        if not 0.0 <= self.max_slope < math.pi / 2:
            raise ValueError(f"max_slope: expected radians in [0, pi/2), got {self.max_slope}")
        if not 0.0 <= self.min_share <= 1.0:
            raise ValueError(f"min_share: expected a share in [0, 1], got {self.min_share}")
        for name in ("max_gap", "max_penetration"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}: expected meters of 0 or more, got {getattr(self, name)}")
