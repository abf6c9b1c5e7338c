"""The limits by which the search rejects its tries, of places and of cameras; `planning/limits.py` has all limits."""

from __future__ import annotations

from typing import Literal

import numpy as np

from placement.rejection import Rejection
from planning.limit import INFINITY, Bounds, Limit
from planning.schema import Config

# Poses are exact in the file; what is recomputed from them differs by what it was rounded to.
METRES, DEGREES, SHARE = 1e-6, 1e-6, 1e-9
SIZED = 1e-9  # of the wanted size: the solve and the box's own projection round differently
COMPANION_TRIES = 50  # places for one companion or distractor before the target is moved elsewhere
GUESTS: tuple[Literal["companion", "distractor"], ...] = ("companion", "distractor")


def _factors(config: Config) -> Bounds | None:
    camera = config.camera
    if camera.size_measure != "paper":
        return None
    (low, high), (least, most) = camera.distance_factor, camera.target_fraction
    return low / most, high / least


def _sizes(config: Config) -> Bounds | None:
    return None if config.camera.size_measure == "paper" else config.camera.target_fraction


def vehicles_wanted(config: Config) -> Bounds:
    """How many vehicles of classes an image is to have."""
    return config.placement.vehicles_per_image


# Where a vehicle stands.
AREA = Limit(
    "place",
    ("placement.margin",),
    "(x, y) of the pose, against the scenery's extent",
    lambda r: r.inside_the_area,
    of="target",
)
SLOPE_AT_SPOT = Limit(
    "slope at the spot",
    ("placement.max_slope_deg",),
    "the ground's normal below the pose's origin",
    lambda r: r.slope_at_spot_deg,
    lambda config: (0.0, config.placement.max_slope_deg),
    of="vehicle",
    slack=DEGREES,
    above=Rejection.TOO_STEEP,
)
VALID_SHARE = Limit(
    "share of the footprint's rays that meet ground",
    ("placement.min_valid_share", "placement.footprint"),
    "the vehicle settled once more",
    lambda r: r.settled.share,
    lambda config: (config.placement.min_valid_share, 1.0),
    of="vehicle",
    slack=SHARE,
    below=Rejection.OVERHANG,
)
SLOPE = Limit(
    "slope_deg",
    ("placement.max_slope_deg",),
    "the pose's up axis",
    lambda r: r.slope_deg,
    lambda config: (0.0, config.placement.max_slope_deg),
    of="vehicle",
    slack=DEGREES,
    above=Rejection.MEAN_TOO_STEEP,
)
GAP = Limit(
    "gap",
    ("placement.max_gap",),
    "the underside in its pose, above the ground",
    lambda r: r.contact[0],
    lambda config: (0.0, config.placement.max_gap),
    of="vehicle",
    slack=METRES,
    above=Rejection.GAP,
)
PENETRATION = Limit(
    "penetration",
    ("placement.max_penetration",),
    "the underside in its pose, below the ground",
    lambda r: r.contact[1],
    lambda config: (0.0, config.placement.max_penetration),
    of="vehicle",
    slack=METRES,
    above=Rejection.PENETRATION,
)
FORDING = Limit(
    "depth in water",
    ("placement.fording_depth",),
    "the underside in its pose, below the water above it",
    lambda r: r.depth_in_water,
    lambda config: (0.0, config.placement.fording_depth),
    of="vehicle",
    slack=METRES,
    above=Rejection.WATER,
)
SKY = Limit(
    "sky above the vehicle",
    (),
    "rays upwards from its top against obstacles",
    lambda r: r.sees_sky,
    of="vehicle",
    below=Rejection.DARK,
)
OBSTACLES = Limit(
    "placement.obstacle_clearance",
    ("placement.obstacle_clearance",),
    "the boxes of its parts and the scenery's triangles",
    lambda r: r.clear_of_obstacles,
    of="vehicle",
    below=Rejection.OBSTACLE,
)
VEHICLES = Limit(
    "placement.vehicle_clearance",
    ("placement.vehicle_clearance",),
    "the boxes of the parts of every two vehicles",
    lambda r: r.clear_of_vehicles,
    of="vehicle",
    below=Rejection.VEHICLE,
)
COMPANION_DISTANCE = Limit(
    "distance from the target",
    ("placement.companion_distance",),
    "(x, y) of both poses",
    lambda r: r.distance_from_target,
    lambda config: config.placement.companion_distance,
    of="companion",
    slack=METRES,
)
PLACE_TRIES = Limit(
    "tries",
    ("placement.max_tries",),
    "`tries`",
    lambda r: r.said("tries"),
    lambda config: (1.0, config.placement.max_tries),
    of="target",
)
# Where a camera is and what it sees.
DISTANCE = Limit(
    "camera.distance_m",
    ("camera.distance_m",),
    "the camera's place and the centre of the target's box",
    lambda r: r.distance,
    lambda config: config.camera.distance_m,
    slack=METRES,
    below=Rejection.DISTANCE,
    above=Rejection.DISTANCE,
)
AIR_CONTRAST = Limit(
    "air_contrast",
    ("weather.min_contrast",),
    "the visibility of `weather`, and the camera's distance from the centre of the target's box",
    lambda r: r.air_contrast,
    lambda config: (config.weather.min_contrast, 1.0),
    slack=SHARE,
    below=Rejection.FAINT,
)
EQUATION_6 = Limit(
    "distance as a multiple of that of equation 6 at target fraction 1",
    ("camera.distance_factor", "camera.target_fraction", "camera.size_measure"),
    "distance, field of view, the target's smallest dimension",
    lambda r: r.distance / r.baseline_distance,
    _factors,
    relative=SHARE,
)
CAMERA_GROUND = Limit(
    "the camera's place (ground)",
    ("camera.ground_clearance",),
    "the ground below the camera",
    lambda r: ~np.isin(r.camera_rejection, (Rejection.CAMERA_OFF_GROUND, Rejection.CAMERA_LOW)),
)
CAMERA_ROOM = Limit(
    "the camera's place (obstacles and vehicles)",
    ("camera.obstacle_clearance",),
    "obstacles and boxes of vehicles about the camera",
    lambda r: ~np.isin(r.camera_rejection, (Rejection.CAMERA_OBSTACLE, Rejection.CAMERA_VEHICLE)),
)
CAMERA_WATER = Limit(
    "the camera's place (water)",
    ("camera.ground_clearance",),
    "the water above or below the camera",
    lambda r: r.camera_rejection != Rejection.CAMERA_WATER,
)
TRUNCATED = Limit(
    "truncated_fraction",
    ("camera.truncated_fraction",),
    "the target's exact boxes",
    lambda r: r.boxes.truncated_fraction,
    lambda config: config.camera.truncated_fraction,
    slack=SHARE,
    below=Rejection.TRUNCATION,
    above=Rejection.TRUNCATION,
)
BOX_PX = Limit(
    "smaller side of the box",
    ("camera.min_box_px",),
    "the target's exact box",
    lambda r: r.boxes.xywh[:, 2:].min(axis=1),
    lambda config: (config.camera.min_box_px, INFINITY),
    slack=1e-6,
    below=Rejection.SMALL,
)
SIZE = Limit(
    "share of the image that the box fills",
    ("camera.target_fraction", "camera.size_measure"),
    "the target's exact box, frame or no frame",
    lambda r: r.share_of_image,
    _sizes,
    relative=SIZED,
    below=Rejection.SIZE,
    above=Rejection.SIZE,
)
VISIBLE = Limit(
    "visible_fraction",
    ("camera.visible_fraction", "camera.visibility_rays"),
    "rays from the camera, cast again",
    lambda r: r.visible_fraction,
    lambda config: config.camera.visible_fraction,
    slack=SHARE,
    below=Rejection.HIDDEN,
    above=Rejection.EXPOSED,
)
PIXELS = Limit(
    "pixels that show the target",
    (),
    "a ray through the centre of each pixel of its box: at least one",
    lambda r: r.pixels_shown,
    of="target",
    below=Rejection.HIDDEN,
)
