"""The labels of a row, computed again from its poses."""

from __future__ import annotations

import dataclasses

import numpy as np
from msgspec.structs import replace

from hulldown.camera.lenses import lenses
from hulldown.placement.contact import gap_and_penetration
from hulldown.planning.config.schema import Config
from hulldown.planning.row import Label, Row, rounded
from hulldown.planning.rows import bounds_in_rows, geo_in_rows, records, seen_in_rows
from hulldown.planning.search.instances import Instances
from hulldown.planning.search.labels import labels_of
from hulldown.planning.search.stage import Fleet, PlanStage, Site
from hulldown.planning.search.views import no_views, views_of_others


def relabeled(row: Row, config: Config, stage: PlanStage) -> Row | None:
    """Return an edited row with new values that follow from its poses: boxes, shares, labels, gaps, and the like.

    None is returned for a row with an unknown scenery, vehicle, or part.
    """
    site = next((site for site in stage.sites if site.name == row.scenery), None)
    models = [stage.everything.get(vehicle.vehicle) for vehicle in row.planned]
    complete = [
        model is not None and vehicle.articulation.keys() <= set(model.shape.part_names[1:])
        for model, vehicle in zip(models, row.planned, strict=True)
    ]
    if site is None or not all(complete):
        return None
    target, *extras = (
        replace(vehicle, **labels)
        for vehicle, labels in zip(row.planned, _labels(row, site, stage.fleet, config), strict=True)
    )
    n = len(row.companions)
    label: Label = "none" if row.background else "full"
    return replace(row, target=replace(target, label=label), companions=extras[:n], distractors=extras[n:])


def _labels(row: Row, site: Site, fleet: Fleet, config: Config) -> list[dict[str, object]]:
    """Return the fields of each vehicle that follow from poses."""
    planned = row.planned
    k = len(planned)
    vehicles = Instances.of(
        fleet,
        [vehicle.vehicle for vehicle in planned],
        np.array([vehicle.world_from_vehicle for vehicle in planned]),
        [vehicle.articulation for vehicle in planned],
    )
    # Pairs of each vehicle and another one, which isn't the target if that is left out of the picture.
    subject, other = np.nonzero(~np.eye(k, dtype=bool) & ~(row.empty & (np.arange(k) == 0)))
    cameras = dataclasses.replace(no_views(k), lens=lenses(row.intrinsics).spread(k))
    cameras.world_from_camera[:] = row.world_from_camera
    visibility = np.full(k, row.weather.visibility_m if row.weather else np.nan)
    others = dataclasses.replace(vehicles.take(other), row=subject)
    views, pixels = views_of_others(site, vehicles, others, cameras=cameras, visibility_m=visibility, config=config)
    labels = labels_of(views, pixels, config)
    poses = vehicles.world_from_vehicle
    gap, penetration = gap_and_penetration(site.terrain, poses, fleet.contacts.of(vehicles.model))
    up = poses[:, :3, 2]
    numbers = {"slope_deg": np.degrees(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]))}
    numbers |= {"gap": gap, "penetration": penetration}
    columns = {key: rounded(key, values).tolist() for key, values in numbers.items()}
    columns |= {"label": labels, "bounds": bounds_in_rows(vehicles), "geo": geo_in_rows(poses, site)}
    return [seen | rest for seen, rest in zip(seen_in_rows(views), records(columns), strict=True)]
