"""Build .blend files as people make them, and render them with Cycles. Run by messy_export.py, in Blender.

``python messy_blends.py FOLDER build`` writes for each case FOLDER/<case>.blend and FOLDER/<case>.<view>.png (Cycles'
picture of the case without its clutter), and FOLDER/cases.json with the cameras in the world of the file.
``python messy_blends.py FOLDER tidy`` renders the tidy twins named in FOLDER/tidy.json. The cases are in
messy_vehicles, messy_contents, and messy_sceneries.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from hulldown.render.blender.scene import append_twin_and_materials
from hulldown.tests.builders.blend_parts import empty, fresh, place, save
from hulldown.tests.builders.messy_export import FOV, SIZE
from hulldown.tests.builders.messy_parts import CASES, FOLDER, box

for cases in ("messy_vehicles", "messy_contents", "messy_sceneries"):
    importlib.import_module(f"hulldown.tests.builders.{cases}")  # this import fills CASES


def build(name: str) -> dict:
    fresh()
    about = {"kind": "vehicle", "options": {}, "hide": [], "truth": True, "distance": 16.0, "yaw_deg": 0.0}
    about |= CASES[name]()
    about["file_from_meters"] = np.array(about.get("file_from_meters", Matrix.Identity(4))).tolist()
    save(FOLDER / f"{name}.blend", compress=name in ("clutter", "library_compressed"), relative_remap=False)
    return about


def cameras_of(about: dict) -> list[Matrix]:
    """Cameras, in the world of the file, that look at the center from the front left above and the back right."""
    return [camera_at(about, 40, 0.6), camera_at(about, 205, 0.25)]


def camera_at(about: dict, yaw_deg: float, rise: float) -> Matrix:
    yaw = math.radians(about["yaw_deg"] + yaw_deg)
    out = Vector((math.cos(yaw), math.sin(yaw), rise)).normalized() * about["distance"]
    center = Vector(about.get("center", (0, 0, 1.2)))
    meters = Matrix.Translation(center + out) @ out.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return Matrix(about["file_from_meters"]) @ meters


def render_masks(poses: list[Matrix], path: Path, *, unit: float = 1.0) -> None:
    """Write Cycles' pictures from each camera as path.0.png, path.1.png, ..."""
    scene = bpy.context.scene
    camera = scene.camera = place("truth camera", bpy.data.cameras.new("truth camera"))
    camera.data.sensor_fit, camera.data.angle = "HORIZONTAL", FOV
    camera.data.clip_start, camera.data.clip_end = 0.01 * unit, 1e5 * unit
    render = scene.render
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.use_compositing = False
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 1, False, 0
    # One ray through the center of each pixel.
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.cycles.transparent_max_bounces = 0
    for i, pose in enumerate(poses):
        # A camera has no scale.
        camera.matrix_world = Matrix.LocRotScale(pose.to_translation(), pose.to_quaternion(), None)
        render.filepath = f"{path}.{i}.png"
        bpy.ops.render.render(write_still=True)


def build_all() -> None:
    fresh()
    box("Wheel", (1, 0.3, 1))
    save(FOLDER / "soon_gone.blend")
    cases = {name: build(name) for name in CASES}
    (FOLDER / "soon_gone.blend").unlink()
    for name in ("lib.blend", "font.woff2"):
        (FOLDER / name).unlink()
        os.mkfifo(FOLDER / name)
    for name, about in cases.items():
        poses = cameras_of(about)
        about["cameras"] = np.array(poses).tolist()
        if about["truth"]:
            bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"), load_ui=False, use_scripts=False)
            for hidden in about["hide"]:
                bpy.data.objects[hidden].hide_render = True
            render_masks(poses, FOLDER / name, unit=Matrix(about["file_from_meters"]).median_scale)
    for name, suffix in (("y_up", "glb"), ("y_up", "fbx"), ("library_vehicle", "obj")):
        export_as(name, FOLDER / f"imported.{suffix}")
    (FOLDER / "cases.json").write_text(json.dumps(cases), encoding="utf-8")


def render_tidy() -> None:
    """Render the tidy twins named in tidy.json from their cameras, loaded as the renderer loads them."""
    for name, twin in json.loads((FOLDER / "tidy.json").read_text(encoding="utf-8")).items():
        fresh()
        collection, _ = append_twin_and_materials(twin["path"])
        bpy.context.scene.collection.children.link(collection)
        if twin["kind"] == "vehicle":
            root = empty("root")
            for obj in collection.objects:
                obj.parent = root
                obj.matrix_parent_inverse = Matrix(np.array(obj["hulldown_rest"]).reshape(4, 4))
        else:
            for obj in collection.objects:
                obj.hide_render = obj.name.partition(".")[0] in twin["hide"]
        render_masks([Matrix(c) for c in twin["cameras"]], FOLDER / f"{name}.tidy")


def export_as(name: str, path: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"), load_ui=False, use_scripts=False)
    if path.suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path), export_apply=True, export_animations=False)
    elif path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), bake_anim=False)
    else:
        bpy.ops.wm.obj_export(filepath=str(path))


if __name__ == "__main__":
    {"build": build_all, "tidy": render_tidy}[sys.argv[2]]()
