"""Settle vehicles on the ground: slope gate, footprint, resting pose, gap, and penetration.

The contact point of a candidate is where the vertical line through (x, y) meets the rest plane. The vehicle's origin,
the center of its underside, is put there, and the vehicle is tilted about it until its up axis is the plane's normal;
the vertical plane that holds its forward axis does not turn. Contact height and heading are therefore the same before
and after the tilt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array, checked_whole_number
from hulldown.base.columns import join_rows, put_rows
from hulldown.base.indices import index_batches
from hulldown.base.portable import arctan2, hypot, sin_cos
from hulldown.geometry.transforms import rigid_matrix, yaw_and_up_rotation
from hulldown.placement.footprint import Samples, Underside, plate_samples, underside_samples
from hulldown.placement.rest import Rest, fit_averaged_planes, fit_underside_planes
from hulldown.placement.terrain import Terrain

REST_RULES = ("averaged", "support")
FOOTPRINT_RAYS_PER_BLOCK = 1 << 16  # their data stay in cache


class PlaceRejection(IntEnum):
    """Reasons in the order of the checks; 0 is an accepted place. `plan.rejection` has the codes in plan files."""

    NONE = 0
    OFF_GROUND = 1
    TOO_STEEP = 2
    OVERHANG = 3
    MEAN_TOO_STEEP = 4
    GAP = 5
    PENETRATION = 6


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
        if self.rule not in REST_RULES:
            raise ValueError(f"rule: expected one of {', '.join(REST_RULES)}, got {self.rule!r}")
        if not 2 <= checked_whole_number(self.n, "n") <= 9:
            raise ValueError(f"n: expected 2 to 9 rays a side, got {self.n}")
        if checked_whole_number(self.contact_n, "contact_n") < 0:
            raise ValueError(f"contact_n: expected 0 or more points a side, got {self.contact_n}")
        if not 0.0 <= self.max_slope < math.pi / 2:
            raise ValueError(f"max_slope: expected radians in [0, pi/2), got {self.max_slope}")
        if not 0.0 <= self.min_share <= 1.0:
            raise ValueError(f"min_share: expected a share in [0, 1], got {self.min_share}")
        for name in ("max_gap", "max_penetration"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}: expected meters of 0 or more, got {getattr(self, name)}")


DEFAULT_RULES = SettleRules()


@dataclass(frozen=True, eq=False, slots=True)
class Settled:
    """The results for each candidate; nan for values after its rejection.

    Parameters
    ----------
    world_from_vehicle
        (k, 4, 4) resting poses.
    slope
        (k,) radians: inclination of the ground at (x, y) itself.
    tilt
        (k,) radians: inclination of the rest plane, which is the vehicle's.
    share
        (k,) share of the footprint's rays that met ground.
    margin
        (k,) meters: how far inside the triangle of its three contacts the center of gravity lies, seen from above; the
        nearer to 0, the less sure the pose. nan for rules without contacts.
    gap
        (k,) meters: the largest vertical distance from the vehicle's tilted z = 0, which it stands on, down to the
        ground below its feet. All points are feet, except the belly of an `Underside`.
    penetration
        (k,) meters: the largest vertical distance from the tilted underside, at its own height, up to the ground.
    rejection
        (k,) codes of `PlaceRejection`.
    """

    world_from_vehicle: Float[np.ndarray, "k 4 4"]
    slope: Float[np.ndarray, " k"]
    tilt: Float[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]
    margin: Float[np.ndarray, " k"]
    gap: Float[np.ndarray, " k"]
    penetration: Float[np.ndarray, " k"]
    rejection: UInt8[np.ndarray, " k"]

    @property
    def ok(self) -> Bool[np.ndarray, " k"]:
        """Candidates that settled."""
        return self.rejection == PlaceRejection.NONE


def empty_settled(k: int) -> Settled:
    """Allocate results for k candidates: nan, and no rejection."""
    slope, tilt, share, margin, gap, penetration = np.full((6, k), np.nan)
    rejection = np.zeros(k, dtype=np.uint8)
    return Settled(np.full((k, 4, 4), np.nan), slope, tilt, share, margin, gap, penetration, rejection)


def settle(
    terrain: Terrain,
    size_xyz: ArrayLike,
    xy: ArrayLike,
    yaw: ArrayLike,
    *,
    footprint: ArrayLike | Underside | None = None,
    rules: SettleRules = DEFAULT_RULES,
) -> Settled:
    """Return the resting pose of a vehicle at each candidate position, or why there is none.

    Parameters
    ----------
    terrain
        The ground.
    size_xyz
        (3,) length, width, height of the vehicle's bounding box, meters.
    xy
        (k, 2) positions of the vehicle's origin in the world, meters.
    yaw
        (k,) headings in radians, counterclockwise from +x.
    footprint
        (2, 2) lowest and highest (x, y) of what touches ground, vehicle frame: a flat plate at z = 0; by default the
        whole underside of the bounding box. See `placement.footprint.contact_footprint`. Or an `Underside`, with the
        heights between wheels and tracks: `placement.footprint.vehicle_underside`.
    rules
        The rules of settling, and the limits of a resting pose.

    Returns
    -------
    Settled
        One row per candidate.

    Raises
    ------
    ValueError
        Naming the argument that is out of its range.

    References
    ----------
    Paper, section 2.1.5.

    Examples
    --------
    >>> import numpy as np
    >>> from hulldown.geometry.meshes import Mesh
    >>> ramp = Mesh(np.array([[0.0, 0, 0], [40, 0, 8], [40, 40, 8], [0, 40, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> settled = settle(Terrain(ramp), [7.0, 3.5, 2.4], xy=[[20.0, 20.0], [-5.0, 20.0]], yaw=[0.0, 0.0])
    >>> settled.ok.tolist()  # the second is off the ground
    [True, False]
    >>> settled.world_from_vehicle[0, :3, 3].round(6).tolist(), bool(settled.gap[0].round(6) == 0.0)
    ([20.0, 20.0, 4.0], True)
    """
    size = checked_array(size_xyz, "size_xyz", (3,))
    positions = checked_array(xy, "xy", ("k", 2))
    headings = checked_array(yaw, "yaw", (len(positions),))
    if (size <= 0).any():
        raise ValueError(f"size_xyz: expected lengths above 0, got {size.tolist()}")
    if isinstance(footprint, Underside):
        box = footprint.box
    else:
        box = np.stack([-size[:2], size[:2]]) / 2 if footprint is None else checked_array(footprint, "footprint", (2, 2))
    if (box[0] >= box[1]).any():
        raise ValueError(f"footprint: expected the lowest corner first, got {box.tolist()}")
    footing = Footing.from_footprint(footprint if isinstance(footprint, Underside) else box, rules)
    which = np.zeros(len(positions), dtype=np.int64)
    return settle_vehicles(terrain, (footing,), which, xy=positions, yaw=headings, rules=rules)


def settle_vehicles(
    terrain: Terrain,
    footings: Sequence[Footing],
    which: Int[np.ndarray, " k"],
    *,
    xy: Float[np.ndarray, "k 2"],
    yaw: Float[np.ndarray, " k"],
    rules: SettleRules,
) -> Settled:
    """Do `settle` for candidates of several vehicles at once, without checks."""
    contacts = stack_samples([footing.contact for footing in footings])
    return join_rows(
        [
            _settle_block(terrain, footings, which[rows], contacts, xy=xy[rows], yaw=yaw[rows], rules=rules)
            for rows in index_batches(len(xy), max(1, FOOTPRINT_RAYS_PER_BLOCK // max(len(footings[0].samples.xy), 1)))
        ]
    )


def _settle_block(
    terrain: Terrain,
    footings: Sequence[Footing],
    which: Int[np.ndarray, " k"],
    contacts: Samples,
    *,
    xy: Float[np.ndarray, "k 2"],
    yaw: Float[np.ndarray, " k"],
    rules: SettleRules,
) -> Settled:
    out = empty_settled(len(xy))
    spot = terrain.top_hits(xy)
    out.slope[:] = _normal_inclination(spot.normal)
    out.rejection[~spot.hit] = PlaceRejection.OFF_GROUND
    out.rejection[out.slope > rules.max_slope] = PlaceRejection.TOO_STEEP

    rows = np.flatnonzero(out.rejection == PlaceRejection.NONE)
    rest, out.share[rows] = _rest_planes_and_shares(
        terrain, footings, which[rows], xy=xy[rows], yaw=yaw[rows], spot_z=spot.z[rows], rules=rules
    )
    out.rejection[rows[~rest.found | (out.share[rows] < rules.min_share)]] = PlaceRejection.OVERHANG

    on = out.rejection[rows] == PlaceRejection.NONE
    rows, height, gradient = rows[on], rest.height[on], rest.gradient[on]
    # The gradient is that of a frame turned by the heading.
    sin, cos = sin_cos(yaw[rows])
    gx, gy = cos * gradient[:, 0] - sin * gradient[:, 1], sin * gradient[:, 0] + cos * gradient[:, 1]
    length = np.sqrt(1.0 + gx**2 + gy**2)
    normal = np.stack([-gx / length, -gy / length, 1.0 / length], axis=1)
    out.tilt[rows], out.margin[rows] = _normal_inclination(normal), rest.margin[on]
    origin = np.concatenate([xy[rows], height[:, None]], axis=1)
    out.world_from_vehicle[rows] = rigid_matrix(yaw_and_up_rotation(yaw[rows], normal), origin)
    out.rejection[rows[out.tilt[rows] > rules.max_slope]] = PlaceRejection.MEAN_TOO_STEEP

    rows = rows[out.rejection[rows] == PlaceRejection.NONE]
    if contacts.xy.shape[1]:
        record_contact_results(out, rows, terrain, contacts.take(which[rows]), rules)
    return out


def record_contact_results(
    settled: Settled, rows: Int[np.ndarray, " n"], terrain: Terrain, samples: Samples, rules: SettleRules
) -> None:
    """Measure gap and penetration of posed rows with n sets of contact samples, and reject those beyond the limits."""
    settled.gap[rows], settled.penetration[rows] = gap_and_penetration(terrain, settled.world_from_vehicle[rows], samples)
    settled.rejection[rows[settled.penetration[rows] > rules.max_penetration]] = PlaceRejection.PENETRATION
    settled.rejection[rows[settled.gap[rows] > rules.max_gap]] = PlaceRejection.GAP


def _rest_planes_and_shares(
    terrain: Terrain,
    footings: Sequence[Footing],
    which: Int[np.ndarray, " k"],
    *,
    xy: Float[np.ndarray, "k 2"],
    yaw: Float[np.ndarray, " k"],
    spot_z: Float[np.ndarray, " k"],
    rules: SettleRules,
) -> tuple[Rest, Float[np.ndarray, " k"]]:
    """Return rest planes about (x, y) in the turned frames, and the shares of rays that met ground."""
    sin, cos = (part[:, None] for part in sin_cos(yaw))
    x, y = np.moveaxis(np.stack([footing.samples.xy for footing in footings])[which], 2, 0)
    points = np.stack([xy[:, :1] + (cos * x - sin * y), xy[:, 1:] + (sin * x + cos * y)], axis=2)
    hits = terrain.top_hits(points.reshape(-1, 2))
    valid = hits.hit.reshape(points.shape[:2])
    # About the height at the center: the altitude of the scenery costs no digits of the relief.
    heights = hits.z.reshape(valid.shape) - spot_z[:, None]
    turned = hits.normal.reshape(*valid.shape, 3)
    if rules.rule == "averaged":
        nx, ny, nz = np.moveaxis(turned, 2, 0)
        turned = np.stack([cos * nx + sin * ny, cos * ny - sin * nx, nz], axis=2)
    k = len(which)
    rest = Rest(np.full(k, np.nan), np.full((k, 2), np.nan), np.zeros(k, dtype=bool), np.full(k, np.nan))
    for i in np.unique(which).tolist():
        rows, samples = np.flatnonzero(which == i), footings[i].samples
        if rules.rule == "averaged":
            planes = fit_averaged_planes(samples.xy, heights[rows], turned[rows], valid[rows])
        else:
            planes = fit_underside_planes(samples, heights[rows], valid[rows])
        put_rows(rest, rows, planes)
    return Rest(rest.height + spot_z, rest.gradient, rest.found, rest.margin), valid.mean(axis=1)


def _normal_inclination(normal: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
    """Return the angle in radians between unit normals and +z; unlike the arccosine, it's exact near 0."""
    return arctan2(hypot(normal[:, 0], normal[:, 1]), normal[:, 2])


@dataclass(frozen=True, eq=False, slots=True)
class Footing:
    """Points at which a vehicle's underside is compared with the ground."""

    samples: Samples  # points for the rest plane
    contact: Samples  # points at which gap and penetration are measured

    @classmethod
    def from_footprint(cls, footprint: Float[np.ndarray, "2 2"] | Underside, rules: SettleRules) -> Footing:
        """Return the sample points of a footprint by these rules."""
        if not isinstance(footprint, Underside):
            return cls(plate_samples(footprint, rules.n), plate_samples(footprint, rules.contact_n))
        contact = underside_samples(footprint, rules.contact_n).with_finite_height()
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
    """Return the largest depth in meters of each vehicle's underside below a surface such as water; 0 beside it."""
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
