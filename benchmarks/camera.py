"""Size that was asked for against size that comes out, and what projecting, framing and solving cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from assets.vehicle import VehicleShape
from benchmarks.sheets import sheet
from camera.framing import frame_target
from camera.intrinsics import Intrinsics
from camera.projection import project
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from camera.size import projected_extent, solve_distance
from geometry.hulls import extreme_points
from geometry.meshes import Mesh, merge

HD = Intrinsics(1920, 1080, math.radians(50))
FRACTION = 0.2  # of the image height
EDGES = np.linspace(0.8, 5.6, 49)
MEASURES = ("height", "diagonal", "area")


def run(quick: bool) -> dict:
    """Measure."""
    n, rounds = (2_000, 3) if quick else (20_000, 7)
    return {"size": {name: _sizes(shape, n) for name, shape in vehicles().items()}, "cost": _costs(n, rounds)}


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
    mesh, source = merge(meshes)
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
    return merge(sides)[0]


def _views(n: int, centre: np.ndarray, distance: float | np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    elevation = draw_elevation(n, (math.radians(3), math.radians(60)), rng=rng)
    return camera_pose(centre, distance, draw_azimuth(n, rng=rng), elevation)


def _sizes(shape: VehicleShape, n: int) -> dict:
    """Box height over requested height, for the paper's distance and for the solved one, in the same directions."""
    points = shape.mesh.vertices[extreme_points(shape.mesh.vertices)]
    centre = np.array([0, 0, shape.size_xyz[2] / 2])
    paper = float(HD.distance_for(shape.size_xyz.min(), FRACTION))
    poses = _views(n, centre, paper, 1)
    wanted = FRACTION * HD.height
    result = {"paper": _percentiles(projected_extent(HD, poses, points[None]).height / wanted)}
    for measure in MEASURES:
        pixels = wanted**2 if measure == "area" else wanted
        distance = solve_distance(HD, poses, points[None], centre=centre, pixels=pixels, measure=measure)
        achieved = projected_extent(HD, _views(n, centre, distance, 1), points[None]).measure(measure)
        result[f"exact {measure}"] = _percentiles(achieved / wanted)
    return result


def _percentiles(ratio: np.ndarray) -> dict:
    low, median, high = np.percentile(ratio, [5, 50, 95])
    return {
        "p05": float(low), "median": float(median), "p95": float(high),
        "max_error": float(np.abs(ratio - 1).max()), "histogram": np.histogram(ratio, EDGES)[0].tolist(),
    }  # fmt: skip


def _costs(n: int, rounds: int) -> dict:
    """Microseconds a camera, or nanoseconds a point."""
    shape = vehicles(fine=4)["tank"]
    points = shape.mesh.vertices[extreme_points(shape.mesh.vertices)]
    centre = np.array([0, 0, shape.size_xyz[2] / 2])
    poses = _views(n, centre, 40.0, 2)
    rng = np.random.default_rng(0)
    few = points[rng.choice(len(points), 64, replace=False)]
    work: dict[str, tuple[Callable[[], object], float, str]] = {
        "projecting": (lambda: project(HD, poses, few), n * 64 / 1e3, "ns a point"),
        "framing": (lambda: frame_target(poses, few[None], HD, rng=np.random.default_rng(0)), n, "us a camera"),
        "framing with cuts": (
            lambda: frame_target(poses, few[None], HD, rng=np.random.default_rng(0), truncated=(0.2, 0.6)),
            n,
            "us a camera",
        ),
    }
    for measure in MEASURES:
        pixels = 200.0**2 if measure == "area" else 200.0
        work[f"solving for {measure}"] = (
            lambda m=measure, p=pixels: solve_distance(HD, poses, few[None], centre=centre, pixels=p, measure=m),
            n,
            "us a camera",
        )
    if (blender := _blender_peer(few)) is not None:
        work["Blender's world_to_camera_view"] = (blender, 64 / 1e3, "ns a point")
    spent: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, (do, _, _) in work.items():
            started = time.perf_counter()
            do()
            spent[name].append(time.perf_counter() - started)
    return {
        name: {"cost": float(np.median(spent[name])) * 1e6 / many, "unit": unit}
        for name, (_, many, unit) in work.items()
    }


def _blender_peer(points: np.ndarray) -> Callable[[], object] | None:
    """The peer one is told to use inside Blender: a Python call a point."""
    try:
        import bpy
        from bpy_extras.object_utils import world_to_camera_view
        from mathutils import Vector
    except ImportError:
        return None
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.location = (0.0, 0.0, 40.0)
    bpy.context.view_layer.update()
    vectors = [Vector(p) for p in points]
    return lambda: [world_to_camera_view(scene, camera, v) for v in vectors]


def report(results: dict) -> str:
    """A Markdown section."""
    lines = [
        "## Cameras: the size that was asked for",
        f"Height of the tight box over the requested {FRACTION:.0%} of the image height (for diagonal and area: the "
        "box's diagonal or root of area over the same length), cameras 3 to 60 degrees up, all around. The paper's "
        "distance (equation 6) takes the smallest side of the bounding box for an upright, face-on height; the solve "
        "takes the vertices.",
        "",
        "| vehicle | distance | 5 % | median | 95 % | largest error |",
        "|---|---|---|---|---|---|",
    ]
    for vehicle, rules in results["size"].items():
        for rule, s in rules.items():
            name = "paper, eq 6" if rule == "paper" else f"solved for {rule.split()[1]}"
            lines.append(
                f"| {vehicle} | {name} | {s['p05']:.3f} | {s['median']:.3f} | {s['p95']:.3f} | {s['max_error']:.1e} |"
            )
    lines += ["", "| what | cost |", "|---|---|"]
    lines += [f"| {name} | {c['cost']:.3g} {c['unit']} |" for name, c in results["cost"].items()]
    peer = results["cost"].get("Blender's world_to_camera_view")
    if peer:
        ratio = peer["cost"] / results["cost"]["projecting"]["cost"]
        lines += [
            "",
            f"Projecting in batches is {ratio:.0f} times as fast as Blender's function, a Python call a point.",
        ]
    return "\n".join(lines)


def plots(results: dict, folder: Path) -> list[Path]:
    """Achieved over requested height, by vehicle."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for vehicle, rules in results["size"].items():
        counts = np.array(rules["paper"]["histogram"], dtype=float)
        axes.stairs(counts / counts.sum(), EDGES, label=f"{vehicle}, paper's distance", linewidth=1.5)
    axes.axvline(1.0, color="black", label="all vehicles, solved distance")
    axes.set(xlabel="height of the box / requested height", ylabel="share of cameras")
    axes.legend(fontsize=8)
    path = folder / "camera_size.png"
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return [path]
