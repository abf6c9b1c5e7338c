"""Every limit of a plan, once: the config's keys that set it, its bounds, how it is recomputed, what rejects a try.

The search rejects tries by these entries, `hulldown check` recomputes all of them from a plan's rows, docs/limits.md
lists them. A new limit is one entry here, and one line where the search asks it.
"""

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


def _vehicles(config: Config) -> Bounds:
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

LIMITS = (
    Limit("pose", (), "`world_from_vehicle`: rigid", lambda r: r.rigid, of="vehicle"),
    Limit("category", (), "the vehicle's class in the config", lambda r: r.category_is_the_vehicles, of="vehicle"),
    AREA,
    SLOPE_AT_SPOT,
    VALID_SHARE,
    SLOPE,
    GAP,
    PENETRATION,
    Limit(
        "world_from_vehicle, which is not where the vehicle comes to rest",
        ("placement.rule", "placement.contact", "placement.footprint", "ground.fallback_z"),
        "the vehicle settled once more",
        lambda r: r.at_rest,
        of="vehicle",
    ),
    *(
        Limit(f"{key}, which is not the pose's", (), f"`{key}` against the pose", measure, of="vehicle")
        for key, measure in (
            ("slope_deg", lambda r: r.says("slope_deg", r.slope_deg, DEGREES)),
            ("gap", lambda r: r.says("gap", r.contact[0], METRES)),
            ("penetration", lambda r: r.says("penetration", r.contact[1], METRES)),
        )
    ),
    Limit(
        "articulation, the vehicle's own limits",
        ("placement.articulate",),
        "`articulation`: all movable parts within the limits of the vehicle, or none",
        lambda r: r.articulation_is_possible,
        of="vehicle",
    ),
    FORDING,
    OBSTACLES,
    SKY,
    VEHICLES,
    Limit(
        "vehicles in the image",
        ("placement.vehicles_per_image",),
        "the number of `companions`, and `left_out`",
        lambda r: r.vehicle_count,
        _vehicles,
    ),
    COMPANION_DISTANCE,
    Limit(
        "distractors, which are not those that were drawn",
        ("placement.distractors_per_image", "assets.distractors.weight", "assets.distractors.sceneries"),
        "`distractors` against the draw of the position",
        lambda r: r.distractors_as_drawn,
    ),
    Limit(
        "distance from what the camera is framed on",
        ("placement.distractor_distance",),
        "(x, y) of both poses",
        lambda r: r.distance_from_target,
        lambda config: config.placement.distractor_distance,
        of="distractor",
        slack=METRES,
    ),
    PLACE_TRIES,
    Limit("tries, which are not those that were rejected", (), "`rejected`", lambda r: r.tries_add_up, of="target"),
    *(
        Limit(
            "tries",
            (),
            f"`tries` of a {kind}",
            lambda r: r.said("tries"),
            lambda config: (1.0, COMPANION_TRIES),
            of=kind,
        )
        for kind in GUESTS
    ),
    Limit("world_from_camera", (), "the camera's pose: rigid", lambda r: r.camera_is_rigid),
    Limit(
        "fov_x_deg",
        ("camera.fov_x_deg",),
        "`fov_x_deg`",
        lambda r: r.said("fov_x_deg", of_image=True),
        lambda config: config.camera.fov_x_deg,
        slack=DEGREES,
    ),
    Limit(
        "camera.elevation_deg",
        ("camera.elevation_deg",),
        "the camera's place above the centre of the target's box",
        lambda r: r.elevation_deg,
        lambda config: config.camera.elevation_deg,
        slack=DEGREES,
    ),
    DISTANCE,
    EQUATION_6,
    CAMERA_GROUND,
    CAMERA_WATER,
    CAMERA_ROOM,
    *(
        Limit(f"{key}, which is not the poses'", (), f"`{key}` against the poses", measure, of="vehicle")
        for key, measure in (
            ("bounds", lambda r: r.says_its_bounds),
            ("bbox", lambda r: r.says_box("bbox", r.boxes.xywh)),
            ("bbox_amodal", lambda r: r.says_box("bbox_amodal", r.boxes.amodal)),
            ("truncated_fraction", lambda r: r.says("truncated_fraction", r.boxes.truncated_fraction, SHARE)),
        )
    ),
    Limit(
        "visible_fraction, which is not the poses'",
        ("camera.visibility_rays",),
        "rays from the camera, cast again",
        lambda r: r.says("visible_fraction", r.visible_fraction, SHARE),
        of="vehicle",
    ),
    TRUNCATED,
    BOX_PX,
    SIZE,
    VISIBLE,
    PIXELS,
    Limit(
        "label, which is not what the vehicle shows",
        tuple(f"annotate.{key}" for key in ("min_box_px", "min_visible_fraction", "max_truncated_fraction", "below")),
        "boxes, visible fraction, and whether any pixel shows it",
        lambda r: r.label_follows,
        of="vehicle",
    ),
    Limit(
        "cameras tried for an image at a place",
        ("camera.max_tries",),
        "`rejected` of the image, and places without a view of its position",
        lambda r: r.cameras_tried,
        lambda config: (1.0, config.camera.max_tries),
    ),
    Limit(
        "hdri, which has no weight",
        ("light.hdris",),
        "the HDRI's weight in the config",
        lambda r: r.hdri_has_weight,
    ),
    Limit(
        "scenery, which has no weight",
        ("assets.sceneries.weight",),
        "the scenery's weight in the config",
        lambda r: r.scenery_has_weight,
    ),
    Limit(
        "scenery, which the vehicle is not for",
        ("assets.vehicles.sceneries",),
        "the scenery's name against the vehicle's patterns",
        lambda r: r.scenery_is_for_vehicle,
        of="vehicle",
    ),
    Limit(
        "hdri_yaw_deg",
        ("light.yaw_deg",),
        "`hdri_yaw_deg`",
        lambda r: r.said("hdri_yaw_deg", of_image=True),
        lambda config: config.light.yaw_deg,
        slack=DEGREES,
    ),
    Limit(
        "strength",
        ("light.strength",),
        "`strength`",
        lambda r: r.said("strength", of_image=True),
        lambda config: config.light.strength,
        slack=SHARE,
    ),
    Limit(
        "weather, which is not what was drawn",
        ("weather.probability",),
        "`weather` against the draw of the image's index",
        lambda r: r.foggy_as_drawn,
    ),
    Limit(
        "weather.visibility_m",
        ("weather.visibility_m",),
        "`weather`; images without fog keep any",
        lambda r: np.where(np.isnan(r.visibility_m), r.config.weather.visibility_m[0], r.visibility_m),
        lambda config: config.weather.visibility_m,
        slack=METRES,
    ),
    Limit("sample_seed, which is not what was drawn", ("seed",), "the index and the seed", lambda r: r.seed_as_drawn),
    Limit(
        "width and height",
        ("render.width", "render.height"),
        "`width` and `height`",
        lambda r: r.image_size_is_the_configs,
    ),
    Limit(
        "index, position, shot and vehicle",
        (
            "budget.images_per_class",
            "budget.positions_per_vehicle",
            "budget.images_per_position",
            "budget.background_share",
            "budget.background_distractors",
        ),
        "what the budget gives the image; the images of each vehicle, and backgrounds, are counted, too",
        lambda r: r.in_budget,
    ),
    Limit(
        "what the shots of a position share",
        (),
        "the first shot of the position: scenery, vehicles, poses and articulations",
        lambda r: r.shares_with_first_shot,
    ),
)
