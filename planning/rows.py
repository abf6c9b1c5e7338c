"""From arrays to the rows of a plan; poses and angles come rounded already, since all else follows from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from assets.library import Assets
from placement.rejection import Rejection
from placement.settle import Settled
from planning.company import Slot
from planning.draws import Draws
from planning.exposure import exposures
from planning.group import Group, Planned
from planning.labels import labels_of
from planning.light import Lights
from planning.paint import COMPANIONS, DISTRACTORS, Coat, draw_coats
from planning.row import Bounds, Box, PlannedVehicle, Row, picture_name, rounded
from planning.schema import Config
from planning.stage import Model, Placed


def rows_of(
    group: Group, planned: Planned, lights: Lights, *, config: Config, draws: Draws, assets: Assets
) -> list[Row]:
    """One row for each image of a group's positions that found a place, in the group's order."""
    settled, views, shape = planned.settled, planned.views, group.model.shape
    slope, gap, penetration = _contact(settled)
    position, tries = group.position.tolist(), planned.tries.tolist()
    found, left_out = planned.found.tolist(), planned.companions.left_out.tolist()
    kinds = [rejection.key for rejection in Rejection]
    bounds = _bounds(group.model, settled.world_from_vehicle, planned.articulation)
    coats = draw_coats(config.paint_of(shape.name), draws, position=group.position, place=0)
    strength = rounded("strength", lights.strength)
    hdris = [assets.hdris[i] for i in lights.hdri.tolist()]
    exposed = exposures(group.image, hdris, strength, light=config.light, assets=assets, draws=draws)
    columns = zip(
        group.owner.tolist(),
        group.shot.tolist(),
        group.image.tolist(),
        views.world_from_camera,
        rounded("fov_x_deg", np.degrees(views.fov_x)).tolist(),
        rounded("bbox", views.bbox).tolist(),
        rounded("bbox_amodal", views.bbox_amodal).tolist(),
        rounded("visible_fraction", views.visible_fraction).tolist(),
        rounded("truncated_fraction", views.truncated_fraction).tolist(),
        rounded("air_contrast", views.air_contrast).tolist(),
        hdris,
        rounded("hdri_yaw_deg", np.degrees(lights.yaw)).tolist(),
        strength.tolist(),
        [None if horizon != horizon else horizon for horizon in exposed.horizon_deg.tolist()],
        exposed.ev.tolist(),
        exposed.white_balance_k.tolist(),
        lights.air.weathers(),
        lights.sample_seed.tolist(),
        planned.rejected.tolist(),
        _guests(group, planned, "companion", config=config, draws=draws),
        _guests(group, planned, "distractor", config=config, draws=draws),
        strict=True,
    )
    width, height = config.render.width, config.render.height
    return [
        Row(
            vehicle=shape.name,
            category=group.model.category,
            world_from_vehicle=settled.world_from_vehicle[i],
            articulation=planned.articulation[i],
            bbox=Box(*bbox),
            bbox_amodal=Box(*amodal),
            visible_fraction=visible,
            truncated_fraction=truncated,
            slope_deg=slope[i],
            gap=gap[i],
            penetration=penetration[i],
            tries=tries[i],
            index=image,
            image_id=image + 1,
            file_name=picture_name(image),
            scenery=group.site.name,
            position=position[i],
            shot=shot,
            world_from_camera=camera,
            fov_x_deg=fov,
            width=width,
            height=height,
            hdri=hdri,
            hdri_yaw_deg=yaw,
            strength=strength,
            horizon_deg=horizon,
            exposure_ev=exposure,
            white_balance_k=kelvin,
            weather=weather,
            sample_seed=seed,
            background=group.background,
            label="none" if group.background else "full",
            bounds=bounds[i],
            paint=coats[i],
            air_contrast=contrast,
            companions=companions,
            distractors=distractors,
            rejected={kind: n for kind, n in zip(kinds, rejected, strict=True) if n},
            left_out=left_out[i],
        )
        for (
            i, shot, image, camera, fov, bbox, amodal, visible, truncated, contrast,
            hdri, yaw, strength, horizon, exposure, kelvin, weather, seed, rejected, companions, distractors,
        ) in columns
        if found[i]
    ]  # fmt: skip


def _guests(group: Group, planned: Planned, kind: str, *, config: Config, draws: Draws) -> list[list[PlannedVehicle]]:
    """For each image of a group its guests of one kind, one slot after the other, as its camera sees them."""
    owner = group.owner.tolist()
    records: list[list[PlannedVehicle]] = [[] for _ in owner]
    place = np.full(len(group.position), COMPANIONS if kind == "companion" else DISTRACTORS)  # of the next one
    for slot in planned.companions.slots:
        if slot.guests.kind != kind:
            continue
        views = slot.views
        labels = labels_of(
            config,
            bbox=views.bbox,
            visible=views.visible_fraction,
            truncated=views.truncated_fraction,
            contrast=views.air_contrast,
            pixels=slot.pixels,
        )
        model, tries, poses = slot.model.tolist(), slot.tries.tolist(), slot.settled.world_from_vehicle
        slope, gap, penetration = _contact(slot.settled)
        bounds = _slot_bounds(slot.guests.models, slot.model, poses, slot.articulation)
        coats = _slot_coats(slot, config, draws, position=group.position, place=place)
        place = place + (slot.model >= 0)
        bbox, amodal = (_boxes(slot.views.bbox), _boxes(slot.views.bbox_amodal))
        visible, truncated, contrast = (
            rounded(key, getattr(slot.views, key)).tolist()
            for key in ("visible_fraction", "truncated_fraction", "air_contrast")
        )
        for image, i in enumerate(owner):
            if model[i] < 0:
                continue
            records[image].append(
                PlannedVehicle(
                    vehicle=slot.guests.models[model[i]].shape.name,
                    category=slot.guests.models[model[i]].category,
                    world_from_vehicle=poses[i],
                    articulation=slot.articulation[i],
                    bbox=bbox[image],
                    bbox_amodal=amodal[image],
                    visible_fraction=visible[image],
                    truncated_fraction=truncated[image],
                    slope_deg=slope[i],
                    gap=gap[i],
                    penetration=penetration[i],
                    tries=tries[i],
                    label=labels[image],
                    bounds=bounds[i],
                    paint=coats[i],
                    air_contrast=contrast[image],
                )
            )
    return records


def _contact(settled: Settled) -> tuple[list[float], list[float], list[float]]:
    """Slope in degrees, gap and penetration, as rows have them."""
    slope = rounded("slope_deg", np.degrees(settled.tilt)).tolist()
    return slope, rounded("gap", settled.gap).tolist(), rounded("penetration", settled.penetration).tolist()


def _bounds(model: Model, poses: Float[np.ndarray, "n 4 4"], articulation: list[dict[str, float]]) -> list[Bounds]:
    """What boxes hold a vehicle in its own frame."""
    corners = rounded("bounds", Placed(model, poses, articulation).bounds()).tolist()
    return [Bounds(tuple(low), tuple(high)) for low, high in corners]


def _slot_bounds(
    models: Sequence[Model],
    which: Int[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
    turned: list[dict[str, float]],
) -> dict[int, Bounds]:
    """The same of guests, of which each position has another one, or none."""
    found: dict[int, Bounds] = {}
    for k in np.unique(which[which >= 0]).tolist():
        rows = np.flatnonzero(which == k)
        found |= zip(rows.tolist(), _bounds(models[k], poses[rows], [turned[i] for i in rows.tolist()]), strict=True)
    return found


def _slot_coats(
    slot: Slot, config: Config, draws: Draws, *, position: Int[np.ndarray, " n"], place: Int[np.ndarray, " n"]
) -> dict[int, list[Coat]]:
    """The coats of guests, of which each position has another one, or none."""
    found: dict[int, list[Coat]] = {}
    for k in np.unique(slot.model[slot.model >= 0]).tolist():
        rows = np.flatnonzero(slot.model == k)
        paint = config.paint_of(slot.guests.models[k].shape.name)
        found |= zip(rows.tolist(), draw_coats(paint, draws, position=position[rows], place=place[rows]), strict=True)
    return found


def _boxes(boxes: Float[np.ndarray, "n 4"]) -> list[Box | None]:
    return [None if xywh[0] != xywh[0] else Box(*xywh) for xywh in rounded("bbox", boxes).tolist()]
