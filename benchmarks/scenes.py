"""Vehicles and ground that benchmarks make."""

from __future__ import annotations

import math

import numpy as np

from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources

HD = Intrinsics(1920, 1080, math.radians(50))


def sheet(points: np.ndarray) -> Mesh:
    """Two triangles between each four neighbors of a (rows, columns, 3) grid of points."""
    rows, columns = points.shape[:2]
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    return Mesh(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def vehicles(*, fine: int = 1) -> dict[str, VehicleShape]:
    """Three made-up vehicles of ellipsoids and boxes: a tank, a truck, a launcher with its rail up."""
    tank = _shape(
        "tank",
        [_box([-3.4, -1.7, 0.4], [3.4, 1.7, 1.3], fine), _ball([0, 0, 1.6], [1.6, 1.3, 0.5], fine),
         _box([1.2, -0.07, 1.5], [5.6, 0.07, 1.64], fine)],
        [[0, 0, 0], [0, 0, 1.3], [1.2, 0, 1.57]],
    )  # fmt: skip
    truck = _shape(
        "truck",
        [_box([-4.0, -1.25, 0.5], [1.8, 1.25, 3.0], fine), _box([2.0, -1.2, 0.5], [4.0, 1.2, 2.6], fine)],
        [[0, 0, 0], [2, 0, 0.5]],
    )
    launcher = _shape(
        "launcher",
        [_box([-4.2, -1.4, 0.5], [4.2, 1.4, 2.0], fine), _box([-3.8, -0.9, 2.0], [3.2, 0.9, 3.1], fine)],
        [[0, 0, 0], [-3.6, 0, 2.0]],
    )
    return {"tank": tank, "truck": truck, "launcher": launcher}


def _shape(name: str, meshes: list[Mesh], pivots: list[list[float]]) -> VehicleShape:
    mesh, source = merge_meshes_with_sources(meshes)
    part = np.zeros(len(mesh.vertices), dtype=int)
    part[mesh.faces] = source[:, None]
    low, high = mesh.bounds
    under = np.array([*(low + high)[:2] / 2, low[2]])
    p = len(meshes)
    return VehicleShape(
        name, Mesh(mesh.vertices - under, mesh.faces, name), part, ("hull", "turret", "gun")[:p], np.arange(p) - 1,
        np.array(pivots) - under, np.array([[0.0, 0, 1], [0, 0, 1], [0, -1, 0]])[:p], np.zeros((p, 2)), np.eye(4),
    )  # fmt: skip


def _ball(at: list[float], half: list[float], fine: int) -> Mesh:
    n = 12 * fine
    around, up = np.meshgrid(np.linspace(0, 2 * math.pi, 2 * n + 1), np.linspace(-math.pi / 2, math.pi / 2, n + 1))
    points = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1)
    return sheet(np.array(at) + np.array(half) * points)


def _box(low: list[float], high: list[float], fine: int) -> Mesh:
    sides = []
    s, t = np.meshgrid(np.linspace(0, 1, 4 * fine + 1), np.linspace(0, 1, 4 * fine + 1))
    for axis in range(3):
        for end in (0.0, 1.0):
            unit = np.insert(np.stack([s, t], -1), axis, end, axis=-1)
            sides.append(sheet(np.array(low) + unit * (np.array(high) - low)))
    return merge_meshes_with_sources(sides)[0]
