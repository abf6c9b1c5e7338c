"""Every limit of a plan, once: the config's keys that set it, its bounds, how it is recomputed, what rejects a try.

`hulldown check` recomputes all of them from a plan's rows, docs/limits.md lists them; the search rejects tries by those
of `planning/search_limits.py`. A new limit is one entry here, or there and one line where the search asks it.
"""

from __future__ import annotations

from planning.limit import Limit
from planning.search_limits import (
    AIR_CONTRAST,
    AREA,
    BOX_PX,
    CAMERA_GROUND,
    CAMERA_ROOM,
    CAMERA_WATER,
    COMPANION_DISTANCE,
    COMPANION_TRIES,
    DEGREES,
    DISTANCE,
    EQUATION_6,
    FORDING,
    GAP,
    GUESTS,
    METRES,
    OBSTACLES,
    PENETRATION,
    PIXELS,
    PLACE_TRIES,
    SHARE,
    SIZE,
    SKY,
    SLOPE,
    SLOPE_AT_SPOT,
    TRUNCATED,
    VALID_SHARE,
    VEHICLES,
    VISIBLE,
    vehicles_wanted,
)
from planning.weather_limits import WEATHER_LIMITS

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
    Limit(
        "paint, which is not what was drawn",
        tuple(
            f"assets.{kind}.paint.{key}"
            for kind in ("vehicles", "distractors")
            for key in ("materials", "colours", "hue_deg", "saturation", "value")
        ),
        "`paint` against the draw of the position",
        lambda r: r.painted_as_drawn,
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
        vehicles_wanted,
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
    AIR_CONTRAST,
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
    Limit(
        "air_contrast, which is not the poses'",
        (),
        "the visibility of `weather`, and the camera's distance from the centre of the vehicle's box",
        lambda r: r.says_its_air_contrast,
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
        "boxes, visible fraction, `air_contrast`, and whether any pixel shows it",
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
        ("light.hdris", "light.overcast"),
        "the HDRI's weight in the config, under clouds where rain or snow was drawn",
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
        "exposure_ev, which is not what its light asks for",
        ("light.exposure", "light.exposure_error_ev"),
        "the grey card under the row's light, and the draw of the image's index",
        lambda r: r.exposed_as_metered,
    ),
    Limit(
        "white_balance_k, which is not what was drawn",
        ("light.white_balance_error_k",),
        "the draw of the image's index",
        lambda r: r.balanced_as_drawn,
    ),
    Limit(
        "horizon_deg, which is not the HDRI's",
        ("light.backdrop",),
        "the HDRI's own horizon, or null",
        lambda r: r.backdrop_follows,
    ),
    *WEATHER_LIMITS,
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
