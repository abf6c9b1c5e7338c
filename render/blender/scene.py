"""A loaded scenery, the tidy twin of its file, and a row's vehicles, camera, HDRI, and weather in it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np

from hulldown.blender.frames import set_object_pose, world_from_blender_camera
from hulldown.blender.opening import disarm_file, open_blend
from hulldown.blender.tidy_properties import PART_PROPERTY, REST_PROPERTY, VISIBILITY_FLAGS
from hulldown.render.blender.covers import UNDERSIDE_PROPERTY
from hulldown.render.blender.cycles import Unusable
from hulldown.render.blender.fog import Fog
from hulldown.render.blender.hdri_light import HdriWorld
from hulldown.render.blender.lens import set_distorting_lens
from hulldown.render.blender.messages import CameraInput, VehicleInput
from hulldown.render.blender.paint_nodes import PaintedMaterials
from hulldown.render.blender.streaks import Precipitation, falling_streaks
from hulldown.render.blender.surfaces import Surfaces
from hulldown.weather.kinds import WEATHER_KINDS, Weather, airlight_radiance

MAX_KEPT_VEHICLES = 8  # files in memory if rows have companions, which recur
SENSOR_WIDTH_MM = 36.0
MIN_FOCAL_LENGTH_MM = 1.0  # Blender's limit
CLIP_END_M = 1e7  # Cycles traces rays, so a far clip plane costs no depth resolution


class BlenderScene:
    """The tidy twin of a scenery with our own camera and light, which is set up for one row after the other."""

    def __init__(self, tidy: str) -> None:
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)  # an open file isn't read again
        with bpy.data.libraries.load(tidy) as (source, _):
            refuse_newer_twin(source, tidy)
        # Appending takes the square of the number of objects. The twin has no scene, and another one's settings
        # wouldn't count: ours is new.
        open_blend(tidy)
        self.scene = bpy.data.scenes.new("hulldown")
        self.scene.collection.children.link(bpy.data.collections[0])
        self.root = bpy.data.objects.new("hulldown", None)
        self.scene.collection.objects.link(self.root)
        self.camera = self._add_object("hulldown camera", bpy.data.cameras.new("hulldown camera"))
        self.scene.camera = self.camera
        self.world = HdriWorld(self.scene)
        fog = self._add_object("hulldown fog", bpy.data.meshes.new("hulldown fog"))
        self.fog = Fog(fog, self.world)
        self.precipitation = Precipitation(self._add_object("hulldown precipitation", bpy.data.meshes.new("hulldown drops")))
        self.surfaces = Surfaces()
        self._vehicles: dict[str, _LoadedVehicle] = {}  # by prepared file, last used last
        self._companions = False  # whether any row has had more than one vehicle file
        self._lowest = math.inf  # meters: height of the lowest vehicle

    def _add_object(self, name: str, data: Any) -> Any:
        obj = bpy.data.objects.new(name, data)
        obj.parent = self.root
        self.scene.collection.objects.link(obj)
        return obj

    def place_vehicles(self, vehicles: Sequence[VehicleInput]) -> list[list[Any]]:
        """Place these vehicles and no others in the scenery; return the objects of each."""
        used = dict.fromkeys((vehicle.tidy for vehicle in vehicles), 0)
        placed = []
        self._lowest = min((vehicle.world_from_parts[0][2][3] for vehicle in vehicles), default=math.inf)
        for vehicle in vehicles:
            loaded = self._vehicles.pop(vehicle.tidy, None) or _LoadedVehicle(vehicle.tidy, self.scene, self.root)
            self._vehicles[vehicle.tidy] = loaded
            objects = loaded.copy(used[vehicle.tidy])
            used[vehicle.tidy] += 1
            parts = np.asarray(vehicle.world_from_parts, dtype=np.float64)
            above = np.linalg.inv(parts[0])[2].tolist()
            for obj in objects:
                obj[UNDERSIDE_PROPERTY] = above
                set_object_pose(obj, parts[obj[PART_PROPERTY]] @ np.array(obj[REST_PROPERTY]).reshape(4, 4))
            if loaded.painted.needs_paint_nodes(vehicle.paint):
                self.surfaces.clear()  # paint is inserted below water and snow
            loaded.painted.paint(objects, vehicle.paint)
            placed.append(objects)
        for tidy, loaded in self._vehicles.items():
            loaded.show_copies(used.get(tidy, 0))
        self._companions = self._companions or len(used) > 1
        kept = MAX_KEPT_VEHICLES if self._companions else 1  # sorted rows of one vehicle don't return to it
        for tidy in [t for t in self._vehicles if t not in used][: max(0, len(self._vehicles) - kept)]:
            self._vehicles.pop(tidy).remove()
        return placed

    def set_camera(self, camera: CameraInput) -> None:
        """Set the row's camera."""
        self._view = camera
        set_object_pose(self.camera, world_from_blender_camera(camera.world_from_camera))
        data = self.camera.data
        data.sensor_fit = "HORIZONTAL"
        data.lens_unit = "MILLIMETERS"
        intrinsics, render = camera.intrinsics, self.scene.render
        width, height = intrinsics.width, intrinsics.height
        render.resolution_x, render.resolution_y = width, height
        distorting = any(intrinsics.distortion)
        if intrinsics.pinhole is None or distorting:  # whose shader shifts and stretches
            across, stretch, (cx, cy) = 2 * intrinsics.half_tangents[0], 1.0, (width / 2, height / 2)
        else:
            fx, fy, cx, cy = intrinsics.pinhole
            across, stretch = width / fx, fx / fy
        data.lens = max(SENSOR_WIDTH_MM / across, MIN_FOCAL_LENGTH_MM)
        data.sensor_width = across * data.lens
        render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / stretch), max(1.0, stretch)
        data.shift_x, data.shift_y = (width / 2 - cx) / width, (cy - height / 2) / width * stretch
        if distorting:
            set_distorting_lens(data, intrinsics, camera.near)
        elif data.type != "PERSP":
            data.type = "PERSP"
        data.clip_start, data.clip_end = camera.near, CLIP_END_M

    def set_weather(self, weather: Weather | None, seed: int) -> None:
        """Fill the air and cover surfaces, or undo both, after everything else is set, since fog is lit by the sky."""
        if not weather:
            self.fog.clear()
            self.precipitation.clear()
            self.surfaces.clear()
            return
        vehicles = [obj for loaded in self._vehicles.values() for obj in loaded.objects()]
        self.surfaces.set(weather.kind, weather.ground_cover, weather.vehicle_cover, vehicles)
        pose = np.array(self._view.world_from_camera)
        glow = airlight_radiance(weather.kind, self.world.sky_airlight_radiance())
        below = max(0.0, pose[2, 3] - self._lowest)
        self.fog.fill_air(weather.kind, weather.visibility_m, glow, pose[:3, 3], below=below)
        streaks = falling_streaks(weather, self._view, seed)
        if streaks is None:
            self.precipitation.clear()
        else:
            radiance = glow * WEATHER_KINDS[weather.kind].share_of_sky
            self.precipitation.draw_streaks(streaks, radiance, pose[:3, 3])


class _LoadedVehicle:
    """Copies of a vehicle's tidy twin; unused ones are hidden, since unlinking would rebuild Blender's graph."""

    def __init__(self, tidy: str, scene: Any, root: Any) -> None:
        collection, materials = append_twin_and_materials(tidy)
        self._scene, self._collections = scene, [collection]
        self.painted = PaintedMaterials(collection.objects, materials)
        for obj in collection.objects:
            obj.parent = root
            obj.matrix_basis.identity()  # `set_object_pose` has the whole transform
        self._looks = [[getattr(obj, ray) for ray in VISIBILITY_FLAGS] for obj in collection.objects]  # as in the file
        scene.collection.children.link(collection)

    def copy(self, number: int) -> list[Any]:
        while len(self._collections) <= number:
            twin = bpy.data.collections.new(self._collections[0].name)
            for obj in self._collections[0].objects:
                twin.objects.link(obj.copy())  # shares mesh and materials
            self._collections.append(twin)
            self._scene.collection.children.link(twin)
        return list(self._collections[number].objects)

    def show_copies(self, copies: int) -> None:
        for number, collection in enumerate(self._collections):
            for obj, look in zip(collection.objects, self._looks, strict=True):
                for ray, seen in zip(VISIBILITY_FLAGS, look, strict=True):
                    if getattr(obj, ray) != (shown := seen and number < copies):
                        setattr(obj, ray, shown)

    def objects(self) -> Iterator[Any]:
        for collection in self._collections:
            yield from collection.objects

    def remove(self) -> None:
        bpy.data.batch_remove([*self.objects(), *self._collections])
        bpy.data.orphans_purge(do_recursive=True)


def refuse_newer_twin(source: Any, tidy: str) -> None:
    """Raise Unusable for a tidy twin by a later Blender; `source` is what `libraries.load` yields."""
    if source.version[:2] > bpy.app.version[:2]:
        wrote = ".".join(map(str, source.version[:2]))
        problem = f"{tidy} was written by Blender {wrote}, newer than the {bpy.app.version_string} that renders"
        remedy = f"render with Blender {wrote}, or with another --cache, for which files are read again"
        raise Unusable(problem, remedy)


def append_twin_and_materials(tidy: str) -> tuple[bpy.types.Collection, dict[str, bpy.types.Material]]:
    """Append the collection of a tidy twin and its materials, by the twin's names."""
    with bpy.data.libraries.load(tidy, link=False) as (source, target):
        refuse_newer_twin(source, tidy)
        target.collections = source.collections[:1]
        names = list(source.materials)
        target.materials = list(names)
    disarm_file()  # twins don't need it, but the cache may have come with the plan: see docs/safety.md
    return target.collections[0], dict(zip(names, target.materials, strict=True))
