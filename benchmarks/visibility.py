"""Visible share: error against a per-pixel reference and against time, for more and more rays, and beside peers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hulldown.annotate.visibility import Visibility, measure_visibility
from hulldown.benchmarks.scenes import HD, sheet, vehicles
from hulldown.benchmarks.tables import table
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import turn_cameras_to_targets
from hulldown.camera.shell import camera_pose, sample_azimuths, sample_elevations
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import rigid_matrix, rotation_z, transform_points
from hulldown.scene.instances import InstancedScene
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import RayList
from hulldown.tests.builders.shapes import vertices_at

RAYS = (64, 256, 1024, 4096, 16384, 65536)
SHOWN_ROWS = 4  # rows of the table; the plot shows all
GROUND_REACH_M = 600.0  # meters of ground to each side of the middle


class Woods:
    """Waves of ground, a wood on it, a tank in many places, and cameras that look at it."""

    def __init__(self, n: int, *, cells: int, trees: int) -> None:
        rng = np.random.default_rng(7)
        self.ground = _waves(cells)
        self.ground_rays = RayCaster(self.ground)
        self.tree = _tree()
        at = rng.uniform(-GROUND_REACH_M, GROUND_REACH_M, (trees, 2))
        scale = rng.uniform(0.7, 1.6, trees)
        poses = rigid_matrix(rotation_z(rng.uniform(0, 6, trees)), np.c_[at, _height(*at.T)])
        poses[:, :3, :3] *= scale[:, None, None]
        self.wood = InstancedScene([self.tree], np.zeros(trees, dtype=int), poses)
        self.shape = vehicles(fine=6)["tank"]
        self.caster = VehicleCaster(self.shape)
        self.articulation = [{"turret": float(a), "gun": 0.1} for a in rng.uniform(-3, 3, n)]
        spot = rng.uniform(-0.8 * GROUND_REACH_M, 0.8 * GROUND_REACH_M, (n, 2))
        self.world_from_vehicle = rigid_matrix(rotation_z(rng.uniform(0, 6, n)), np.c_[spot, _height(*spot.T)])
        center = self.world_from_vehicle[:, :3, 3] + [0, 0, 1.0]
        poses = camera_pose(
            center,
            rng.uniform(15, 120, n),
            sample_azimuths(n, rng=rng),
            sample_elevations(n, (math.radians(3), math.radians(35)), rng=rng),
        )
        at_rest = np.concatenate([part.hull for part in self.caster.parts])
        hull = transform_points(self.world_from_vehicle, at_rest)
        self.world_from_camera = turn_cameras_to_targets(Cameras(HD, poses), hull, rng=rng).world_from_camera
        above = self.world_from_camera[:, 2, 3] - _height(*self.world_from_camera[:, :2, 3].T)
        self.world_from_camera[above < 0.5, 2, 3] += 0.5 - above[above < 0.5]

    def seen(self, rows: slice, rays: int, seed: int = 0, *, world: Scene) -> Visibility:
        """Return hulldown's visible shares."""
        target = PosedVehicle(self.caster, self.world_from_vehicle[rows], self.articulation[rows])
        cameras = Cameras(HD, self.world_from_camera[rows])
        return measure_visibility([target], cameras, world=world, rays=rays, seed=seed)

    def fraction(self, rows: slice, rays: int, seed: int = 0, *, wood: bool = True) -> np.ndarray:
        """Visible shares, with the wood or without."""
        world = Scene(self.ground_rays, self.wood) if wood else Scene(self.ground_rays)
        return self.seen(rows, rays, seed, world=world).fraction

    def placed(self, i: int) -> Mesh:
        """The vehicle of view i, turned, in the world."""
        vertices = transform_points(self.world_from_vehicle[i], vertices_at(self.shape, self.articulation[i]))
        return Mesh(vertices, self.shape.mesh.faces)

    def by_pixels(self, i: int, pixels: np.ndarray, vehicle: RayCaster) -> tuple[int, int]:
        """Count rays through pixels of view i that hit the vehicle, and that hit it first, by code that isn't timed."""
        camera = Cameras(HD, self.world_from_camera[i])
        along = camera.rays(pixels)[1]
        origin = np.broadcast_to(camera.position, along.shape)
        distance = vehicle.cast(origin, along).distance
        met = np.isfinite(distance)
        reach = distance[met] - 1e-3
        hidden = self.ground_rays.cast(origin[met], along[met]).distance < reach
        hidden |= self.wood.occlusion(RayList(origin[met], along[met]), max_distance=reach)
        return int(met.sum()), int((~hidden).sum())


def _height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    hills = 4.0 * np.sin(x / 25) * np.cos(y / 31 + 1)
    return hills + 0.8 * np.sin(x / 6 + y / 9) + 0.1 * np.sin(x * 1.3) * np.sin(y * 1.1)


def _waves(cells: int) -> Mesh:
    x, y = np.meshgrid(*[np.linspace(-GROUND_REACH_M, GROUND_REACH_M, cells + 1)] * 2)
    return sheet(np.stack([x, y, _height(x, y)], axis=-1))


def _tree() -> Mesh:
    """A trunk and 3,000 leaves: occluders with holes."""
    rng = np.random.default_rng(1)
    around = np.linspace(0, 2 * math.pi, 9)
    ring = np.stack([0.15 * np.cos(around), 0.15 * np.sin(around)], 1)
    trunk = np.concatenate([np.c_[ring, np.full(9, -0.3)], np.c_[ring, np.full(9, 3.0)]])
    sides = np.array([[i, i + 1, i + 10] for i in range(8)] + [[i, i + 10, i + 9] for i in range(8)])
    middle = rng.normal(size=(3000, 3)) * [0.9, 0.9, 1.2] + [0, 0, 3.4]
    leaves = (middle[:, None] + rng.normal(size=(3000, 3, 3)) * 0.12).reshape(-1, 3)
    return merge_meshes_with_sources([Mesh(trunk, sides), Mesh(leaves, np.arange(9000).reshape(-1, 3))])[0]


def run(quick: bool) -> dict:
    """Measure."""
    views, rounds = (12, 3) if quick else (100, 7)
    world = Woods(max(views, 256 if quick else 512), cells=250 if quick else 700, trees=2000 if quick else 10_000)
    result = {
        "faces": {
            "vehicle": len(world.shape.mesh.faces), "ground": len(world.ground.faces), "tree": len(world.tree.faces)
        },
        "trees": len(world.wood.bounds),
        "views": views,
    }  # fmt: skip
    result["error"] = _errors(world, views, quick)
    result["cost"] = _costs(world, rounds, quick)
    return result


def _errors(world: Woods, views: int, quick: bool) -> dict:
    """Per contender and number of rays: errors over all views, in shares of the silhouette; nan where none is told."""
    truth, hits, boxes, casters = np.full(views, np.nan), np.zeros(views), [], []
    for i in range(views):
        vehicle = world.placed(i)
        pixels = Cameras(HD, world.world_from_camera[i]).project(vehicle.vertices).pixels
        low, high = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
        low, high = np.maximum(low, 0), np.minimum(high, [HD.width, HD.height])
        # At least 400 points across, so that small targets have an exact reference too.
        step = min(1.0, float((high - low).max()) / 400)
        u, v = np.meshgrid(np.arange(low[0] + step / 2, high[0], step), np.arange(low[1] + step / 2, high[1], step))
        casters.append(RayCaster(vehicle))
        hits[i], seen = world.by_pixels(i, np.stack([u.ravel(), v.ravel()], 1), casters[i])
        truth[i] = seen / hits[i]
        boxes.append((low, high))
    rng = np.random.default_rng(3)

    def random_in_box(i: int, rays: int) -> float:
        low, high = boxes[i]
        met, seen = world.by_pixels(i, low + rng.random((rays, 2)) * (high - low), casters[i])
        return seen / met if met else math.nan

    def grid_in_frame(i: int, rays: int) -> float:
        k = math.isqrt(rays)
        u, v = np.meshgrid((np.arange(k) + 0.5) / k * HD.width, (np.arange(k) + 0.5) / k * HD.height)
        met, seen = world.by_pixels(i, np.stack([u.ravel(), v.ravel()], 1), casters[i])
        return seen / met if met else math.nan

    rows = slice(0, views)
    ours_is, random_is, grid_is = "one a cell of the target's box (default)", "random in the box", "grid over the frame"
    out: dict[str, dict] = {ours_is: {}, random_is: {}, grid_is: {}}
    for rays in RAYS[:4] if quick else RAYS:
        seeds = 3 if quick else 5 if rays <= 4096 else 2  # the fewer rays, the more chance
        ours = np.concatenate([world.fraction(rows, rays, seed=s) - truth for s in range(seeds)])
        out[ours_is][str(rays)] = _summary(ours)
        if rays <= 4096:
            out[random_is][str(rays)] = _summary(np.array([random_in_box(i, rays) for i in range(views)]) - truth)
            out[grid_is][str(rays)] = _summary(np.array([grid_in_frame(i, rays) for i in range(views)]) - truth)
    fill = world.seen(rows, 1024, world=Scene()).hits / 1024  # share of the rays that meet the target
    bound = {str(rays): float(error_bound(rays * np.median(fill))) for rays in RAYS}
    partly = float(((truth > 0.02) & (truth < 0.98)).mean())
    return {"contenders": out, "bound": bound, "partly_hidden": partly, "mean_visible": float(truth.mean())}


def error_bound(hits: np.ndarray, *, confidence: float = 0.95) -> np.ndarray:
    """Bound the error of a visible share from so many rays on the target, at a confidence.

    Every ray is uniformly random in its own cell of the target's box. With p the true fraction, V and M the numbers of
    visible rays and of rays on the target, V - p M is a sum of independent terms of mean 0 within [-1, 1], whose
    variances add up to at most p (1 - p) E[M]. So the standard error is at most 1 / (2 sqrt(M)), and by Bernstein's
    inequality |V / M - p| <= (L / 3 + sqrt(L^2 / 9 + L M / 2)) / M, L = ln(2 / (1 - confidence)), where M stands in for
    its mean. This holds for any silhouette and any occluders; usual ones are several times better, since cells that no
    edge crosses have no error.

    References
    ----------
    Boucheron, Lugosi, Massart, Concentration Inequalities, 2013, theorem 2.10 (Bernstein).
    """
    log = math.log(2.0 / (1.0 - confidence))
    with np.errstate(divide="ignore"):
        bound = (log / 3 + np.sqrt(log**2 / 9 + log * hits / 2)) / hits
    return np.where(hits > 0, np.minimum(bound, 1.0), np.nan)


def _summary(error: np.ndarray) -> dict:
    told = np.abs(error[~np.isnan(error)])
    if not len(told):
        return {"rms": math.nan, "p95": math.nan, "max": math.nan, "untold": 1.0}
    return {
        "rms": float(np.sqrt((told**2).mean())),
        "p95": float(np.percentile(told, 95)),
        "max": float(told.max()),
        "untold": float(np.isnan(error).mean()),
    }


def _costs(world: Woods, rounds: int, quick: bool) -> dict:
    """Microseconds a pose, one thread."""
    n = len(world.world_from_camera)
    every = slice(0, n)
    work: dict[str, tuple[Callable[[], object], int]] = {}
    for rays in RAYS[:3] if quick else RAYS:
        some = slice(0, max(8, min(n, n * 256 // rays)))
        work[f"{rays} rays"] = (lambda r=rays, s=some: world.fraction(s, r), some.stop)
    work["256 rays, no wood"] = (lambda: world.fraction(every, 256, wood=False), n)
    work["256 rays, one pose a call"] = (lambda: [world.fraction(slice(i, i + 1), 256) for i in range(16)], 16)
    if (peer := _blender_peer(world)) is not None:
        work["peer: 100 rays over the frame in Blender"] = (lambda: [peer(i) for i in range(8)], 8)
    spent: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, (do, _) in work.items():
            started = time.perf_counter()
            do()
            spent[name].append(time.perf_counter() - started)
    return {name: float(np.median(spent[name])) * 1e6 / poses for name, (_, poses) in work.items()}


def _blender_peer(world: Woods) -> Callable[[int], set[str]] | None:
    """Do as BlenderProc's `visible_objects`: 10 x 10 rays over the frame, one scene.ray_cast each.

    References
    ----------
    Denninger et al., BlenderProc2, Journal of Open Source Software 8(82), 2023; python/camera/CameraValidation.py.
    """
    try:
        import bpy
        from mathutils import Matrix, Vector
    except ImportError:
        return None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    def make_data(mesh: Mesh, name: str) -> object:
        data = bpy.data.meshes.new(name)
        data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
        return data

    scene.collection.objects.link(bpy.data.objects.new("ground", make_data(world.ground, "ground")))
    tree = make_data(world.tree, "tree")
    for i, pose in enumerate(world.wood.world_from_instance):
        instance = bpy.data.objects.new(f"tree{i}", tree)
        instance.matrix_world = Matrix(pose.tolist())
        scene.collection.objects.link(instance)
    vehicle = bpy.data.objects.new("vehicle", make_data(world.shape.mesh, "vehicle"))
    scene.collection.objects.link(vehicle)
    bpy.context.view_layer.update()
    pixels = np.stack(np.meshgrid(np.linspace(0, HD.width, 10), np.linspace(0, HD.height, 10)), -1).reshape(-1, 2)

    def visible_objects(i: int) -> set[str]:
        vehicle.matrix_world = Matrix(world.world_from_vehicle[i].tolist())
        bpy.context.view_layer.update()
        graph = bpy.context.evaluated_depsgraph_get()
        camera = Cameras(HD, world.world_from_camera[i])
        origin = Vector(camera.position)
        found = set()
        for direction in camera.rays(pixels)[1]:
            hit, _, _, _, met, _ = scene.ray_cast(graph, origin, Vector(direction))
            if hit:
                found.add(met.name)
        return found

    visible_objects(0)
    return visible_objects


def report(results: dict) -> str:
    """Return a Markdown section."""
    error, cost, faces = results["error"], results["cost"], results["faces"]
    default, *others_by_rays = error["contenders"].values()
    rows = []
    for rays, s in list(default.items())[:SHOWN_ROWS]:
        spent = f"{cost[f'{rays} rays']:.0f}" if f"{rays} rays" in cost else ""
        peers = [f"{by_rays[rays]['rms']:.4f}" if rays in by_rays else "" for by_rays in others_by_rays]
        rows.append(
            (rays, f"{s['rms']:.4f}", f"{s['p95']:.4f}", f"{s['max']:.3f}", f"{error['bound'][rays]:.3f}", spent, *peers)
        )
    others = [(name, f"{us:.0f}") for name, us in cost.items() if not name[:-5].isdigit()]
    parts = [
        "## Visible share: error against rays",
        f"{results['views']} views of a tank ({faces['vehicle']:,} triangles) on {faces['ground']:,} triangles of "
        f"ground with {results['trees']:,} trees of {faces['tree']:,}, 15 to 120 m off; {error['partly_hidden']:.0%} "
        "are partly hidden. The reference casts a ray through every pixel of the target's box, or 400 across a small "
        "one. Errors are shares of the silhouette. The last columns have the RMS of other ways to place rays.",
        table(["rays", "RMS", "95%", "max", "stated bound, 95%", "us a pose", *list(error["contenders"])[1:]], rows),
        table(["other timings", "us a pose"], others),
    ]
    return "\n\n".join(parts)


def plots(results: dict, folder: Path) -> list[Path]:
    """Error against time, with the default marked."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    error, cost = results["error"], results["cost"]
    for name, by_rays in error["contenders"].items():
        known = [(int(r), s["rms"]) for r, s in by_rays.items() if s["rms"] == s["rms"] and s["rms"] > 0]
        left.plot(*zip(*known, strict=True), marker="o", markersize=4, label=name)
    bound = error["bound"]
    left.plot([int(r) for r in bound], list(bound.values()), "k--", linewidth=1, label="stated bound (95 %)")
    left.set(xscale="log", yscale="log", xlabel="rays", ylabel="error of the visible share (RMS)")
    left.legend(fontsize=7)
    ours = next(iter(error["contenders"].values()))
    timed = [(cost[f"{r} rays"], s["rms"], int(r)) for r, s in ours.items() if f"{r} rays" in cost]
    right.plot([t[0] for t in timed], [t[1] for t in timed], marker="o", markersize=4)
    for us, rms, rays in timed:
        right.annotate(f"{rays}", (us, rms), textcoords="offset points", xytext=(5, 4), fontsize=7)
        if rays == 256:
            right.plot([us], [rms], marker="*", markersize=15, color="tab:red", linestyle="none", label="default")
    right.set(xscale="log", yscale="log", xlabel="microseconds a pose (one thread)", ylabel="RMS error")
    right.legend(fontsize=8)
    path = folder / "visibility.png"
    figure.savefig(path, dpi=130)
    return [path]
