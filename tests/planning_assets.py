"""A small world for planning tests: boxy vehicles with turret and gun, hills, trees and rocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hulldown.assets.library import Assets
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.meshes import Mesh, merge
from hulldown.placement.terrain import Terrain
from hulldown.planning.config.config_file import parse_config

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = np.array([face for a, b, c, d in QUADS for face in ([a, b, c], [a, c, d])])
CLASSES = {"t72": "tank", "leo": "tank", "ural": "truck"}
VEHICLE_ENTRIES = [{"path": f"vehicles/{name}.blend", "category": category} for name, category in CLASSES.items()]


def box(low, high):
    low, high = np.array(low, float), np.array(high, float)
    return Mesh(low + CORNERS * (high - low), FACES)


def vehicle(name, scale=1.0):
    """Hull, turret and gun; the gun reaches beyond the hull."""
    boxes = [
        box((-3.4, -1.7, 0), (3.4, 1.7, 1.4)),
        box((-1.2, -1.1, 1.4), (1.3, 1.1, 2.3)),
        box((1.3, -0.1, 1.7), (5.0, 0.1, 1.9)),
    ]
    mesh, _ = merge(boxes)
    low, high = mesh.bounds
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return VehicleShape(
        name=name,
        mesh=Mesh((mesh.vertices - foot) * scale, mesh.faces, name),
        vertex_part=np.repeat(np.arange(3), 8),
        part_names=("hull", "turret", "gun"),
        part_parent=np.array([-1, 0, 1]),
        part_pivot=np.array([[0, 0, 0], np.array([0, 0, 1.4]) - foot, np.array([1.3, 0, 1.8]) - foot]) * scale,
        part_axis=np.array([[0, 0, 1.0], [0, 0, 1.0], [0, -1.0, 0]]),
        part_limits=np.array([[0, 0], [-np.pi, np.pi], [-0.1, 0.35]]),
        vehicle_from_file=np.eye(4),
    )


def hills(name, *, height=3.0, cells=40, size=240.0, trees=30, seed=0):
    """Rolling ground with trees and rocks on it."""
    rng = np.random.default_rng(seed)
    at = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = np.meshgrid(at, at, indexing="ij")
    phase = rng.uniform(0, 6, 4)
    z = height * (np.sin(x / 25 + phase[0]) * np.cos(y / 30 + phase[1]) + 0.4 * np.sin(x / 11 + y / 13 + phase[2]))
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    ground = Mesh(np.stack([x.ravel(), y.ravel(), z.ravel()], 1), faces, "ground")
    poses = np.tile(np.eye(4), (trees, 1, 1))
    poses[:, :2, 3] = rng.uniform(-size / 2, size / 2, (trees, 2))
    poses[:, 2, 3] = Terrain(ground).top_hits(poses[:, :2, 3]).z
    return Scenery(
        name=name,
        origin=np.array([500000.0, 5400000.0, 120.0]),
        ground=ground,
        ground_names=("ground",),
        face_ground=np.zeros(len(faces), dtype=np.int64),
        obstacle_meshes=(box((-1, -1, 0), (1, 1, 5)), box((-0.5, -0.5, -0.2), (0.5, 0.5, 0.8))),
        instance_mesh=rng.integers(0, 2, trees),
        world_from_instance=poses,
        instance_names=tuple(f"tree {k}" for k in range(trees)),
        instance_gives_way=np.zeros(trees, dtype=bool),
        instance_is_water=np.zeros(trees, dtype=bool),
        removed_names=(),
        scenery_from_file=np.eye(4),
    )


def with_water(scenery, mesh, *poses):
    """The scenery with a water surface, in one place or in several."""
    poses = np.array(poses or [np.eye(4)])
    dry, wet = len(scenery.instance_names), len(poses)
    return replace(
        scenery,
        obstacle_meshes=(*scenery.obstacle_meshes, mesh),
        instance_mesh=np.append(scenery.instance_mesh, [len(scenery.obstacle_meshes)] * wet),
        world_from_instance=np.concatenate([scenery.world_from_instance, poses]),
        instance_names=(*scenery.instance_names, *("water",) * wet),
        instance_gives_way=np.append(scenery.instance_gives_way, np.zeros(wet, bool)),
        instance_is_water=np.append(np.zeros(dry, bool), np.ones(wet, bool)),
    )


def sheet(low, high, z=0.0):
    """A level rectangle."""
    (a, b), (c, d) = low, high
    corners = np.array([[a, b, z], [c, b, z], [c, d, z], [a, d, z]], float)
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "sheet")


def bare(name, origin_z=0.0):
    """A scenery whose file has nothing in it: the fallback plane."""
    return Scenery(
        name=name,
        origin=np.array([0.0, 0.0, origin_z]),
        ground=None,
        ground_names=(),
        face_ground=np.zeros(0, dtype=np.int64),
        obstacle_meshes=(),
        instance_mesh=np.zeros(0, dtype=np.int64),
        world_from_instance=np.zeros((0, 4, 4)),
        instance_names=(),
        instance_gives_way=np.zeros(0, dtype=bool),
        instance_is_water=np.zeros(0, dtype=bool),
        removed_names=(),
        scenery_from_file=np.eye(4),
    )


def small_assets(*, distractors=False):
    vehicles = {name: vehicle(name, scale) for name, scale in (("t72", 1.0), ("leo", 1.1), ("ural", 0.8))}
    others = {name: vehicle(name, scale) for name, scale in DISTRACTORS.items()} if distractors else {}
    sceneries = {"hills": hills("hills"), "bare": bare("bare")}
    return Assets(vehicles, CLASSES, sceneries, ("noon", "dusk"), distractors=others)


DISTRACTORS = {"car": 0.5, "bales": 0.3, "bus": 0.9}
DISTRACTOR_ENTRIES = [
    {"path": "car.blend", "weight": 2.0},
    {"path": "bales.blend", "sceneries": ["hill*"]},
    {"path": "bus.blend", "category": "bus"},
]


def small_config(**sections):
    data = {
        "assets": {
            "vehicles": VEHICLE_ENTRIES,
            "sceneries": [{"path": "hills.blend"}, {"path": "bare.blend"}],
        },
        "budget": {"images_per_class": 11, "images_per_position": 4},
        "camera": {"visibility_rays": 64},
        "placement": {"max_gap": 2.0},
    }
    for name, section in sections.items():
        data[name] = {**data.get(name, {}), **section} if isinstance(section, dict) else section
    return parse_config(data)
