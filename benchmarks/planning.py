"""Planning: rows a second against images, workers and rays, peak memory, and the same work inside Blender."""

from __future__ import annotations

import importlib.util
import math
import multiprocessing
import threading
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil

from assets.library import Assets
from benchmarks.scenes import vehicles
from benchmarks.tables import table
from geometry.meshes import Mesh
from geometry.transforms import apply
from planning.config import parse_config
from planning.write import write_plan
from tests.planning_assets import hills

CELLS = 500  # 5e5 triangles of ground


def _assets(cells: int) -> Assets:
    shapes = vehicles(fine=4)
    categories = {name: name for name in shapes}
    ground = hills("hills", cells=cells, size=600.0, trees=300)
    return Assets(shapes, categories, {"hills": ground}, ("noon", "dusk"))


def _config(assets: Assets, images: int, rays: int) -> Any:
    classes = list(dict.fromkeys(assets.categories.values()))
    quota = {name: images // len(classes) + (i < images % len(classes)) for i, name in enumerate(classes)}
    return parse_config(
        {
            "assets": {
                "vehicles": [{"path": f"{name}.blend", "category": c} for name, c in assets.categories.items()],
                "sceneries": [{"path": "hills.blend"}],
            },
            "budget": {"images_per_class": quota},
            "camera": {"visibility_rays": rays},
        }
    )


def _memory(process: psutil.Process) -> int:
    """Bytes of a process and its children; pages they share count once."""
    total = 0
    for one in (process, *process.children(recursive=True)):
        try:
            total += one.memory_full_info().pss
        except psutil.Error:
            continue  # it has ended
    return total


def _plan(images: int, workers: int, rays: int, cells: int) -> dict[str, float]:
    """One plan, from config to file."""
    assets = _assets(cells)
    peak, done = [0], threading.Event()

    def watch() -> None:
        while not done.wait(0.25):
            peak[0] = max(peak[0], _memory(psutil.Process()))

    watcher = threading.Thread(target=watch, daemon=True)
    with TemporaryDirectory() as folder:
        config = _config(assets, images, rays)
        watcher.start()
        started = time.perf_counter()
        first: list[float] = []

        def progress(rows: int, _: int) -> None:
            # The first call comes when all hierarchies are built and nothing is planned yet.
            if not first:
                first.append(time.perf_counter())

        plan = write_plan(config, assets, Path(folder) / "plan.jsonl", workers=workers, progress=progress)
        ended = time.perf_counter()
        size = plan.path.stat().st_size
    done.set()
    watcher.join()
    return {
        "images": images,
        "workers": workers,
        "rays": rays,
        "seconds": ended - started,
        "set_up_s": first[0] - started,
        "rows_per_s": images / (ended - first[0]),
        "peak_mb": peak[0] / 2**20,
        "bytes_per_row": size / images,
    }


def _in_blender(images: int, rays: int, cells: int) -> dict[str, float]:
    """The same steps the way scripts inside Blender take them: one Python call of scene.ray_cast a ray."""
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
            points = (apply(pose, shape.mesh.vertices) - eye) @ axes.T
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


def _reply(queue: Any, work: Callable[..., dict[str, float]], arguments: tuple[int, ...]) -> None:
    queue.put(work(*arguments))


def _apart(work: Callable[..., dict[str, float]], *arguments: int) -> dict[str, float]:
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


def run(quick: bool) -> dict[str, Any]:
    """Everything; `quick` takes small plans and a small ground."""
    cells = 150 if quick else CELLS
    images = [500, 2000] if quick else [1_000, 10_000, 100_000, 1_000_000]
    middle = images[1] if quick else 20_000
    cores = psutil.cpu_count() or 1
    results: dict[str, Any] = {
        "triangles": 2 * cells**2,
        "by_images": [_apart(_plan, n, 2, 256, cells) for n in images],
        "by_workers": [_apart(_plan, middle, w, 256, cells) for w in (1, 2, 4) if w <= cores],
        "by_rays": [_apart(_plan, middle, 1, rays, cells) for rays in (16, 64, 256, 1024)],
        "peer": [],
    }
    if importlib.util.find_spec("bpy"):
        results["peer"] = [_apart(_in_blender, 50 if quick else 500, rays, cells) for rays in (100, 256)]
    return results


def report(results: dict[str, Any]) -> str:
    """Return a Markdown section."""
    rows = [
        (
            f"{r['images']:,}",
            str(r["workers"]),
            str(r["rays"]),
            f"{r['set_up_s']:.1f}",
            f"{r['seconds']:.1f}",
            f"{r['rows_per_s']:,.0f}",
            f"{r['peak_mb']:,.0f}",
            f"{r['bytes_per_row']:,.0f}",
        )
        for kind in ("by_images", "by_workers", "by_rays")
        for r in results[kind]
    ]
    head = ["images", "workers", "rays", "set-up (s)", "total (s)", "rows/s", "peak (MB)", "bytes a row"]
    parts = [
        "## Planning",
        f"From config to `plan.jsonl` on a ground of {results['triangles']:,} triangles with 300 trees and rocks: "
        "placing, settling, cameras, boxes, visibility, rejection and writing. Memory is that of all processes, shared "
        "pages counted once.",
        table(head, rows, left=0),
    ]
    if results["peer"]:
        ours = next(r["rows_per_s"] for r in results["by_rays"] if r["rays"] == 256)
        peer = [
            (str(r["rays"]), f"{r['rows_per_s']:,.1f}", f"{ours / r['rows_per_s']:,.1f} times") for r in results["peer"]
        ]
        parts += [
            "Inside Blender, one Python call of `scene.ray_cast` a ray, every place and camera taken at the first try, "
            "no obstacle or clearance checks, one process:",
            table(["rays", "rows/s", "hulldown, one worker, 256 rays"], peer, left=0),
        ]
    return "\n\n".join(parts)


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Rows a second and memory against images, and against rays."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.6), layout="constrained")
    charts = (
        ("by_images", "images", "seconds", "seconds, all told", True),
        ("by_images", "images", "peak_mb", "peak memory (MB)", False),
        ("by_rays", "rays", "rows_per_s", "rows a second, one worker", False),
    )
    for axis, (kind, x, y, title, log) in zip(figure.subplots(1, 3), charts, strict=True):
        axis.plot([r[x] for r in results[kind]], [r[y] for r in results[kind]], "o-")
        axis.set_xscale("log")
        if log:
            axis.set_yscale("log")
        else:
            axis.set_ylim(bottom=0)
        axis.set_xlabel(x)
        axis.set_title(title)
    path = folder / "planning.png"
    figure.savefig(path, dpi=100)
    return [path]
