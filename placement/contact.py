"""Sample points of a vehicle's underside, and its gap, penetration, and depth in a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hulldown.placement.footprint import Samples, Underside, plate_samples, underside_samples
from hulldown.placement.rules import SettleRules
from hulldown.placement.terrain import Terrain


@dataclass(frozen=True, eq=False, slots=True)
class Footing:
    """Points at which a vehicle's underside is compared with the ground."""

    samples: Samples  # points for the rest plane
    contact: Samples  # points at which gap and penetration are measured

    @classmethod
    def of(cls, footprint: Float[np.ndarray, "2 2"] | Underside, rules: SettleRules) -> Footing:
        """Return the sample points of a footprint by these rules."""
        if not isinstance(footprint, Underside):
            return cls(plate_samples(footprint, rules.n), plate_samples(footprint, rules.contact_n))
        contact = underside_samples(footprint, rules.contact_n).below_underside()
        support = rules.rule == "support"
        return cls(underside_samples(footprint, rules.n) if support else plate_samples(footprint.box, rules.n), contact)


def stack_samples(samples: Sequence[Samples]) -> Samples:
    """Stack the samples of several vehicles, padded with each one's first sample."""
    most = max(len(sample.xy) for sample in samples)
    padded = [np.minimum(np.arange(most), len(sample.xy)) % max(len(sample.xy), 1) for sample in samples]
    xy, height, foot = (
        np.stack([getattr(sample, field)[i] for sample, i in zip(samples, padded, strict=True)])
        for field in ("xy", "height", "foot")
    )
    return Samples(xy, height, foot, np.stack([sample.center for sample in samples]))


def gap_and_penetration(
    terrain: Terrain, world_from_vehicle: Float[np.ndarray, "k 4 4"], contact: Samples
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Measure `settle.Settled.gap` and `penetration` of posed vehicles; points without ground don't count."""
    points, up = underside_points(world_from_vehicle, contact), world_from_vehicle[:, 2, 2, None]
    hits = terrain.top_hits(points[..., :2].reshape(-1, 2))
    above = points[..., 2] - hits.z.reshape(points.shape[:2])
    # Height of the underside above the plane that the vehicle rests on, measured straight down.
    below = np.where(contact.foot, above - contact.height / up, np.nan)
    # fmax passes over the nan of a miss.
    return np.fmax.reduce(below, axis=1, initial=0.0), np.fmax.reduce(-above, axis=1, initial=0.0)


def underside_depth(
    surface: Terrain, world_from_vehicle: Float[np.ndarray, "k 4 4"], contact: Samples
) -> Float[np.ndarray, " k"]:
    """Largest depth in meters of posed vehicles' undersides below a surface such as water; 0 next to it."""
    points = underside_points(world_from_vehicle, contact)
    hits = surface.top_hits(points[..., :2].reshape(-1, 2))
    return np.fmax.reduce(hits.z.reshape(points.shape[:2]) - points[..., 2], axis=1, initial=0.0)


def underside_points(world_from_vehicle: Float[np.ndarray, "k 4 4"], contact: Samples) -> Float[np.ndarray, "k p 3"]:
    """Return the points of posed vehicles' undersides in the world."""
    x, y, height = contact.xy[..., 0], contact.xy[..., 1], contact.height
    forward, left, up, origin = (world_from_vehicle[:, :3, i, None] for i in range(4))
    points = np.stack([origin[:, i] + (forward[:, i] * x + left[:, i] * y) for i in range(3)], axis=2)
    points += np.stack([up[:, i] * height for i in range(3)], axis=2)
    return points
