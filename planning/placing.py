"""One candidate per row for a vehicle's place on a site, settled and kept clear (paper, section 2.1.5)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from geometry.portable import arctan2
from geometry.transforms import apply
from placement.candidates import candidates
from placement.clearance import clear_of_vehicles
from placement.footprint import contact_samples
from placement.rejection import Rejection
from placement.settle import Settled, depth_below, settle
from planning.draws import Draws, Purpose, RowStreams
from planning.row import rounded
from planning.schema import Config
from planning.search_limits import FORDING, GAP, PENETRATION, SLOPE, VALID_SHARE
from planning.stage import Model, Placed, Site

CONTACT = 9  # points a side of the underside at which gap, penetration and depth in water are looked at
ABOVE = 0.05  # metres above a vehicle's box from where its sky is looked for


def unsettled(n: int) -> Settled:
    """Room for n settled candidates."""
    slope, tilt, share, margin, gap, penetration = np.full((6, n), np.nan)
    poses, rejection = np.full((n, 4, 4), np.nan), np.zeros(n, dtype=np.uint8)
    return Settled(poses, slope, tilt, share, margin, gap, penetration, rejection)


def try_candidates(
    site: Site,
    model: Model,
    config: Config,
    *,
    draws: Draws,
    position: Int[np.ndarray, " n"],
    attempt: Int[np.ndarray, " n"],
    articulation: list[dict[str, float]],
) -> Settled:
    """Try `attempt` of each position: drawn, settled, and kept clear of obstacles."""
    rng = RowStreams(draws, Purpose.PLACE, position, attempt)
    xy, yaw = candidates(site.bounds, len(position), rng=rng, margin=config.placement.margin)
    return settle_clear(site, model, config, xy=xy, yaw=yaw, articulation=articulation)


def settle_clear(
    site: Site,
    model: Model,
    config: Config,
    *,
    xy: Float[np.ndarray, "n 2"],
    yaw: Float[np.ndarray, " n"],
    articulation: list[dict[str, float]],
) -> Settled:
    """Vehicles settled at these places with these headings and clear of obstacles, or the rejections."""
    limits = config.placement
    settled = settle(
        site.terrain,
        model.shape.size_xyz,
        xy,
        yaw,
        rule=limits.rule,
        n=limits.footprint,
        max_slope=math.radians(SLOPE.highest(config)),
        min_share=VALID_SHARE.lowest(config),
        max_gap=GAP.highest(config),
        max_penetration=PENETRATION.highest(config),
        footprint=model.undersides[limits.contact],
    )
    rejection = settled.rejection.copy()
    poses = rounded("world_from_vehicle", settled.world_from_vehicle)  # as they are written: labels follow from them
    rows = np.flatnonzero(rejection == Rejection.NONE)
    placed = Placed(model, poses[rows], [articulation[i] for i in rows.tolist()])
    rejection[rows] = FORDING.rejections(depth_in_water(site, placed, limits.contact), config)
    dry = rejection[rows] == Rejection.NONE
    rows, placed = rows[dry], placed.rows(np.flatnonzero(dry))
    clear = clear_of_obstacles(site, placed, limits.obstacle_clearance)
    rejection[rows[~clear]] = Rejection.OBSTACLE
    rows, placed = rows[clear], placed.rows(np.flatnonzero(clear))
    rejection[rows[~sees_sky(site, placed)]] = Rejection.DARK
    return replace(settled, world_from_vehicle=poses, rejection=rejection)


def settle_at(site: Site, model: Model, config: Config, world_from_vehicle: Float[np.ndarray, "n 4 4"]) -> Settled:
    """Vehicles settled by the config's rule at the places and headings of these poses, whatever the limits say."""
    limits, forward = config.placement, world_from_vehicle[:, :2, 0]
    return settle(
        site.terrain,
        model.shape.size_xyz,
        world_from_vehicle[:, :2, 3],
        arctan2(forward[:, 1], forward[:, 0]),
        rule=limits.rule,
        n=limits.footprint,
        max_slope=math.nextafter(math.pi / 2, 0.0),
        min_share=0.0,
        footprint=model.undersides[limits.contact],
    )


def depth_in_water(site: Site, placed: Placed, contact: str) -> Float[np.ndarray, " n"]:
    """How far in metres the underside of each vehicle lies below water, at most; 0 on dry ground."""
    if site.water is None:
        return np.zeros(len(placed.world_from_vehicle))
    samples = contact_samples(placed.model.undersides[contact], CONTACT)
    return depth_below(site.water, placed.world_from_vehicle, samples)


def sees_sky(site: Site, placed: Placed) -> Bool[np.ndarray, " n"]:
    """Whether any light of the sky comes down to the top of each vehicle."""
    top = placed.model.centre + np.array([0.0, 0.0, placed.model.shape.size_xyz[2] / 2 + ABOVE])
    return site.vehicle_room.open_above(apply(placed.world_from_vehicle, top[None])[:, 0])


def clear_of_obstacles(site: Site, placed: Placed, clearance: float) -> Bool[np.ndarray, " n"]:
    """Whether no part of each vehicle comes near an obstacle."""
    poses = placed.world_from_parts()
    clear = np.ones(len(poses), dtype=bool)
    for part, extent in enumerate(placed.model.extents):
        rows = np.flatnonzero(clear)
        clear[rows] = site.vehicle_room.clear(extent, poses[rows, part], clearance)
    return clear


def clear_of_vehicle(placed: Placed, other: Placed, clearance: float) -> Bool[np.ndarray, " n"]:
    """Whether no part of each vehicle comes near a part of the other one of its row."""
    mine, theirs = placed.world_from_parts(), other.world_from_parts()
    clear = np.ones(len(mine), dtype=bool)
    for a, extent in enumerate(placed.model.extents):
        for b, their_extent in enumerate(other.model.extents):
            clear &= clear_of_vehicles(extent, mine[:, a], their_extent, theirs[:, b, None], clearance)
    return clear
