"""One try per row at standing a vehicle on a site (paper, section 2.1.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from placement.candidates import candidates
from placement.limits import clear_of_vehicles
from placement.settle import settle
from planning.draws import Draws, Purpose, StackedGenerator
from planning.refusal import Refusal
from planning.row import rounded
from planning.schema import PlacementSection
from planning.stage import Model, Placed, Site


@dataclass(frozen=True, eq=False, slots=True)
class Stands:
    """Vehicles that were stood somewhere, n of them; nan where refused.

    Parameters
    ----------
    world_from_vehicle
        (n, 4, 4) resting poses.
    slope_deg
        (n,) inclination of the vehicle, from the ground under the whole footprint.
    gap, penetration
        (n,) metres between the underside and the ground.
    refusal
        (n,) codes of `Refusal`.
    """

    world_from_vehicle: Float[np.ndarray, "n 4 4"]
    slope_deg: Float[np.ndarray, " n"]
    gap: Float[np.ndarray, " n"]
    penetration: Float[np.ndarray, " n"]
    refusal: UInt8[np.ndarray, " n"]

    def take(self, rows: Int[np.ndarray, " k"]) -> Stands:
        """Some of the rows."""
        return Stands(*(getattr(self, f.name)[rows] for f in fields(self)))

    def put(self, rows: Int[np.ndarray, " k"], other: Stands) -> None:
        """Overwrite some of the rows."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)


def nowhere(n: int) -> Stands:
    """Room for n stands."""
    slope, gap, penetration = np.full((3, n), np.nan)
    return Stands(np.full((n, 4, 4), np.nan), slope, gap, penetration, np.zeros(n, dtype=np.uint8))


def try_places(
    site: Site,
    model: Model,
    limits: PlacementSection,
    *,
    draws: Draws,
    position: Int[np.ndarray, " n"],
    attempt: Int[np.ndarray, " n"],
    articulation: list[dict[str, float]],
) -> Stands:
    """Try `attempt` of each position: drawn, settled, and kept clear of obstacles."""
    rng = StackedGenerator(draws, Purpose.PLACE, position, attempt)
    xy, yaw = candidates(site.bounds, len(position), rng=rng, margin=limits.margin)
    return stand(site, model, limits, xy, yaw, articulation)


def stand(
    site: Site,
    model: Model,
    limits: PlacementSection,
    xy: Float[np.ndarray, "n 2"],
    yaw: Float[np.ndarray, " n"],
    articulation: list[dict[str, float]],
) -> Stands:
    """Vehicles at these places with these headings, or the reasons why not."""
    settled = settle(
        site.terrain,
        model.shape.size_xyz,
        xy,
        yaw,
        rule=limits.rule,
        n=limits.footprint,
        max_slope=math.radians(limits.max_slope_deg),
        min_share=limits.min_valid_share,
        max_gap=limits.max_gap,
        max_penetration=limits.max_penetration,
        footprint=model.undersides[limits.contact],
    )
    refusal = settled.verdict.copy()
    poses = rounded("world_from_vehicle", settled.world_from_vehicle)  # as they are written: labels follow from them
    rows = np.flatnonzero(refusal == Refusal.NONE)
    placed = Placed(model, poses[rows], [articulation[i] for i in rows.tolist()])
    refusal[rows[~clear_of_obstacles(site, placed, limits.obstacle_clearance)]] = Refusal.OBSTACLE
    return Stands(poses, np.degrees(settled.tilt), settled.gap, settled.penetration, refusal)


def clear_of_obstacles(site: Site, placed: Placed, clearance: float) -> Bool[np.ndarray, " n"]:
    """Whether no part of each vehicle comes near an obstacle."""
    poses = placed.world_from_parts()
    clear = np.ones(len(poses), dtype=bool)
    for part, extent in enumerate(placed.model.extents):
        rows = np.flatnonzero(clear)
        clear[rows] = site.standing_room.clear(extent, poses[rows, part], clearance)
    return clear


def clear_of_vehicle(placed: Placed, other: Placed, clearance: float) -> Bool[np.ndarray, " n"]:
    """Whether no part of each vehicle comes near a part of the other one of its row."""
    mine, theirs = placed.world_from_parts(), other.world_from_parts()
    clear = np.ones(len(mine), dtype=bool)
    for a, extent in enumerate(placed.model.extents):
        for b, their_extent in enumerate(other.model.extents):
            clear &= clear_of_vehicles(extent, mine[:, a], their_extent, theirs[:, b, None], clearance)
    return clear
