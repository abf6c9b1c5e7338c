"""Settle candidates on a scenery, clear of water, obstacles, and roofs (paper, section 2.1.5)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.columns import put_rows
from hulldown.base.portable import sin_cos
from hulldown.geometry.transforms import compose_affine, invert_rigid, rigid_matrix, rotation_z, transform_points
from hulldown.placement.settle import Settled, empty_settled, record_contact_results, settle_vehicles, underside_depth
from hulldown.plan.config.scene_sections import PlacementSection
from hulldown.plan.rejection import Rejection
from hulldown.plan.row import round_field
from hulldown.planning.search.instance_table import Instances
from hulldown.planning.search.random_streams import scale_uniform
from hulldown.planning.search.stage import Site, settle_rules
from hulldown.planning.search.tables import InstanceRole
from hulldown.scene.obstacles import box_pair_touch_mask

SKY_RAY_CLEARANCE_M = 0.05  # rays to the sky start this far above a vehicle's box


def extra_offsets(
    role: Int[np.ndarray, " n"], limits: PlacementSection, uniform: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Return offsets in meters to extras, by uniform numbers: companions even in distance, distractors in area."""
    of_roles = np.array([(0.0, 0.0), limits.companion_distance, limits.distractor_distance])
    low, high = of_roles[role].T
    by_distance = scale_uniform(low, high, uniform[:, 0])
    by_area = np.clip(np.sqrt(scale_uniform(low**2, high**2, uniform[:, 0])), low, high)
    away = np.where(role == InstanceRole.COMPANION, by_distance, by_area)
    return away[:, None] * np.stack(sin_cos(2.0 * math.pi * uniform[:, 1])[::-1], axis=1)


def settle_instances(
    site: Site,
    instances: Instances,
    limits: PlacementSection,
    *,
    xy: Float[np.ndarray, "n 2"],
    yaw: Float[np.ndarray, " n"],
    upright: Bool[np.ndarray, " n"] | None = None,
    z: Float[np.ndarray, " n"] | None = None,
) -> Settled:
    """Settle n vehicles (meters, radians), some upright at heights `z`; reject those beyond the limits."""
    fleet, rules = instances.fleet, settle_rules(limits)
    settled = settle_vehicles(site.terrain, fleet.footings, instances.model, xy=xy, yaw=yaw, rules=rules)
    if upright is not None and z is not None:
        rows = np.flatnonzero(upright)
        stood = empty_settled(len(rows))
        stood.world_from_vehicle[:] = rigid_matrix(rotation_z(yaw[rows]), np.column_stack([xy, z])[rows])
        stood.tilt[:] = 0.0
        record_contact_results(stood, np.arange(len(rows)), site.terrain, fleet.contacts.take(instances.model[rows]), rules)
        stood.rejection[~site.terrain.top_hits(xy[rows]).hit] = Rejection.OFF_GROUND
        put_rows(settled, rows, stood)
    rejection = settled.rejection.copy()
    poses = round_field("world_from_vehicle", settled.world_from_vehicle)  # labels follow from rounded poses
    placed = replace(instances, world_from_vehicle=poses)
    rows = np.flatnonzero(rejection == Rejection.NONE)
    rejection[rows[depth_in_water(site, placed.take(rows)) > limits.fording_depth]] = Rejection.WATER
    rows = rows[rejection[rows] == Rejection.NONE]
    clear = clear_of_obstacles_mask(site, placed.take(rows), limits.obstacle_clearance)
    rejection[rows[~clear]] = Rejection.OBSTACLE
    rows = rows[clear]
    if not limits.indoors:
        rejection[rows[~skylit_vehicle_mask(site, placed.take(rows))]] = Rejection.DARK
    return replace(settled, world_from_vehicle=poses, rejection=rejection)


def depth_in_water(site: Site, instances: Instances) -> Float[np.ndarray, " n"]:
    """Return the greatest depth of each vehicle's underside below water in meters; 0 on dry ground."""
    if site.water is None:
        return np.zeros(len(instances))
    samples = instances.fleet.contacts.take(instances.model)
    return underside_depth(site.water, instances.world_from_vehicle, samples)


def skylit_vehicle_mask(site: Site, instances: Instances) -> Bool[np.ndarray, " n"]:
    """Return whether light from the sky reaches the top of each vehicle."""
    fleet, model = instances.fleet, instances.model
    top = fleet.center[model].copy()
    top[:, 2] += fleet.size[model, 2] / 2 + SKY_RAY_CLEARANCE_M
    return site.obstacles.skylit_mask(transform_points(instances.world_from_vehicle, top[:, None])[:, 0])


def clear_of_obstacles_mask(site: Site, instances: Instances, clearance: float) -> Bool[np.ndarray, " n"]:
    """Return whether all parts of each vehicle keep the clearance to obstacles."""
    half, world_from_box = _clearance_half_sizes_and_poses(instances, clearance)
    clear = np.ones(len(instances), dtype=bool)
    for box in range(half.shape[1]):
        # The hull is the first box, and rejects most vehicles.
        rows = np.flatnonzero(clear & (box < instances.fleet.box_counts[instances.model]))
        clear[rows] = ~site.obstacles.blocked_box_mask(half[rows, box], world_from_box[rows, box])
    return clear


def clear_of_vehicles_mask(instances: Instances, others: Instances, clearance: float) -> Bool[np.ndarray, " p"]:
    """Return which of p pairs of vehicles keep the clearance, which extends sideways and upward from both."""
    clear = np.ones(len(instances), dtype=bool)
    # Pairs whose bounding spheres don't meet need no boxes.
    reach = instances.fleet.reach[instances.model] + others.fleet.reach[others.model] + 2.0 * clearance
    away = instances.world_from_vehicle[:, :3, 3] - others.world_from_vehicle[:, :3, 3]
    near = np.flatnonzero((away * away).sum(axis=1) <= reach * reach)
    nearby, others_nearby = instances.take(near), others.take(near)
    for first, second in ((nearby, others_nearby), (others_nearby, nearby)):
        half, world_from_box = _clearance_half_sizes_and_poses(first, clearance)
        half_other, world_from_other = _clearance_half_sizes_and_poses(second, 0.0)
        for a in range(half.shape[1]):
            for b in range(half.shape[1]):
                here = (a < first.fleet.box_counts[first.model]) & (b < second.fleet.box_counts[second.model])
                rows = np.flatnonzero(clear[near] & here)
                box_from_other = compose_affine(invert_rigid(world_from_box[rows, a]), world_from_other[rows, b])
                clear[near[rows]] = ~box_pair_touch_mask(half[rows, a], half_other[rows, b], box_from_other)
    return clear


def _clearance_half_sizes_and_poses(
    instances: Instances, clearance: float
) -> tuple[Float[np.ndarray, "n b 3"], Float[np.ndarray, "n b 4 4"]]:
    fleet, model = instances.fleet, instances.model
    center = fleet.box_center[model] + [0.0, 0.0, clearance / 2]
    world_from_box = compose_affine(instances.world_from_part_boxes(), rigid_matrix(np.eye(3), center))
    return fleet.half[model] + clearance * np.array([1.0, 1.0, 0.5]), world_from_box
