"""Boxes: time and error of each rule, in pixels from the box by clipping every triangle."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hulldown.annotate.boxes import VehicleBoxes, surface_box
from hulldown.annotate.extremes import ImageView, surface_extremes
from hulldown.annotate.posing import PosedParts, transform_part_points
from hulldown.assets.vehicle import VehicleShape
from hulldown.benchmarks.scenes import HD
from hulldown.benchmarks.tables import table
from hulldown.camera.cameras import Cameras
from hulldown.camera.shell import camera_pose
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rigid_matrix, rotation_z, transform_points
from hulldown.tests.builders.shapes import vertices_at

KINDS = ("framed", "cut by the frame", "across the near plane")
PEERS = {
    "8 corners": "of the world-aligned box around the vehicle",
    "oriented box": "8 corners of the vehicle's own box",
    "all vertices": "in front of the camera, clamped to the image",
    "hull vertices": "the convex hull's, likewise",
}
OURS = ("clip every triangle", "hulldown", "hulldown, batch")


def run(quick: bool) -> dict:
    """Measure."""
    sizes = (1_000, 10_000, 100_000) if quick else (1_000, 10_000, 100_000, 1_000_000)
    return {"errors": _errors(20 if quick else 200), "times": {str(n): _times(n, quick) for n in sizes}}


def report(results: dict) -> str:
    """Return a Markdown section."""
    times = results["times"]
    sizes = [f"{int(n):,}" for n in times]

    def error(name: str, kind: str) -> str:
        e = results["errors"][kind][name]
        missed = f", {e['missed']:.0%} missed" if e["missed"] else ""
        return f"{e['median']:.3g}/{e['p95']:.3g}/{e['worst']:.3g}{missed}"

    parts = [
        "## Boxes",
        "Largest error of a side in pixels of 1920 x 1080, compared with clipping every triangle: median/95%/worst of "
        "random poses of a 10,000-vertex tank. *missed*: only one has a box.",
        table(["rule", *KINDS], [(name, *(error(name, kind) for kind in KINDS)) for name in (*PEERS, *OURS[1:2])]),
        "\n".join(f"- {name}: {what}." for name, what in PEERS.items()),
        "Microseconds for one box on one thread, framed/cut by the frame, by vertices of the mesh:",
    ]
    rows = [
        (name, *("/".join(f"{some[kind][name]:,.0f}" for kind in KINDS[:2]) for some in times.values()))
        for name in (*PEERS, *OURS)
    ]
    rows.append(("hulldown, once for a vehicle", *(f"{1e6 * some['build_s']:,.0f}" for some in times.values())))
    parts.append(table(["rule", *sizes], rows))
    return "\n\n".join(parts)


def plots(results: dict, folder: Path) -> list[Path]:
    """Time against size, and error against time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    times = results["times"]
    sizes = [int(n) for n in times]
    for name in (*PEERS, *OURS):
        style = "-" if name in OURS else "--"
        left.plot(sizes, [times[n][KINDS[1]][name] for n in times], style, marker="o", markersize=3, label=name)
    left.set(xscale="log", yscale="log", xlabel="vertices", ylabel="microseconds a box", title="Cut by the frame")
    left.legend(fontsize=7)
    largest = list(times)[-1]
    for name in (*PEERS, *OURS[1:]):
        for kind, marker in zip(KINDS, "osD", strict=True):
            # Zero has no place on a logarithm: the floor stands for it.
            error = max(results["errors"][kind][name]["p95"], 1e-10)
            right.plot(times[largest][kind][name], error, marker, color=f"C{[*PEERS, *OURS].index(name)}")
    for kind, marker in zip(KINDS, "osD", strict=True):
        right.plot([], [], marker, color="gray", label=kind)
    right.axhline(1e-6, color="gray", linewidth=0.8)
    right.set(xscale="log", yscale="log", xlabel="microseconds a box", ylabel="95 % error, pixels")
    right.set_title(f"Error against cost, {int(largest):,} vertices; colors as left")
    right.legend(fontsize=7)
    path = folder / "boxes.png"
    figure.savefig(path, dpi=120)
    return [path]


def tank(vertices: int) -> VehicleShape:
    """Return an invented tank with about so many vertices: rounded, rough bodies, like scanned or sculpted models."""
    rng = np.random.default_rng(0)
    n = max(2, round(math.sqrt(vertices / 3 / 6)))
    bodies = [((7.0, 3.5, 1.6), (0.0, 0.0, 0.8)), ((3.0, 2.4, 0.8), (-0.3, 0.0, 2.0)), ((5.0, 0.2, 0.2), (3.5, 0.0, 2.1))]
    points, faces, part = [], [], []
    for i, (size, at) in enumerate(bodies):
        v, f = _rounded_box(n)
        v = v * (1.0 + 0.002 * rng.normal(size=(len(v), 1)))
        points.append(v * size + at)
        faces.append(f + i * len(v))
        part += [i] * len(v)
    return VehicleShape(
        "tank",
        Mesh(np.concatenate(points), np.concatenate(faces)),
        np.array(part),
        ("hull", "turret", "gun"),
        np.array([-1, 0, 1]),
        np.array([[0.0, 0.0, 0.0], [-0.3, 0.0, 2.0], [1.0, 0.0, 2.1]]),
        np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        np.array([[0.0, 0.0], [-math.pi, math.pi], [-0.1, 0.3]]),
        np.eye(4),
    )


def _rounded_box(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed box of unit size with bulging sides, 12 n^2 triangles."""
    line = np.linspace(-0.5, 0.5, n + 1)
    a, b = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], -1).reshape(-1, 4)
    flat = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    points, faces = [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            face = np.empty((len(a), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, a, b
            faces.append(flat + len(points) * len(a))
            points.append(face)
    p = np.concatenate(points)
    return p * (1.0 + 0.1 * (0.75 - (p**2).sum(axis=1, keepdims=True))), np.concatenate(faces)


class _Rules:
    """Every rule's box of one vehicle, as functions of (world_from_vehicle, camera, articulation)."""

    def __init__(self, shape: VehicleShape) -> None:
        self.shape = shape
        started = time.perf_counter()
        self.boxes = VehicleBoxes(shape)
        self.build_s = time.perf_counter() - started
        self.parts = PosedParts(shape)
        low, high = shape.mesh.bounds
        self.corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        self.by_name: dict[str, Callable[..., np.ndarray | None]] = {
            "8 corners": self.eight_corners,
            "oriented box": self.oriented_box,
            "all vertices": lambda *view: self.dropped(self.parts.vertices, self.parts.vertex_slices, *view),
            "hull vertices": lambda *view: self.dropped(self.parts.extreme, self.parts.extreme_slices, *view),
            "clip every triangle": self.clip_all,
            "hulldown": self.boxes.box,
        }

    def eight_corners(self, pose: np.ndarray, camera: Cameras, _turned: dict) -> np.ndarray | None:
        world = transform_points(pose, self.corners)
        low, high = world.min(axis=0), world.max(axis=0)
        box = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        return _clamped(*(transform_points(camera.camera_from_world, box)).T, camera)

    def oriented_box(self, pose: np.ndarray, camera: Cameras, _turned: dict) -> np.ndarray | None:
        return _clamped(*transform_points(camera.camera_from_world @ pose, self.corners).T, camera)

    def dropped(self, points: np.ndarray, slices: list, pose: np.ndarray, camera: Cameras, turned: dict) -> np.ndarray | None:
        angles = self.parts.shape.angles([turned])
        poses = self.parts.camera_from_parts(pose[None], camera.world_from_camera[None], angles)
        return _clamped(*transform_part_points(points, slices, poses)[:, 0], camera)

    def clip_all(self, pose: np.ndarray, camera: Cameras, turned: dict) -> np.ndarray | None:
        angles = self.parts.shape.angles([turned])
        poses = self.parts.camera_from_parts(pose[None], camera.world_from_camera[None], angles)
        points = transform_part_points(self.parts.vertices, self.parts.vertex_slices, poses)[:, 0]
        u0, v0, u1, v1 = surface_extremes(points, self.parts.faces, ImageView(camera.lenses, clip_to_image=True))
        return np.array([u0, v0, u1 - u0, v1 - v0]) if u0 <= u1 else None


def _clamped(x: np.ndarray, y: np.ndarray, z: np.ndarray, camera: Cameras) -> np.ndarray | None:
    """Return a box as most tools do: drop what is behind the camera, project the rest, clamp to the image."""
    ahead = z > 1e-6
    if not ahead.any():
        return None
    f, width, height = camera.lenses.f_px, camera.lenses.width, camera.lenses.height
    u = x[ahead] / z[ahead] * f + width / 2
    v = y[ahead] / z[ahead] * f + height / 2
    if u.min() >= width or u.max() <= 0 or v.min() >= height or v.max() <= 0:
        return None
    u0, u1 = np.clip([u.min(), u.max()], 0, width)
    v0, v1 = np.clip([v.min(), v.max()], 0, height)
    return np.array([u0, v0, u1 - u0, v1 - v0])


def _views(kind: str, count: int, shape: VehicleShape) -> list[tuple[np.ndarray, Cameras, dict]]:
    """Random poses of a kind, on gentle slopes, seen from low and moderate angles as the paper has it."""
    rng = np.random.default_rng(KINDS.index(kind))
    boxes, found = VehicleBoxes(shape), []
    while len(found) < count:
        pose = rigid_matrix(rotation_z(rng.uniform(0, 2 * math.pi)), rng.normal(size=3))
        turned = {"turret": float(rng.uniform(-3, 3)), "gun": float(rng.uniform(-0.1, 0.3))}
        distance = rng.uniform(0.5, 4.0) if kind == KINDS[2] else rng.uniform(8.0, 60.0)
        aside = rng.normal(size=3) * (0.0 if kind == KINDS[0] else 0.2 * distance)
        camera = Cameras(HD, camera_pose(pose[:3, 3] + aside, distance, rng.uniform(0, 7), rng.uniform(0, 0.7)))
        box, amodal = boxes.box(pose, camera, turned), boxes.box(pose, camera, turned, frame=False)
        depth = transform_points(camera.camera_from_world @ pose, vertices_at(shape, turned))[:, 2]
        crossing = depth.min() < 0.1 < depth.max()
        if box is None or amodal is None or crossing != (kind == KINDS[2]):
            continue
        if crossing or np.array_equal(box, amodal) == (kind == KINDS[0]):
            found.append((pose, camera, turned))
    return found


def _errors(count: int) -> dict:
    shape = tank(10_000)
    rules = _Rules(shape)
    results = {}
    for kind in KINDS:
        views = _views(kind, count, shape)
        truth = [
            surface_box(transform_points(pose, vertices_at(shape, turned)), shape.mesh.faces, camera)
            for pose, camera, turned in views
        ]
        answers = {name: [rule(*view) for view in views] for name, rule in rules.by_name.items()}
        answers["hulldown, batch"] = list(_batch(rules, views))
        results[kind] = {name: _error(found, truth) for name, found in answers.items()}
    return results


def _batch(rules: _Rules, views: list[tuple[np.ndarray, Cameras, dict]]) -> np.ndarray:
    poses, cameras, turned = zip(*views, strict=True)
    return rules.boxes.boxes(poses, Cameras(HD, np.array([c.world_from_camera for c in cameras])), list(turned)).xywh


def _error(found: list, truth: list) -> dict[str, float]:
    """Largest distance of a side for each pair, summed up."""
    errors, missed = [], 0
    for box, right in zip(found, truth, strict=True):
        if (box is None or np.isnan(box).any()) != (right is None):
            missed += 1
        elif right is not None:
            errors.append(max(np.abs(box[:2] - right[:2]).max(), np.abs((box - right)[:2] + (box - right)[2:]).max()))
    return {
        "median": float(np.median(errors)),
        "p95": float(np.quantile(errors, 0.95)),
        "worst": float(np.max(errors)),
        "missed": missed / len(truth),
    }


def _times(vertices: int, quick: bool) -> dict:
    """Median microseconds of every rule, in turn on the same views."""
    shape = tank(vertices)
    rules = _Rules(shape)
    result: dict = {"build_s": rules.build_s, "hull": rules.parts.extreme.shape[1], "faces": len(shape.mesh.faces)}
    views_each = 6 if quick else 20
    for kind in KINDS:
        views = _views(kind, views_each, shape)
        spent: dict[str, list[float]] = {name: [] for name in rules.by_name}
        for view in views:
            for name, rule in rules.by_name.items():
                rule(*view)  # once before: caches as warm for every rule
                started = time.perf_counter()
                rule(*view)
                spent[name].append(time.perf_counter() - started)
        many = views * (20 if kind != KINDS[0] else 500)
        started = time.perf_counter()
        _batch(rules, many)
        batch = (time.perf_counter() - started) / len(many)
        result[kind] = {name: 1e6 * float(np.median(s)) for name, s in spent.items()} | {"hulldown, batch": 1e6 * batch}
    return result
