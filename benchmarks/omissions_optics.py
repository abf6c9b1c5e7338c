"""What a pinhole, a straight ray and a mask at pixel centres leave out: distortion, air, time, and thin parts.

References
----------
Brown, Decentering distortion of lenses, Photogrammetric Engineering 32(3), 1966: r' = r (1 + k1 r^2), r at unit depth.
Torge, Geodesy, on trigonometric heights: the drop over a distance d is d^2 (1 - k) / (2 R), refraction k = 0.13.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from annotate.boxes import VehicleBoxes
from annotate.masks import mask_box, vehicle_mask
from assets.vehicle import VehicleShape
from benchmarks.camera import HD, vehicles
from camera.framing import frame_target
from camera.intrinsics import Intrinsics
from camera.projection import Camera
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from camera.size import solve_distance
from camera.target import PosedVehicle, VehicleTarget
from geometry.hulls import extreme_points
from geometry.meshes import Mesh, merge
from geometry.transforms import apply, invert_rigid

K1 = (-0.05, -0.2)  # a good photographic lens, an action camera
LENS = Intrinsics(1920, 1080, math.radians(60))
ANTENNA = (2.5, 0.03)  # metres: length, thickness
HEIGHTS = (20, 40, 60, 80, 120, 160, 320)  # pixels of the box, antenna included
EARTH, REFRACTION = 6_371_000.0, 0.13


def distort(points: np.ndarray, k1: float) -> np.ndarray:
    """Brown's radial term, on points at unit depth (..., 2)."""
    return points * (1 + k1 * (points**2).sum(axis=-1, keepdims=True))


def lens(quick: bool) -> list[dict[str, Any]]:
    """A row for each k1: shift of pixels, and of the sides of boxes all over the frame."""
    shape = vehicles(fine=2 if quick else 6)["tank"]
    rng = np.random.default_rng(1)
    n = 200 if quick else 1000
    centre = np.array([0.0, 0.0, shape.size_xyz[2] / 2])
    elevation = draw_elevation(n, (math.radians(3), math.radians(60)), rng=rng)
    poses = camera_pose(centre, rng.uniform(15, 80, n), draw_azimuth(n, rng=rng), elevation)
    hull = shape.mesh.vertices[extreme_points(shape.mesh.vertices)]
    poses = frame_target(poses, hull[None], LENS, rng=rng).world_from_camera
    corner = np.array([LENS.width, LENS.height]) / 2 / LENS.f_px
    rows = []
    for k1 in K1:
        moved, by_border = [], []
        for pose in poses:
            points = apply(invert_rigid(pose), shape.mesh.vertices)
            at = points[:, :2] / points[:, 2:]
            straight, bent = _box(at), _box(distort(at, k1))
            moved.append(np.abs(bent - straight).max() * LENS.f_px)
            by_border.append(np.abs(_box(distort(_border(straight), k1)) - bent).max() * LENS.f_px)
        shift = [float(np.linalg.norm(distort(part * corner, k1) - part * corner)) for part in (1.0, 0.5)]
        rows.append({
            "k1": k1, "boxes": n, "corner_px": shift[0] * LENS.f_px, "half_px": shift[1] * LENS.f_px,
            "side_px": _median_p95_worst(np.array(moved)), "border_px": _median_p95_worst(np.array(by_border)),
        })  # fmt: skip
    return rows


def _box(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def _border(box: np.ndarray) -> np.ndarray:
    """Points all along the four sides of a box."""
    share = np.linspace(0, 1, 33)[:, None]
    (x0, y0, x1, y1) = box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


def thin_parts(quick: bool) -> list[dict[str, Any]]:
    """By size of the target: how far the exact box reaches beyond that of the mask, with and without an antenna."""
    views = 12 if quick else 40
    plain = vehicles()["tank"]
    rows = []
    for height in HEIGHTS:
        row: dict[str, Any] = {"height_px": height, "views": views}
        for name, shape in (("antenna", with_antenna(plain)), ("plain", plain)):
            rng = np.random.default_rng(3)
            centre = np.array([0.0, 0.0, shape.size_xyz[2] / 2])
            azimuth = draw_azimuth(views, rng=rng)
            elevation = draw_elevation(views, (math.radians(3), math.radians(35)), rng=rng)
            poses = camera_pose(centre, 100.0, azimuth, elevation)
            points = shape.mesh.vertices[None]
            distance = solve_distance(HD, poses, points, centre=centre, pixels=float(height), measure="height")
            # Not always looking at the centre: what falls between two pixels' centres is up to chance.
            poses = camera_pose(centre + rng.uniform(-0.05, 0.05, (views, 3)), distance, azimuth, elevation)
            row[name] = _median_p95_worst(_beyond(shape, poses))
            row[f"{name}_distance_m"] = float(np.median(distance))
        row["px_thick"] = HD.f_px * ANTENNA[1] / row["antenna_distance_m"]
        rows.append(row)
    return rows


def with_antenna(shape: VehicleShape) -> VehicleShape:
    """The tank with a rod on its turret."""
    length, thick = ANTENNA
    around = np.arange(6) * (math.pi / 3)
    ring = np.stack([np.cos(around), np.sin(around)], axis=1) * (thick / 2) + [-1.0, 0.8]
    top = shape.size_xyz[2]
    rod = np.concatenate([np.c_[ring, np.full(6, z)] for z in (top - 0.5, top - 0.5 + length)])
    i = np.arange(6)
    j = (i + 1) % 6
    mesh, _ = merge([shape.mesh, Mesh(rod, np.concatenate([np.c_[i, j, j + 6], np.c_[i, j + 6, i + 6]]))])
    part = np.zeros(len(mesh.vertices), dtype=int)
    part[: len(shape.vertex_part)] = shape.vertex_part
    part[len(shape.vertex_part) :] = 1
    return VehicleShape(
        "tank with antenna", mesh, part, shape.part_names, shape.part_parent, shape.part_pivot, shape.part_axis,
        shape.part_limits, shape.vehicle_from_file,
    )  # fmt: skip


def _beyond(shape: VehicleShape, poses: np.ndarray) -> np.ndarray:
    """How far the exact box reaches beyond the mask's, or the other way round: the largest of four sides."""
    boxes, target = VehicleBoxes(shape), VehicleTarget(shape)
    standing = PosedVehicle(target, np.eye(4)[None], {})
    found = []
    for pose in poses:
        camera = Camera(HD, pose)
        exact = boxes.box(np.eye(4), camera)
        room = exact + np.array([-2, -2, 4, 4])  # so that a mask that reached out of the box would show
        seen = mask_box(vehicle_mask(standing, camera, xywh=room))
        sides = [np.concatenate([box[:2], box[:2] + box[2:]]) for box in (exact, seen)]
        found.append(np.abs(sides[0] - sides[1]).max())
    return np.array(found)


def formulas() -> list[dict[str, Any]]:
    """What takes a line each: pixels by the formula, at 1920 x 1080 and the field of view of the other tables."""
    f = HD.f_px
    sensor, stop = 0.036, 8.0  # metres of a full frame's width; the f-number
    focal = sensor * f / HD.width
    circle = focal**2 / stop * (1 / 30 - 1 / 60) * HD.width / sensor
    rows: list[dict[str, Any]] = []
    for d in (500.0, 2000.0):
        drop = d**2 * (1 - REFRACTION) / (2 * EARTH)
        rows.append({"what": "curvature of the earth, less refraction", "case": f"{d:.0f} m off",
                     "formula": "d^2 (1 - 0.13) / 2R", "metres": drop, "px": f * drop / d})  # fmt: skip
    for what, case, seconds in (
        ("motion blur", "10 m/s across, 60 m off, 1/500 s", 1 / 500),
        ("rolling shutter", "the same, read in 20 ms, box a fifth of the height", 0.02 / 5),
    ):
        rows.append({"what": what, "case": case, "formula": "v t", "metres": 10 * seconds, "px": f * 10 * seconds / 60})
    sharp = f"{focal * 1000:.0f} mm at f/{stop:.0f} on full frame, sharp at 60 m, vehicle at 30 m"
    rows.append(
        {"what": "depth of field", "case": sharp, "formula": "F^2 (1/d - 1/s) / N", "metres": None, "px": circle}
    )
    return rows


def _median_p95_worst(values: np.ndarray) -> list[float]:
    """Median, 95th percentile, worst."""
    return [float(np.median(values)), float(np.percentile(values, 95)), float(values.max())]
