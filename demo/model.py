"""A vehicle's .blend file under construction: objects with modifiers, parts that turn, and the litter of real files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from hulldown.demo.shapes import Point, Shape, make_standing_box


class BlendModel:
    """One vehicle, modeled in meters, stored in file units, `unit` of which make a meter."""

    def __init__(self, name: str, *, unit: float = 1.0) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.unit = unit
        self.scene = bpy.context.scene
        self.scene.unit_settings.scale_length = 1 / unit
        self.collection = bpy.data.collections.new(name)
        self.scene.collection.children.link(self.collection)
        self.home: dict[str, bpy.types.Collection] = {"hull": self.collection}  # part -> collection of its objects
        self.parent: dict[str, bpy.types.Object | None] = {"hull": None}  # part -> the object that its objects hang on
        self.origin: dict[str, np.ndarray] = {"hull": np.zeros(3)}

    def pivot(self, part: str, at: Point, *, on: str = "hull", name: str | None = None) -> None:
        """Add a part that turns about the origin of an empty, its objects being the empty's children."""
        empty = bpy.data.objects.new(name or part.capitalize(), None)
        empty.empty_display_size = 0.5 * self.unit
        self._set_part_root(empty, part, at, on)

    def add_part_on_mesh(self, part: str, at: Point, shape: Shape, material: Any, *, bevel: float, name: str) -> None:
        """Add a part that turns about the origin of its first mesh object, the others being that object's children."""
        center = np.asarray(at, float)
        mesh_object = self._make_mesh_object(name, Shape(shape.vertices - center, shape.faces), material, bevel)
        self._set_part_root(mesh_object, part, at, "hull")

    def add_part_in_collection(self, part: str, at: Point, *, name: str, on: str = "hull") -> None:
        """Add a part that is a collection of its own, in that of `on`, with an empty in it that marks the pivot."""
        self.home[part] = bpy.data.collections.new(name)
        self.home[on].children.link(self.home[part])
        self._set_part_root(bpy.data.objects.new(f"{name}_Pivot", None), part, at, on)

    def add(
        self,
        name: str,
        shape: Shape,
        material: Any,
        *,
        part: str = "hull",
        bevel: float = 0.012,
        smooth: float = 35.0,
        mirror: bool = False,
        copies: tuple[int, float] | None = None,
    ) -> Any:
        """Add a mesh object in vehicle coordinates; `mirror` across y and `copies` (count, step in x) are modifiers."""
        thing = self._make_mesh_object(name, shape, material, bevel, smooth=smooth)
        if copies is not None:
            array = thing.modifiers.new("Array", "ARRAY")
            array.count, array.use_relative_offset, array.use_constant_offset = copies[0], False, True
            array.constant_offset_displace = (copies[1] * self.unit, 0, 0)
        if mirror:
            thing.modifiers.new("Mirror", "MIRROR").use_axis = (False, True, False)
        self._link_to_part(thing, part)
        return thing

    def add_crate(self, name: str, size: Point, at: Point, material: Any, *, turn_deg: float = 0.0) -> None:
        """Add a box as artists leave it: a unit cube with its scale and rotation not applied."""
        thing = self._make_mesh_object(name, make_standing_box((1.0, 1.0, 1.0), (0.0, 0.0, -0.5)), material, 0.02)
        x, y, z = at
        place = Matrix.Translation(np.array([x, y, z + size[2] / 2]) * self.unit)
        thing.matrix_world = place @ Matrix.Rotation(np.radians(turn_deg), 4, "Z") @ Matrix.Diagonal((*size, 1.0))
        self.collection.objects.link(thing)

    def parent_all_to_scaled_root(self, scale: float) -> None:
        """Hang everything on an empty with this scale, and undo it in the children: what an importer leaves behind."""
        root = bpy.data.objects.new("Import_Root", None)
        self.collection.objects.link(root)
        root.matrix_basis = Matrix.Scale(scale, 4)
        undo = root.matrix_basis.inverted()
        for thing in list(self.collection.all_objects):
            if thing.parent is None and thing is not root:
                thing.parent = root
                thing.matrix_basis = undo @ thing.matrix_basis

    def save(self, path: Path) -> None:
        """Add what such files usually have too (floor, grid, camera, lamps), and write the file."""
        u = self.unit
        floor = bpy.data.objects.new(
            "Floor", _make_blender_mesh("Floor", make_standing_box((24 * u, 24 * u, 0.1 * u), (0, 0, -0.1 * u)), 1)
        )
        grid_lines = [((-12, y, 0), (12, y, 0)) for y in range(-12, 13)] + [((x, -12, 0), (x, 12, 0)) for x in range(-12, 13)]
        grid_mesh = bpy.data.meshes.new("Grid")
        ends = [np.array(p, float) * u for line in grid_lines for p in line]
        grid_mesh.from_pydata(ends, [(2 * i, 2 * i + 1) for i in range(len(grid_lines))], [])
        grid = bpy.data.objects.new("Grid", grid_mesh)
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.matrix_world = Matrix.Translation((11 * u, -11 * u, 5 * u)) @ Matrix.Rotation(1.2, 4, "X")
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        sun.data.energy = 3.0
        sun.rotation_euler = (0.7, 0.2, 0.5)
        area = bpy.data.objects.new("Fill_Light", bpy.data.lights.new("Fill_Light", "AREA"))
        area.location = (-6 * u, 8 * u, 9 * u)
        for thing in (floor, grid, camera, sun, area):
            self.scene.collection.objects.link(thing)
        self.scene.camera = camera
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, relative_remap=True)

    def _make_mesh_object(self, name: str, shape: Shape, material: Any, bevel: float, *, smooth: float = 35.0) -> Any:
        thing = bpy.data.objects.new(name, _make_blender_mesh(name, shape, self.unit, smooth))
        thing.data.materials.append(material)
        if bevel:
            rounding = thing.modifiers.new("Bevel", "BEVEL")
            rounding.width, rounding.segments, rounding.limit_method = bevel * self.unit, 2, "ANGLE"
            rounding.angle_limit = np.radians(40)
            rounding.harden_normals = True
        return thing

    def _set_part_root(self, thing: Any, part: str, at: Point, on: str) -> None:
        self.home.setdefault(part, self.home[on])
        self.home[part].objects.link(thing)
        self.origin[part] = np.asarray(at, float)
        thing.parent = self.parent[on]
        thing.location = (self.origin[part] - self.origin[on]) * self.unit
        self.parent[part] = thing

    def _link_to_part(self, thing: Any, part: str) -> None:
        """Set a parent so that object and vehicle coordinates agree at rest: patterns stay whole across parts."""
        self.home[part].objects.link(thing)
        if (parent := self.parent[part]) is not None:
            thing.parent = parent
            thing.matrix_parent_inverse = Matrix.Translation(-self.origin[part] * self.unit)


def _make_blender_mesh(name: str, shape: Shape, unit: float, smooth: float = 35.0) -> Any:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(shape.vertices * unit, [], shape.faces)
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=np.radians(smooth))
    _add_box_uv(mesh, shape, tile=3.0)
    return mesh


def _add_box_uv(mesh: Any, shape: Shape, *, tile: float) -> None:
    """Add a UV map that projects each face along its dominant axis, `tile` meters to the unit square."""
    normals = np.empty(3 * len(mesh.polygons))
    mesh.polygons.foreach_get("normal", normals)
    axis = np.abs(normals.reshape(-1, 3)).argmax(axis=1)
    uv: list[Sequence[float]] = []
    for face, k in zip(shape.faces, axis, strict=True):
        uv.extend(shape.vertices[list(face)][:, [i for i in range(3) if i != k]] / tile)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.array(uv, np.float32).ravel())
