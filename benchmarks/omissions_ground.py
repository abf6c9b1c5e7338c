"""What rigid tracks on rigid ground leave out: wheels that travel, and soil that gives way.

Sprung wheels. A tank on 2 x 7 wheels; each carries the same load at rest on a plane, has a linear spring that is
unloaded after `travel` of droop and carries twice its load after `travel` of bump, where a stop of 20 times the
stiffness begins. The pose in which forces and moments balance is the least of a convex energy, found by Newton's
method for all places at once. It is held against the plan's pose, whose wheels are where the file has them.

Soil. Bekker's law, p = (k_c / b + k_phi) z^n, gives the sinkage z of a plate of width b under the pressure p.

References
----------
Bekker, Introduction to Terrain-Vehicle Systems, 1969, part I; Wong, Theory of Ground Vehicles, table of soil values
after Bekker's law; Rowland, Tracked vehicle ground pressure and its effect on soft ground performance, 1972: the peaks
under road wheels are two to three times the mean pressure.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from annotate.boxes import VehicleBoxes
from assets.vehicle import VehicleShape
from benchmarks.camera import HD, vehicles
from benchmarks.settling import angle_deg, terrains, waves
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from geometry.transforms import apply, facing, rigid
from placement.candidates import candidates
from placement.footprint import Underside
from placement.settle import settle
from placement.terrain import Terrain

DISTANCES = (30.0, 60.0, 120.0)  # metres
TRAVEL = (0.15, 0.25)  # metres of bump and of droop
TRACK, BELLY = 0.6, 0.45  # metres: width of a track, height of what is between the two
CELLS = 128  # a side of the underside
STOP = 20.0  # how much stiffer a bump stop is than the spring
LIMITS = {"max_gap": 1.0, "max_penetration": 0.3}  # the config's own

# n, k_c in kN/m^(n+1), k_phi in kN/m^(n+2); Wong.
SOILS = {
    "dry sand": (1.1, 0.99, 1528.43),
    "sandy loam": (0.7, 5.27, 1515.04),
    "clayey soil": (0.5, 13.19, 692.15),
}
# Pressure in kPa and width of the plate in metres.
LOADS = {
    "tank, mean pressure under the track": (88.0, 0.6),
    "tank, peaks under the road wheels": (220.0, 0.6),
    "truck, tyres at 350 kPa": (350.0, 0.35),
}


def suspension(quick: bool) -> list[dict[str, Any]]:
    """A row for each terrain and travel."""
    shape = vehicles()["tank"]
    underside, wheels = _running_gear(shape)
    rows = []
    gentle = {"gentle, 20 m waves of 0.2 m": waves(60.0, 0.25, 20.0, 0.2)}
    for name, (mesh, _) in (gentle | terrains(quick)).items():
        terrain = Terrain(mesh)
        xy, yaw = candidates(mesh.bounds, 300 if quick else 1000, rng=np.random.default_rng(1))
        settled = settle(terrain, shape.size_xyz, xy, yaw, footprint=underside, **LIMITS)
        stands = settled.ok
        rigid_pose, yaw = settled.world_from_vehicle[stands], yaw[stands]
        gap = -_clearance(terrain, rigid_pose, wheels)
        for travel in TRAVEL:
            pose, balanced = _sprung(terrain, rigid_pose, yaw, wheels, travel)
            bump = _clearance(terrain, pose, wheels)
            rows.append({
                "terrain": name, "travel_m": travel, "places": len(pose), "balanced": float(balanced.mean()),
                "rigid_gap_m": _median_and_p95(gap.max(axis=1)),
                "left_gap_m": _median_and_p95((-bump - travel).max(axis=1).clip(0)),
                "hanging": float((gap > 0.02).mean()), "still_hanging": float((-bump > travel).mean()),
                "body_up_m": _median_and_p95(np.abs(pose[:, 2, 3] - rigid_pose[:, 2, 3])),
                "tilt_deg": _median_and_p95(angle_deg(pose[:, :3, 2], rigid_pose[:, :3, 2])),
                "box_px": {str(d): _median_and_p95(_box_change(shape, rigid_pose, pose, d)) for d in DISTANCES},
            })  # fmt: skip
    return rows


def _running_gear(shape: VehicleShape) -> tuple[Underside, np.ndarray]:
    """The underside between and with the tracks, and the lowest points of 2 x 7 wheels, in the vehicle frame."""
    hull = shape.mesh.vertices[shape.vertex_part == 0]
    overhang = np.array([0.5, 0.0])
    low, high = hull.min(axis=0)[:2] + overhang, hull.max(axis=0)[:2] - overhang
    x, y = np.meshgrid(np.linspace(low[0], high[0], 7), [low[1] + TRACK / 2, high[1] - TRACK / 2])
    from_side = (high[1] - low[1]) / 2 * (1 - np.abs(np.linspace(-1, 1, CELLS)))
    heights = np.tile(np.where(from_side <= TRACK, 0.0, BELLY), (CELLS, 1))
    return Underside(np.stack([low, high]), heights), np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def _clearance(terrain: Terrain, pose: np.ndarray, wheels: np.ndarray) -> np.ndarray:
    """(k, w) metres of ground above (+) or below (-) each wheel's place in the rigid vehicle."""
    at = apply(pose, wheels)
    return terrain.top_hits(at[..., :2].reshape(-1, 2)).z.reshape(at.shape[:2]) - at[..., 2]


def _sprung(
    terrain: Terrain, rigid_pose: np.ndarray, yaw: np.ndarray, wheels: np.ndarray, travel: float
) -> tuple[np.ndarray, np.ndarray]:
    """The poses in which wheel forces balance, and which did; starts at the rigid ones."""
    pose = rigid_pose.copy()
    arms = np.concatenate([np.ones((len(wheels), 1)), wheels[:, :2]], axis=1)
    residual = np.full(len(pose), np.inf)
    for _ in range(60):
        bump = _clearance(terrain, pose, wheels)
        bump = np.nan_to_num(bump, nan=-10.0)  # a wheel over no ground hangs
        share = bump / travel
        force = np.where(share > 1, 2 + STOP * (share - 1), np.maximum(1 + share, 0.0))
        rate = np.where(share > 1, STOP, np.where(share > -1, 1.0, 1e-3)) / travel
        unbalanced = (force - 1) @ arms
        residual = np.abs(unbalanced / [1.0, 3.0, 1.5]).max(axis=1) / len(wheels)
        system = np.einsum("kw,wi,wj->kij", rate, arms, arms)
        step = np.linalg.solve(system, unbalanced[..., None])[..., 0]
        # Stiffness changes by steps: short ones keep Newton from going to and fro between two of them.
        step *= np.minimum(1.0, 0.1 / np.abs(step @ arms.T).max(axis=1, keepdims=True).clip(1e-12)) * 0.7
        up, forward, left = pose[:, :3, 2], pose[:, :3, 0], pose[:, :3, 1]
        up = up - step[:, 1:2] * forward - step[:, 2:3] * left
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        origin = pose[:, :3, 3] + np.array([0, 0, 1.0]) * step[:, :1]
        pose = rigid(facing(yaw, up), origin)
    return pose, residual < 0.01


def _box_change(shape: VehicleShape, a: np.ndarray, b: np.ndarray, distance: float) -> np.ndarray:
    """Largest change of a side of the box in pixels, seen from a camera that looks at pose a's centre."""
    rng = np.random.default_rng(2)
    n = len(a)
    centre = a[:, :3, 3] + a[:, :3, 2] * shape.size_xyz[2] / 2
    elevation = draw_elevation(n, (np.radians(3), np.radians(35)), rng=rng)
    camera = camera_pose(centre, distance, draw_azimuth(n, rng=rng), elevation)
    boxes = VehicleBoxes(shape)
    first, second = (boxes.boxes(pose, camera, HD).amodal for pose in (a, b))
    corners = [np.concatenate([box[:, :2], box[:, :2] + box[:, 2:]], axis=1) for box in (first, second)]
    return np.abs(corners[0] - corners[1]).max(axis=1)


def _median_and_p95(values: np.ndarray) -> list[float]:
    """Median and 95th percentile."""
    return [float(np.nanmedian(values)), float(np.nanpercentile(values, 95))]


def soil() -> list[dict[str, Any]]:
    """Sinkage of each load in each soil, and pixels of it."""
    rows = []
    for load, (pressure, width) in LOADS.items():
        for name, (n, k_c, k_phi) in SOILS.items():
            sinkage = (pressure / (k_c / width + k_phi)) ** (1 / n)
            rows.append({
                "load": load, "kpa": pressure, "width_m": width, "soil": name, "sinkage_m": sinkage,
                "px": {str(d): HD.f_px * sinkage / d for d in DISTANCES},
            })  # fmt: skip
    return rows
