"""Compare a plan with a new plan of its config and assets, and its labels with those that follow from its poses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice

import msgspec
import numpy as np
import orjson
from msgspec.structs import replace

from hulldown.assets.plan_assets import Assets
from hulldown.base.arguments import AnyPath
from hulldown.base.errors import ConfigError
from hulldown.base.terminal import progress_bar
from hulldown.camera.cameras import Cameras
from hulldown.placement.settle import gap_and_penetration
from hulldown.plan.library import load_planned_library
from hulldown.plan.plan_file import Plan, read_plan
from hulldown.plan.row import LabelState, PlannedVehicle, Row, encode_line, round_field, row_fields
from hulldown.planning.block_rows import extra_label_states, rounded_vehicle_bounds, vehicle_map_places, view_columns
from hulldown.planning.planner import POSITIONS_PER_BLOCK, Planner
from hulldown.planning.search.instance_table import Instances
from hulldown.planning.search.placing import skylit_vehicle_mask
from hulldown.planning.search.stage import PlanStage, Site
from hulldown.planning.search.tables import nan_views
from hulldown.planning.search.views import views_of_extras_and_shown_mask
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits

NUMBER_TOLERANCE = 1e-6  # for meters, degrees, pixels, and shares by other processors
MAX_PLAN_FINDINGS = 1000
MAX_VALUE_CHARACTERS = 80  # in a finding


def check_plan(
    plan: AnyPath, assets: Assets | None = None, *, cache: AnyPath | None = None, limits: ReadLimits = DEFAULT_LIMITS
) -> list[str]:
    """Compare a plan with its config.

    Reads a plan and the assets it names; plans again, and returns a line for each field that differs from the new plan,
    or from what the poses give.

    Parameters
    ----------
    plan
        The plan.
    cache
        Cache of assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.
    """
    plan = plan if isinstance(plan, Plan) else read_plan(plan)
    assets = assets or load_planned_library(plan, cache=cache, limits=limits).assets
    planner = Planner(plan.config, assets, poses=plan.header.poses)
    followed, photographs = plan.header.photographs, planner.photographs
    if followed is not None and (photographs is None or photographs.sha256 != followed.sha256):
        raise ConfigError(
            f"the boxes of camera.like ({followed.path}) aren't what they were when this was planned",
            path=plan.path,
            remedy="plan again with `hulldown plan`, or bring the old file back",
        )
    with progress_bar("checking") as advance:
        return find_plan_row_problems(plan, planner, progress=advance)


def find_plan_row_problems(plan: Plan, planner: Planner, *, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Do `check_plan` with the planner of the plan's config, which plans can share."""
    budget, findings, hidden = planner.budget, [], 0
    if len(plan) != budget.n_images:
        findings.append(f"{len(plan)} images, the budget is {budget.n_images}")
    if list(plan.header.left_out) != list(planner.pairs.left_out):
        findings.append("the header's left_out differs from what its config gives")
    rows, start, done = iter(plan), 0, 0
    while block := list(islice(rows, 1)):
        stop = min(start + POSITIONS_PER_BLOCK, budget.n_planned_positions)
        wanted = planner.rows(start, stop) if start < stop else []
        block += islice(rows, max(len(wanted), 1) - 1)
        for row, planned in zip(block, wanted, strict=False):
            if encode_line(row) != encode_line(planned):
                lines = list(_row_findings(row, planned, planner)) if len(findings) < MAX_PLAN_FINDINGS else [""]
                hidden += max(len(findings) + len(lines) - MAX_PLAN_FINDINGS, 0)
                findings += lines[: MAX_PLAN_FINDINGS - len(findings)]
        start, done = stop, done + len(block)
        if progress:
            progress(done, len(plan))
    return findings + ([f"and {hidden:,} more"] if hidden else [])


def _row_findings(row: Row, planned: Row, planner: Planner) -> Iterator[str]:
    stage = planner.stage
    known = site_and_posed_vehicles(row, stage)
    inconsistent = dict(_row_differences(row, relabel_row(row, *known, stage))) if known else {}
    for k in _unlit_vehicle_indices(*known, stage) if known else ():
        yield f"image {row.index}: planned[{k}], {row.planned[k].vehicle}, is where no light of the sky reaches it"
    for key, (value, wanted) in inconsistent.items():
        yield f"image {row.index}: {key} is {value}, its poses give {wanted}"
    for key, (value, wanted) in _row_differences(row, planned):
        if key not in inconsistent:
            yield f"image {row.index}: {key} is {value}, planned is {wanted}"


def _row_differences(row: Row, planned: Row) -> Iterator[tuple[str, tuple[str, str]]]:
    first, second = (orjson.loads(encode_line(each)) for each in (row, planned))
    yield from _differing_fields(first, second, [key for key in row_fields(Row) if key != "planned"])
    vehicles = first["planned"], second["planned"]
    if len(vehicles[0]) != len(vehicles[1]):
        yield "number of planned", (str(len(vehicles[0])), str(len(vehicles[1])))
    for k, pair in enumerate(zip(*vehicles, strict=False)):
        yield from _differing_fields(*pair, row_fields(PlannedVehicle), f"planned[{k}].")


def _differing_fields(
    first: Mapping[str, object], second: Mapping[str, object], keys: Iterable[str], place: str = ""
) -> Iterator[tuple[str, tuple[str, str]]]:
    for key in keys:
        pair = first.get(key), second.get(key)  # lines leave out some fields that are null
        if not _are_values_close(*pair):
            yield place + key, (_short_json(pair[0]), _short_json(pair[1]))


def _are_values_close(first: object, second: object) -> bool:
    if isinstance(first, float) and isinstance(second, float):
        return math.isclose(first, second, rel_tol=0.0, abs_tol=NUMBER_TOLERANCE)
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_are_values_close, first, second))
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(_are_values_close(first[key], second[key]) for key in first)
    return bool(first == second)


def _short_json(value: object) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[:MAX_VALUE_CHARACTERS] + "..."


def site_and_posed_vehicles(row: Row, stage: PlanStage) -> tuple[Site, Instances] | None:
    """Return a row's site and posed vehicles; None for an unknown scenery, vehicle, or part."""
    site = next((site for site in stage.sites if site.name == row.scenery), None)
    parts = {model.shape.name: set(model.shape.part_names[1:]) for model in stage.fleet.models}
    complete = [v.vehicle in parts and v.articulation.keys() <= parts[v.vehicle] for v in row.planned]
    if site is None or not all(complete):
        return None
    return site, Instances.from_poses(
        stage.fleet,
        [vehicle.vehicle for vehicle in row.planned],
        np.array([vehicle.world_from_vehicle for vehicle in row.planned]),
        [vehicle.articulation for vehicle in row.planned],
    )


def relabel_row(row: Row, site: Site, vehicles: Instances, stage: PlanStage) -> Row:
    """Return an edited row with all values that follow from its poses computed anew, such as boxes and shares."""
    columns = _label_columns(row, site, vehicles, stage)
    values = zip(row.planned, *columns.values(), strict=True)
    target, *extras = (replace(vehicle, **dict(zip(columns, own, strict=True))) for vehicle, *own in values)
    label: LabelState = "none" if row.background else "full"
    return replace(row, planned=[replace(target, label=label), *extras])


def _unlit_vehicle_indices(site: Site, vehicles: Instances, stage: PlanStage) -> list[int]:
    """Return which vehicles are where the config allows none: in a closed hall, or inside a hill."""
    if stage.config.placement.indoors:
        return []
    return np.flatnonzero(~skylit_vehicle_mask(site, vehicles)).tolist()


def _label_columns(row: Row, site: Site, vehicles: Instances, stage: PlanStage) -> dict[str, Sequence[object]]:
    config, k = stage.config, len(row.planned)
    # Pairs of each vehicle and another one, which isn't the target if that is left out of the picture.
    subject, other = np.nonzero(~np.eye(k, dtype=bool) & ~(row.hides_target & (np.arange(k) == 0)))
    cameras = Cameras(row.intrinsics, np.tile(row.world_from_camera, (k, 1, 1)))
    visibility = np.full(k, row.weather.visibility_m if row.weather else np.nan)
    others = dataclasses.replace(vehicles.take(other), row=subject)
    views, pixels = views_of_extras_and_shown_mask(
        site, vehicles, others, views=nan_views(k), cameras=cameras, visibility_m=visibility, rays=config.camera.visibility_rays
    )
    labels = extra_label_states(views, pixels, config)
    poses = vehicles.world_from_vehicle
    gap, penetration = gap_and_penetration(site.terrain, poses, stage.fleet.contacts.take(vehicles.model))
    up = poses[:, :3, 2]
    numbers = {"slope_deg": np.degrees(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]))}
    numbers |= {"gap": gap, "penetration": penetration}
    return {
        **view_columns(views),
        **{key: round_field(key, values).tolist() for key, values in numbers.items()},
        "label": labels,
        "bounds": rounded_vehicle_bounds(vehicles),
        "geo": vehicle_map_places(poses, site),
    }
