"""The labels of a row, computed again from its poses."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from placement.footprint import contact_samples
from placement.settle import gap_and_penetration
from planning.aiming import air_contrasts, lenses_of, visible_shares
from planning.labels import labels_of, pixels_shown
from planning.placing import CONTACT
from planning.row import Bounds, Box, Label, Row, rounded
from planning.schema import Config
from planning.stage import Placed, PlanStage, Site


def relabeled(row: Row, config: Config, stage: PlanStage) -> Row | None:
    """The row with all that follows from its poses: boxes, shares, labels, slopes, gaps, penetrations, bounds.

    Parameters
    ----------
    row
        A row of a plan, which somebody may have edited.
    config, stage
        The plan's config, and its assets.

    Returns
    -------
    The row, or None if it names a scenery, vehicle, or part that isn't there.
    """
    site = next((site for site in stage.sites if site.name == row.scenery), None)
    models = [stage.everything.get(vehicle.vehicle) for vehicle in row.planned]
    placed = [
        Placed(model, vehicle.world_from_vehicle[None], [vehicle.articulation])
        for model, vehicle in zip(models, row.planned, strict=True)
        if model is not None and vehicle.articulation.keys() <= set(model.shape.part_names[1:])
    ]
    if site is None or len(placed) < len(models):
        return None
    pictured = placed[1:] if row.empty else placed
    target, *guests = (
        replace(vehicle, **_labels(row, one, [other for other in pictured if other is not one], site, config))
        for one, vehicle in zip(placed, row.planned, strict=True)
    )
    assert isinstance(target, Row)
    n = len(row.companions)
    label: Label = "none" if row.background else "full"
    return replace(target, label=label, companions=guests[:n], distractors=guests[n:])


def _labels(row: Row, vehicle: Placed, others: list[Placed], site: Site, config: Config) -> dict[str, object]:
    """The fields of one vehicle that follow from poses."""
    poses, camera = vehicle.world_from_vehicle, row.world_from_camera[None]
    lens = lenses_of(config.render, np.radians([row.fov_x_deg]))
    boxes = vehicle.model.boxes.boxes(poses, camera, lens, vehicle.articulation)
    visible = visible_shares(site, vehicle, others, camera, intrinsics=lens, rays=config.camera.visibility_rays)
    contrast = air_contrasts(vehicle, camera, np.array([row.weather.visibility_m if row.weather else np.nan]))
    underside = vehicle.model.undersides[config.placement.contact]
    gap, penetration = gap_and_penetration(site.terrain, poses, contact_samples(underside, CONTACT))
    up = poses[:, :3, 2]
    label: Label = "none"
    if vehicle.model.category is not None:
        shown = pixels_shown(
            site,
            vehicle,
            others,
            world_from_camera=camera,
            fov_x=np.radians([row.fov_x_deg]),
            bbox=rounded("bbox", boxes.xywh),
            config=config,
        )
        (label,) = labels_of(
            config,
            bbox=boxes.xywh,
            visible=visible,
            truncated=boxes.truncated_fraction,
            contrast=contrast,
            pixels=shown,
        )
    low, high = rounded("bounds", vehicle.bounds())[0].tolist()
    return {
        "label": label,
        "bounds": Bounds(tuple(low), tuple(high)),
        "bbox": _box(boxes.xywh),
        "bbox_amodal": _box(boxes.amodal),
        "visible_fraction": _number("visible_fraction", visible),
        "truncated_fraction": _number("truncated_fraction", boxes.truncated_fraction),
        "air_contrast": _number("air_contrast", contrast),
        "slope_deg": _number("slope_deg", np.degrees(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]))),
        "gap": _number("gap", gap),
        "penetration": _number("penetration", penetration),
    }


def _number(key: str, values: Float[np.ndarray, "1"]) -> float:
    return float(rounded(key, values)[0])


def _box(boxes: Float[np.ndarray, "1 4"]) -> Box | None:
    return None if np.isnan(boxes[0, 0]) else Box(*rounded("bbox", boxes)[0].tolist())
