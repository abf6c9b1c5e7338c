"""Convert the arrays of a block to rows of a plan; poses and angles are already rounded."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.assets.plan_assets import Assets
from hulldown.base.columns import row_objects
from hulldown.plan.coats import Coat
from hulldown.plan.config.schema import Config
from hulldown.plan.picture_names import picture_name
from hulldown.plan.rejection import Rejection
from hulldown.plan.row import Bounds, Box, FollowedPhotograph, LabelState, OnMap, PlannedVehicle, Row, round_field
from hulldown.planning.appearance import FIRST_COMPANION, FIRST_DISTRACTOR, sample_coats, sample_light_columns
from hulldown.planning.search.instance_table import Instances, articulated_bounds
from hulldown.planning.search.likeness import Following
from hulldown.planning.search.positions import Planned
from hulldown.planning.search.random_streams import Purpose
from hulldown.planning.search.stage import Site
from hulldown.planning.search.tables import MAX_ROLE_EXTRAS, Block, InstanceRole, Views
from hulldown.reading.scenery.geotiff import transform_map_points

_EXTRA_ROLES = {InstanceRole.COMPANION: "companion", InstanceRole.DISTRACTOR: "distractor"}
MAX_CUT_SHARE = 0.8  # of a labeled box that the frame cuts off, unless targets may lose more


def block_rows(planned: Planned, assets: Assets, *, hdri_weights: Float[np.ndarray, "2 h"]) -> list[Row]:
    """Return a row for each image of the block's positions that have a place, in the block's order."""
    block, views, table = planned.block, planned.views, planned.table
    config, draws, image, owner, held = block.config, block.draws, block.image, block.position_rows, block.positions
    instances = _instance_columns(planned)
    target = np.flatnonzero(table.role == InstanceRole.TARGET)
    background = held.background[owner].tolist()
    roles, labels = ["target"] * len(image), ["none" if is_empty else "full" for is_empty in background]
    targets = _planned_vehicles(instances, target[owner], views, roles=roles, labels=labels)
    extras = _extras_by_image_and_role(planned, instances)
    kinds = [rejection.key for rejection in Rejection]
    columns = {
        "index": image.tolist(),
        "image_id": (image + 1).tolist(),
        "file_name": list(map(picture_name, image.tolist())),
        "scenery": repeat(block.site.name, len(image)),
        "position": held.number[owner].tolist(),
        "shot": block.shot.tolist(),
        "world_from_camera": views.world_from_camera,
        "fov_x_deg": views.fov_x_deg.tolist(),
        **{key: repeat(value, len(image)) for key, value in _camera_columns(config).items()},
        **sample_light_columns(
            config.light, planned.weathers, hdri_weights, assets=assets, draws=draws, image=block.light_image_indices
        ),
        "weather": planned.weathers,
        "like": _followed_photographs(block, views),
        "sequence": block.given_poses(image).name.tolist(),
        "sample_seed": (draws.random_bits(Purpose.SAMPLE_SEED, image, 0, count=1)[:, 0] >> np.uint64(33)).tolist(),
        "background": background,
        "planned": [
            [each, *extras[j, InstanceRole.COMPANION], *extras[j, InstanceRole.DISTRACTOR]] for j, each in enumerate(targets)
        ],
        "rejected": [{k: n for k, n in zip(kinds, counts, strict=True) if n} for counts in planned.rejected.tolist()],
        "left_out": np.bincount(table.row[~table.is_placed], minlength=len(target))[owner].tolist(),
    }
    rows = row_objects(Row, columns)
    return [row for row, lost in zip(rows, planned.is_abandoned[owner].tolist(), strict=True) if not lost]


def _camera_columns(config: Config) -> dict[str, object]:
    camera = config.calibrated_intrinsics
    size: dict[str, object] = {"width": config.render.width, "height": config.render.height}
    if camera is None:
        return size
    matrix = tuple(map(tuple, camera.matrix.tolist()))
    return size | {"K": matrix} | ({"dist": camera.distortion} if config.camera.distortion else {})


def _followed_photographs(block: Block, views: Views) -> list[FollowedPhotograph | None]:
    followed: list[FollowedPhotograph | None] = [None] * len(views.sampled)
    if block.likeness is not None:
        photographs = block.likeness.photographs
        for i in np.flatnonzero(views.following != Following.RANGES).tolist():
            sampled, box = (photographs.file_names[photographs.image[of[i]]] for of in (views.sampled, views.followed))
            followed[i] = FollowedPhotograph(sampled, box if views.following[i] == Following.PHOTOGRAPH else None)
    return followed


def _planned_vehicles(
    instances: Mapping[str, Sequence[object]],
    instance: Int[np.ndarray, " n"],
    views: Views,
    *,
    roles: Iterable[str],
    labels: Iterable[str],
) -> list[PlannedVehicle]:
    """Return instances in images from the columns of `_instance_columns`."""
    of_instance = {key: [column[i] for i in instance.tolist()] for key, column in instances.items()}
    return row_objects(PlannedVehicle, {"role": roles, **of_instance, **view_columns(views), "label": labels})


def _extras_by_image_and_role(
    planned: Planned, instances: Mapping[str, Sequence[object]]
) -> defaultdict[tuple[int, int], list[PlannedVehicle]]:
    """Return the extras in each image, by role and the image's row in the block."""
    seen, views = planned.extra_views, planned.extra_views.views
    roles, extras = planned.table.role[seen.instance].tolist(), defaultdict(list)
    labels = extra_label_states(views, seen.pixels, planned.block.config)
    vehicles = _planned_vehicles(instances, seen.instance, views, roles=[_EXTRA_ROLES[role] for role in roles], labels=labels)
    for image, role, vehicle in zip(seen.image.tolist(), roles, vehicles, strict=True):
        extras[image, role].append(vehicle)
    return extras


def extra_label_states(views: Views, pixels: Bool[np.ndarray, " n"], config: Config) -> list[LabelState]:
    """Return "full" for extras within the limits, `annotate.below` for others with a class that cover `pixels`, else "none"."""
    given, camera = config.annotate, config.camera
    least_px, least_visible = given.min_box_px, given.min_visible_fraction
    most_cut = given.max_truncated_fraction
    if most_cut is None:
        most_cut = max(MAX_CUT_SHARE, camera.truncated_fraction[1])
    full = round_field("bbox", views.boxes.xywh)[:, 2:].min(axis=1) >= (camera.min_box_px if least_px is None else least_px)
    full &= round_field("visible_fraction", views.visible_fraction) >= (
        camera.visible_fraction[0] if least_visible is None else least_visible
    )
    full &= round_field("truncated_fraction", views.boxes.truncated_fraction) <= most_cut
    full &= round_field("air_contrast", views.air_contrast) >= config.weather.min_contrast
    below: LabelState = "ignored" if given.below == "ignored" else "none"
    pairs = zip(pixels.tolist(), full.tolist(), strict=True)
    return [("full" if enough else below) if shown else "none" for shown, enough in pairs]


def _instance_columns(planned: Planned) -> dict[str, Sequence[object]]:
    """Return columns of the fields of instances that don't depend on the camera."""
    block, table, settled = planned.block, planned.table, planned.table.settled
    turned = table.articulation() if block.config.placement.articulate else [{}] * len(table)
    models = [table.fleet.models[model] for model in table.model.tolist()]
    return {
        "vehicle": [model.shape.name for model in models],
        "category": [model.category for model in models],
        "world_from_vehicle": table.world_from_vehicle,
        "articulation": turned,
        "slope_deg": round_field("slope_deg", np.degrees(settled.tilt)).tolist(),
        "gap": round_field("gap", settled.gap).tolist(),
        "penetration": round_field("penetration", settled.penetration).tolist(),
        "tries": table.tries.tolist(),
        "bounds": rounded_vehicle_bounds(table),
        "geo": vehicle_map_places(table.world_from_vehicle, block.site),
        "track_id": _instance_track_ids(planned),
        "paint": _instance_coats(planned),
    }


def _instance_track_ids(planned: Planned) -> list[int | None]:
    block, table = planned.block, planned.table
    number = 1 + (block.positions.number[table.row] * len(InstanceRole) + table.role) * MAX_ROLE_EXTRAS + table.rank_in_role
    named = block.given_poses(block.positions.first_image).in_sequence[table.row]
    return [track if inside else None for track, inside in zip(number.tolist(), named.tolist(), strict=True)]


def _instance_coats(planned: Planned) -> list[list[Coat]]:
    """Draw the coats of each instance, by its number among the instances of its role with a place."""
    block, table = planned.block, planned.table
    places = np.zeros(len(table), dtype=np.int64)
    for role, first in ((InstanceRole.COMPANION, FIRST_COMPANION), (InstanceRole.DISTRACTOR, FIRST_DISTRACTOR)):
        placed = np.flatnonzero(table.is_placed & (table.role == role))
        rank = np.arange(len(placed)) - np.searchsorted(table.row[placed], table.row[placed])
        places[placed] = first + rank
    coats: list[list[Coat]] = [[]] * len(table)
    for model in np.unique(table.model).tolist():
        of_model = np.flatnonzero(table.model == model)
        name = table.fleet.models[model].shape.name
        paint = block.config.vehicle_paint(name)
        position = block.positions.number[table.row[of_model]]
        sampled = sample_coats(paint, block.draws, position=position, place=places[of_model])
        for i, coat in zip(of_model.tolist(), sampled, strict=True):
            coats[i] = coat
    return coats


def view_columns(views: Views) -> dict[str, Sequence[object]]:
    """Return columns of the fields of vehicles that follow from their views."""
    shares = {
        "visible_fraction": views.visible_fraction,
        "truncated_fraction": views.boxes.truncated_fraction,
        "air_contrast": views.air_contrast,
    }
    boxes = {"bbox": _rounded_boxes(views.boxes.xywh), "bbox_amodal": _rounded_boxes(views.boxes.amodal)}
    return {**boxes, **{key: round_field(key, share).tolist() for key, share in shares.items()}}


def rounded_vehicle_bounds(instances: Instances) -> list[Bounds]:
    """Return the bounds of each vehicle in its own frame, rounded."""
    bounds = articulated_bounds(instances.fleet, instances.model, instances.angles)
    return [Bounds(tuple(low), tuple(high)) for low, high in bounds.tolist()]


def vehicle_map_places(world_from_vehicle: Float[np.ndarray, "n 4 4"], site: Site) -> list[OnMap | None]:
    """Return places on the map, or None for vehicles without a pose and sceneries without a map."""
    if not site.crs:
        return [None] * len(world_from_vehicle)
    meters = np.round(world_from_vehicle[:, :2, 3] + site.origin[:2], 6)
    degrees = np.round(transform_map_points(meters, site.crs, "EPSG:4326"), 9)
    placed = np.isfinite(degrees).all(axis=1).tolist()
    keys = OnMap.__struct_fields__[1:]
    rows = np.concatenate([meters, degrees], axis=1).tolist()
    return [
        OnMap(crs=site.crs, **dict(zip(keys, row, strict=True))) if has_place else None
        for row, has_place in zip(rows, placed, strict=True)
    ]


def _rounded_boxes(boxes: Float[np.ndarray, "n 4"]) -> list[Box | None]:
    return [None if xywh[0] != xywh[0] else Box(*xywh) for xywh in round_field("bbox", boxes).tolist()]
