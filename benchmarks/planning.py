"""Planning: rows a second against images, workers and rays, peak memory, and the same work inside Blender."""

from __future__ import annotations

import hashlib
import importlib.util
import math
import multiprocessing
import resource
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hulldown.assets.plan_assets import Assets
from hulldown.benchmarks.scenes import vehicles
from hulldown.demo.project import CONFIG_NAME, create_project, demo_config_text
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import transform_points
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library
from hulldown.planning.planner import POSITIONS_PER_BLOCK, Planner
from hulldown.tests.builders.planning_assets import hills

GROUND_CELLS = 500  # 5e5 triangles of ground
VARIANTS = (  # vehicles, distractors, and whether there are woods
    (1, 0, True), (1, 3, False), (2, 3, True), (4, 3, True), (4, 0, False),
)  # fmt: skip


def _assets(cells: int) -> Assets:
    shapes = vehicles(fine=4)
    categories = {name: name for name in shapes}
    ground = hills("hills", cells=cells, size=600.0, trees=300)
    return Assets(shapes, categories, {"hills": ground}, ("noon", "dusk"))


def _config(assets: Assets, images: int, rays: int) -> Any:
    classes = list(dict.fromkeys(assets.categories.values()))
    quota = {name: images // len(classes) + (i < images % len(classes)) for i, name in enumerate(classes)}
    return Config.of(
        {
            "assets": {
                "vehicles": [{"path": f"{name}.blend", "category": c} for name, c in assets.categories.items()],
                "sceneries": [{"path": "hills.blend"}],
            },
            "budget": {"images_per_class": quota},
            "camera": {"visibility_rays": rays},
        }
    )


def _case(images: int, rays: int, cells: int) -> tuple[Any, Assets]:
    """One vehicle an image on hills with 300 trees and rocks."""
    assets = _assets(cells)
    return _config(assets, images, rays), assets


def _init_case(folder: str, images: int, vehicles: int, distractors: int, woods: bool) -> tuple[Any, Assets]:
    """The config that `hulldown init` writes, or one that differs from it in these numbers."""
    config = Config.read(Path(folder) / CONFIG_NAME)
    assets = load_library(config).assets
    classes = len(set(assets.categories.values()))
    placement, budget = config.placement, config.budget
    if images != classes * budget.images_per_class:
        budget = budget.model_copy(update={"images_per_class": images // classes})
    if (1, vehicles) != tuple(placement.vehicles_per_image):
        placement = placement.model_copy(update={"vehicles_per_image": (vehicles, vehicles)})
    if distractors != placement.distractors_per_image[1]:
        placement = placement.model_copy(update={"distractors_per_image": (distractors, distractors)})
    if not woods:
        no = np.zeros(0, dtype=bool)
        bare = {
            "instance_mesh": no.astype(int),
            "world_from_instance": np.zeros((0, 4, 4)),
            "instance_names": (),
            "instance_gives_way": no,
            "instance_is_water": no,
        }
        assets = replace(assets, sceneries={name: replace(s, **bare) for name, s in assets.sceneries.items()})
    return config.model_copy(update={"placement": placement, "budget": budget}), assets


def _plan(make: Callable[..., tuple[Any, Assets]], *arguments: Any) -> dict[str, float]:
    """Plan a case in this process: CPU seconds, which a busy machine does not stretch, and the peak of memory."""
    config, assets = make(*arguments)
    started = time.process_time()
    planner = Planner(config, assets)
    ready, rows, size = time.process_time(), 0, 0
    for start in range(0, planner.budget.n_planned_positions, POSITIONS_PER_BLOCK):
        lines, n = planner.lines(start, min(start + POSITIONS_PER_BLOCK, planner.budget.n_planned_positions))
        rows, size = rows + n, size + len(lines)
    seconds = time.process_time() - ready
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "images": rows,
        "set_up_s": ready - started,
        "rows_per_s": rows / seconds,
        "peak_mb": peak / 2**20,
        "bytes_per_row": size / rows,
    }


def _in_blender(images: int, rays: int, cells: int) -> dict[str, float]:
    """Do the same steps as scripts inside Blender do: one Python call of scene.ray_cast a ray."""
    import bpy

    assets = _assets(cells)
    scenery, shape = assets.sceneries["hills"], next(iter(assets.vehicles.values()))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    assert scenery.ground is not None

    def add(name: str, mesh: Mesh) -> Any:
        data = bpy.data.meshes.new(name)
        data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
        thing = bpy.data.objects.new(name, data)
        scene.collection.objects.link(thing)
        return thing

    add("ground", scenery.ground)
    data = [add(f"kind {i}", mesh) for i, mesh in enumerate(scenery.obstacle_meshes)]
    for i, pose in zip(scenery.instance_mesh.tolist(), scenery.world_from_instance, strict=True):
        copy = bpy.data.objects.new("tree", data[i].data)
        copy.matrix_world = pose.tolist()
        scene.collection.objects.link(copy)
    for kind in data:
        bpy.data.objects.remove(kind)
    target = add("vehicle", shape.mesh)
    rng = np.random.default_rng(0)
    low, high = 0.8 * scenery.ground.bounds[:, :2]
    length, width, height = shape.size_xyz.tolist()
    grid = [(x * length, y * width) for x in np.linspace(-0.5, 0.5, 5) for y in np.linspace(-0.5, 0.5, 5)]
    top, size_x, size_y, taken = 1e3, 1920, 1080, 0

    def down(x: float, y: float) -> tuple[bool, Any, Any]:
        hit, point, normal, *_ = scene.ray_cast(graph, (x, y, top), (0.0, 0.0, -1.0))
        return hit, point, normal

    graph = bpy.context.evaluated_depsgraph_get()
    scene.ray_cast(graph, (0.0, 0.0, top), (0.0, 0.0, -1.0))  # builds what is built once
    started = time.perf_counter()
    while taken < images:
        target.location.z = -1e4  # out of the way of its own footprint
        bpy.context.view_layer.update()
        x, y = rng.uniform(low, high).tolist()
        hit, _, normal = down(x, y)
        if not hit or normal.z < math.cos(math.radians(30.0)):
            continue
        yaw = rng.uniform(0.0, 2 * math.pi)
        c, s = math.cos(yaw), math.sin(yaw)
        heights = [p.z for dx, dy in grid for ok, p, _ in [down(x + c * dx - s * dy, y + s * dx + c * dy)] if ok]
        target.location, target.rotation_euler = (x, y, float(np.mean(heights))), (0.0, 0.0, yaw)
        bpy.context.view_layer.update()
        pose = np.array(target.matrix_world)
        for _ in range(5):
            fov = math.radians(rng.uniform(40.0, 60.0))
            f = size_x / 2 / math.tan(fov / 2)
            distance = height * f / (size_y * rng.uniform(0.1, 0.3)) * rng.uniform(0.7, 4.0)
            azimuth, elevation = rng.uniform(0.0, 2 * math.pi), math.radians(rng.uniform(3.0, 35.0))
            away = np.array(
                [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
            )
            eye = pose[:3, 3] + [0.0, 0.0, height / 2] + distance * away
            right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            axes = np.stack([right, np.cross(-away, right), -away])
            points = (transform_points(pose, shape.mesh.vertices) - eye) @ axes.T
            pixels = points[:, :2] / points[:, 2:]
            corners = np.stack([pixels.min(axis=0), pixels.max(axis=0)])
            through = corners[0] + rng.random((rays, 2)) * (corners[1] - corners[0])
            along = np.column_stack([through, np.ones(rays)]) @ axes
            seen = 0
            for direction in along.tolist():
                found, _, _, _, thing, _ = scene.ray_cast(graph, eye.tolist(), direction)
                seen += found and thing.name == "vehicle"
            taken += 1
            if taken == images:
                break
    seconds = time.perf_counter() - started
    return {"images": images, "rays": rays, "seconds": seconds, "rows_per_s": images / seconds}


def _reply(queue: Any, work: Callable[..., dict[str, float]], arguments: tuple[Any, ...]) -> None:
    queue.put(work(*arguments))


def _apart(work: Callable[..., dict[str, float]], *arguments: Any) -> dict[str, float]:
    """`work` in a fresh process, so that peaks of memory are its own."""
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=_reply, args=(queue, work, arguments))
    process.start()
    while process.is_alive() and queue.empty():
        time.sleep(0.05)
    result = queue.get(timeout=10)
    process.join()
    return result


def config_hash() -> str:
    """Return a hash of the config that `hulldown init` writes, of its values without its comments."""
    config = Config.of(tomllib.loads(demo_config_text()))
    return hashlib.sha256(config.model_dump_json().encode()).hexdigest()[:12]


def run(quick: bool, project: Path | None = None) -> dict[str, Any]:
    """Everything; `quick` takes small plans and a small ground. `project` is a folder that `hulldown init` made."""
    cells = 150 if quick else GROUND_CELLS
    images = [420, 4200, 42_000]
    some = images[0] if quick else images[1]
    alone = 4200 if quick else 42_000
    results: dict[str, Any] = {"triangles": 2 * cells**2, "config": config_hash(), "init": [], "variants": [], "peer": []}
    with TemporaryDirectory() as made:
        folder = str(project or made)
        if not project:
            create_project(folder)
        load_library(Config.read(Path(folder) / CONFIG_NAME))  # reads them into the cache
        # The case that the others are compared with, before and after them.
        results["alone"] = [_apart(_plan, _case, alone, 256, cells)]
        results["init"] = [_apart(_plan, _init_case, folder, n, 1, 3, True) for n in images]
        for vehicles, distractors, woods in VARIANTS:
            measured = _apart(_plan, _init_case, folder, some, vehicles, distractors, woods)
            results["variants"].append({"vehicles": vehicles, "distractors": distractors, "woods": woods, **measured})
        results["alone"].append(_apart(_plan, _case, alone, 256, cells))
    results["by_rays"] = [{"rays": rays, **_apart(_plan, _case, alone, rays, cells)} for rays in (16, 64, 256, 1024)]
    if importlib.util.find_spec("bpy") and not quick:
        results["peer"] = [_apart(_in_blender, 500, rays, cells) for rays in (100, 256)]
    return results


def report(results: dict[str, Any]) -> str:
    """A Markdown section."""
    one = sum(r["rows_per_s"] for r in results["alone"]) / len(results["alone"])
    lines = [
        "## Planning",
        "",
        "From assets to the lines of `plan.jsonl`, in one process. The config is the one that `hulldown init` writes "
        f"(SHA-256 {results['config']}): ten vehicles, up to three distractors an image, two sceneries with more "
        f"than 7,000 trees, bushes, and rocks each. The hills have {results['triangles']:,} triangles, 300 trees and "
        "rocks, and no distractors; they're measured first and last.",
        "",
        "| config | images | rows/CPU s | peak (MB) | bytes a row |",
        "|---|---:|---:|---:|---:|",
    ]
    for r in results["alone"]:
        lines.append(_line("one vehicle on hills", r))
    for r in results["init"]:
        lines.append(_line("as `init` writes it", r))
    for r in results["variants"]:
        many = "s" * (r["vehicles"] > 1)
        what = f"{r['vehicles']} vehicle{many}, {r['distractors']} distractors, {'woods' if r['woods'] else 'no woods'}"
        lines.append(_line(what, r))
    lines += ["", "With other numbers of visibility rays, on hills:", "", "| rays | rows/CPU s |", "|---:|---:|"]
    lines += [f"| {r['rays']} | {r['rows_per_s']:,.0f} |" for r in results["by_rays"]]
    if results["peer"]:
        lines += [
            "",
            "One process in Blender that calls `scene.ray_cast` for each ray, takes the first place and camera, and "
            "checks no clearance plans "
            + ", and ".join(
                f"{r['rows_per_s']:,.1f} rows/s with {r['rays']} rays (1/{one / r['rows_per_s']:,.1f} of hulldown's)"
                for r in results["peer"]
            )
            + ". hulldown casts 256 rays there, for one vehicle on hills.",
        ]
    return "\n".join(lines) + "\n"


def _line(what: str, r: dict[str, float]) -> str:
    return f"| {what} | {r['images']:,} | {r['rows_per_s']:,.0f} | {r['peak_mb']:,.0f} | {r['bytes_per_row']:,.0f} |"


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Rows a CPU second against images, and against rays."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    charts = (
        ("init", "images", "rows_per_s", "rows a CPU second, as `init` writes it"),
        ("init", "images", "peak_mb", "peak memory (MB), as `init` writes it"),
        ("by_rays", "rays", "rows_per_s", "rows a CPU second, one vehicle on hills"),
    )
    for axis, (kind, x, y, title) in zip(figure.subplots(1, 3), charts, strict=True):
        axis.plot([r[x] for r in results[kind]], [r[y] for r in results[kind]], "o-")
        axis.set_xscale("log")
        axis.set_ylim(bottom=0)
        axis.set_xlabel(x)
        axis.set_title(title)
    path = folder / "planning.png"
    figure.savefig(path, dpi=100)
    return [path]
