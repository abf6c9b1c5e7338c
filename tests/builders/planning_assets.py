"""A small world for planning tests: boxy vehicles with turret and gun, hills, trees, and rocks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hulldown.assets.plan_assets import Assets
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import transform_points
from hulldown.placement.terrain import Terrain
from hulldown.plan.config.schema import Config
from hulldown.planning.planner import POSITIONS_PER_BLOCK, Planner
from hulldown.tests.builders.shapes import box, scenery_of, surface, vehicle_of, vertices_at

CLASSES = {"t72": "tank", "leo": "tank", "ural": "truck"}
SCALES = {"t72": 1.0, "leo": 1.1, "ural": 0.8}
VEHICLE_ENTRIES = [{"path": f"vehicles/{name}.blend", "category": category} for name, category in CLASSES.items()]


def vehicle(name, scale=1.0):
    """Hull, turret, and gun; the gun is longer than the hull."""
    boxes = [
        box((-3.4, -1.7, 0), (3.4, 1.7, 1.4)),
        box((-1.2, -1.1, 1.4), (1.3, 1.1, 2.3)),
        box((1.3, -0.1, 1.7), (5.0, 0.1, 1.9)),
    ]
    mesh, _ = merge_meshes_with_sources(boxes)
    low, high = mesh.bounds
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    pivots = np.array([[0, 0, 0], np.array([0, 0, 1.4]) - foot, np.array([1.3, 0, 1.8]) - foot]) * scale
    moved = [Mesh((each.vertices - foot) * scale, each.faces) for each in boxes]
    return vehicle_of(*moved, name=name, pivots=pivots)


def hills(name, *, height=3.0, cells=40, size=240.0, trees=30, seed=0):
    """Rolling ground with trees and rocks on it."""
    rng = np.random.default_rng(seed)
    at = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = np.meshgrid(at, at, indexing="ij")
    phase = rng.uniform(0, 6, 4)
    z = height * (np.sin(x / 25 + phase[0]) * np.cos(y / 30 + phase[1]) + 0.4 * np.sin(x / 11 + y / 13 + phase[2]))
    ground = surface(at, at, z, "ground")
    poses = np.tile(np.eye(4), (trees, 1, 1))
    poses[:, :2, 3] = rng.uniform(-size / 2, size / 2, (trees, 2))
    poses[:, 2, 3] = Terrain(ground).top_hits(poses[:, :2, 3]).z
    meshes = (box((-1, -1, 0), (1, 1, 5)), box((-0.5, -0.5, -0.2), (0.5, 0.5, 0.8)))
    origin, which = (500000.0, 5400000.0, 120.0), rng.integers(0, 2, trees)
    return scenery_of(name, ground, origin=origin, obstacles=meshes, which=which, poses=poses)


def with_water(scenery, mesh, *poses):
    """The scenery with a water surface, in one or several places."""
    poses = np.array(poses or [np.eye(4)])
    wet = len(poses)
    return replace(
        scenery,
        obstacle_meshes=(*scenery.obstacle_meshes, mesh),
        instance_mesh=np.append(scenery.instance_mesh, [len(scenery.obstacle_meshes)] * wet),
        world_from_instance=np.concatenate([scenery.world_from_instance, poses]),
        instance_names=(*scenery.instance_names, *("water",) * wet),
        instance_gives_way=np.append(scenery.instance_gives_way, np.zeros(wet, bool)),
        instance_is_water=np.append(scenery.instance_is_water, np.ones(wet, bool)),
    )


def bare(name, origin_z=0.0):
    """A scenery from an empty file: the fallback plane."""
    return scenery_of(name, origin=(0.0, 0.0, origin_z))


def small_assets(*sceneries, vehicles=tuple(CLASSES), distractors=False):
    """Some of the vehicles on these sceneries, by default on hills and on a plane."""
    others = DISTRACTORS if distractors else {}
    return Assets(
        {name: vehicle(name, SCALES[name]) for name in vehicles},
        {name: CLASSES[name] for name in vehicles},
        {one.name: one for one in sceneries or (hills("hills"), bare("bare"))},
        ("noon", "dusk"),
        distractors={name: vehicle(name, scale) for name, scale in others.items()},
    )


DISTRACTORS = {"car": 0.5, "bales": 0.3, "bus": 0.9}
DISTRACTOR_ENTRIES = [
    {"path": "car.blend", "weight": 2.0},
    {"path": "bales.blend", "sceneries": ["hill*"]},
    {"path": "bus.blend", "category": "bus"},
]


def small_config(**sections):
    """A config with these changes; a planner takes the assets that it gets, whatever the config lists."""
    data = {
        "assets": {"vehicles": VEHICLE_ENTRIES, "sceneries": [{"path": "hills.blend"}, {"path": "bare.blend"}]},
        "budget": {"images_per_class": 11, "images_per_position": 4},
        "camera": {"visibility_rays": 64},
        "placement": {"max_gap": 2.0},
    }
    for name, section in sections.items():
        data[name] = {**data.get(name, {}), **section} if isinstance(section, dict) else section
    return Config.of(data)


def to_camera(shape, vehicle, row):
    """From the center of a vehicle's box, parts turned, to the camera, in the world."""
    vertices = vertices_at(shape, vehicle.articulation)
    center = transform_points(vehicle.world_from_vehicle, (vertices.min(axis=0) + vertices.max(axis=0))[None] / 2.0)[0]
    return row.world_from_camera[:3, 3] - center


def filled_share(size, row, measure):
    """Share of a row's image that a box of this width and height fills, by a measure of `camera.size_measure`."""
    width, height = size
    return {
        "height": height / row.height,
        "width": width / row.width,
        "diagonal": math.hypot(width, height) / math.hypot(row.width, row.height),
        "area": width * height / (row.width * row.height),
    }[measure]


def plan(config, assets):
    """Yield the rows of a plan in order."""
    planner = Planner(config, assets)
    for start in range(0, planner.budget.n_planned_positions, POSITIONS_PER_BLOCK):
        yield from planner.rows(start, min(start + POSITIONS_PER_BLOCK, planner.budget.n_planned_positions))
