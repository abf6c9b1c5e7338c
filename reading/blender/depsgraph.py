"""Evaluate a scene as the renderer sees it: modifiers at render levels, instances, particles."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import bpy
import numpy as np
from jaxtyping import Bool, Float

from hulldown.base.errors import AssetError
from hulldown.blender.buffers import read_property
from hulldown.blender.shaders import is_clear_material, is_displaced_material
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.seen_surface import faces_with_area
from hulldown.geometry.transforms import transform_points
from hulldown.reading.blender.capture import OUR_CAMERA, visit_render_depsgraph
from hulldown.reading.blender.duplicates import Duplicate
from hulldown.reading.blender.exact_poses import Poses
from hulldown.reading.blender.hidden_objects import (
    SOLID_TYPES,
    SURFACE_TYPES,
    UNDRAWN_TYPES,
    add_hidden_object_rows,
    camera_dependence_reason,
    is_hidden_in_viewport,
    why_unseen,
)
from hulldown.reading.blender.strands import (
    hair_curves_mesh,
    make_hair_datablock,
    point_cloud_mesh,
    strand_systems,
    strands_mesh_and_materials,
)
from hulldown.reading.blender.surfaces.alpha_faces import CutoutReader
from hulldown.reading.blender.surfaces.object_inputs import instance_random_number, random_number_of_name
from hulldown.reading.blender.tidy import data_outliving_depsgraph, look_attribute_values
from hulldown.reading.pieces.asset_report import ObjectRow
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.roles import Evaluated, Link, Piece, Unseen
from hulldown.reading.pieces.wording import quote_names
from hulldown.reading.scenery.scenery_roles import is_water_name
from hulldown.reading.scenery.shape import level_share_and_area

MAX_COORDINATE_M = 1e8  # the Earth is 4e7 m around
REPAIR_REMEDY = "repair or delete it in Blender"
SIGN_OF_LIFE_S = 5.0
MIN_SHEET_WIDTH_M = 1.0  # narrower pieces aren't ground or water by their shape
EMPTY_REASONS = {"MESH": "has no faces", "CURVES": "has no hair", "POINTCLOUD": "has no points"}
NOT_SEEN = "its faces have no area"
STRANDS_KEY_PREFIX = "strands of "  # begins the key of a particle system's strands, in place of a material


def evaluate_scene(
    scene: Any, *, meters_from_file: Float[np.ndarray, "4 4"], duplicates: Mapping[str, Sequence[Duplicate]], texture_size: int
) -> Evaluated:
    """Return everything that `scene` draws."""
    cutouts = CutoutReader(texture_size)
    cutouts.bake_material_opacity([material for material in bpy.data.materials if material.users])
    reader = _Reader(meters_from_file, duplicates, cutouts)
    visit_render_depsgraph(scene, reader.read)
    reader.result.doubts += cutouts.doubts
    reader.result.doubts += [
        Doubt(DoubtKind.NOT_READ, f"{quote_names(names)}: {why}") for why, names in reader.following.items()
    ]
    add_hidden_object_rows(scene, reader.result, duplicates)
    return reader.result


@dataclass(eq=False)
class _Reader:
    meters: Float[np.ndarray, "4 4"]
    duplicates: Mapping[str, Sequence[Duplicate]]
    cutouts: CutoutReader
    result: Evaluated = field(default_factory=Evaluated)
    following: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))  # names by `camera_dependence_reason`
    index: dict[tuple[int, tuple[str, ...]], int] = field(default_factory=dict)
    box: list[np.ndarray] = field(default_factory=list)  # corners around each mesh
    used: list[np.ndarray] = field(default_factory=list)  # vertices of each mesh that a face uses
    unseen: dict[tuple[int, int], Unseen | None] = field(default_factory=dict)
    clear: dict[int, bool] = field(default_factory=dict)  # by mesh, whether all of its materials are transparent
    level: dict[tuple[int, bytes], tuple[float, float]] = field(default_factory=dict)  # by mesh and turn
    chains: dict[tuple[int, int], tuple[Link, ...]] = field(default_factory=dict)
    looks: dict[tuple[Any, ...], tuple[Any, ...]] = field(default_factory=dict)  # so that equal ones are one in memory

    def read(self, depsgraph: Any) -> None:
        self.depsgraph, self.poses = depsgraph, Poses(depsgraph)
        spoken = time.monotonic()
        for instance in depsgraph.object_instances:
            if time.monotonic() > spoken + SIGN_OF_LIFE_S:
                spoken = time.monotonic()
                print(f"{len(self.result.pieces)} things read", flush=True)
            kind = instance.object.type
            if instance.show_particles:
                self._add_strand_pieces(instance)
            if kind == "EMPTY":
                pose = self.poses.instance_pose(instance)
                _refuse_infinite_pose(instance.object.name, pose)
                self.result.markers.append(self._instance_and_parents(instance, pose, scattered=_is_scattered(instance)))
            elif not instance.show_self:
                self._add_left_out_rows(instance, "its instances are drawn, but not it itself")
            elif kind in SOLID_TYPES:
                self._add_drawn_piece(instance)
            elif kind in UNDRAWN_TYPES:
                self._add_left_out_rows(instance, UNDRAWN_TYPES[kind])
                if kind == "VOLUME":
                    text = f"the volume {instance.object.name!r} isn't rendered"
                    self.result.doubts.append(Doubt(DoubtKind.NOT_READ, text))
            elif kind not in SURFACE_TYPES:
                self._add_left_out_rows(instance, "type " + kind.lower().replace("_", " "))
            # Surfaces of curves, texts and the like come once more as the meshes they make; CURVES are hair.

    def _add_left_out_rows(self, instance: Any, why: str) -> None:
        if instance.object.name == OUR_CAMERA:
            return
        for name in (instance.object.name, *(duplicate.name for duplicate in self._instance_duplicates(instance))):
            self.result.left[ObjectRow(name, instance.object.type, "dropped", why)] += 1

    def _instance_duplicates(self, instance: Any) -> Sequence[Duplicate]:
        return () if instance.is_instance else self.duplicates.get(instance.object.original.name_full, ())

    def _add_drawn_piece(self, instance: Any) -> None:
        drawn = instance.object
        materials = tuple(s.material.name if s.material else "" for s in drawn.material_slots)
        key = (drawn.data.as_pointer(), materials)
        if key not in self.index:
            with _name_object_in_errors(drawn):
                mesh = self._drawn_mesh(drawn)
            if mesh is None:
                self._add_left_out_rows(instance, EMPTY_REASONS[drawn.type])
                return
            seen = faces_with_area(mesh)
            if not len(seen):
                self._add_left_out_rows(instance, NOT_SEEN)
                return
            self._add_geometry_doubts(drawn)
            self.clear[len(self.result.meshes)] = _has_only_clear_materials(drawn)
            slots = [slot for slot, name in enumerate(materials) if is_water_name(name)]
            if drawn.type == "MESH" and slots:
                wet = _slot_triangle_mask(drawn.data, slots, len(materials))[seen]
                if wet.any() and not wet.all():
                    self.result.wet[len(self.result.meshes)] = wet
            mesh = mesh if len(seen) == len(mesh.faces) else mesh.take_mesh_faces(seen)
            dressed = [slot.material for slot in drawn.material_slots]
            is_hair = drawn.type == "CURVES"
            self._add_mesh(
                key, mesh, make_hair_datablock(mesh, dressed) if is_hair else data_outliving_depsgraph(drawn, dressed)
            )
        self._add_piece_and_duplicates(instance, key, drawn.data.name, hair=drawn.type == "CURVES")

    def _drawn_mesh(self, drawn: Any) -> Mesh | None:
        if drawn.type == "CURVES":
            return hair_curves_mesh(drawn.data, drawn.name)
        return (
            point_cloud_mesh(drawn.data, drawn.name) if drawn.type == "POINTCLOUD" else _mesh_with_cutouts(drawn, self.cutouts)
        )

    def _add_strand_pieces(self, instance: Any) -> None:
        drawn = instance.object
        for system in strand_systems(drawn):
            key = (drawn.data.as_pointer(), (STRANDS_KEY_PREFIX, system.name))
            if key not in self.index:
                with _name_object_in_errors(drawn):
                    mesh, materials = strands_mesh_and_materials(drawn, system)
                if mesh is None:
                    continue
                self._add_mesh(key, mesh, make_hair_datablock(mesh, materials))
            self._add_piece_and_duplicates(instance, key, system.name, hair=True)

    def _add_mesh(self, key: tuple[int, tuple[str, ...]], mesh: Mesh, block: Any) -> None:
        self.index[key] = len(self.result.meshes)
        self.result.meshes.append(mesh)
        used = np.unique(mesh.faces)
        self.used.append(mesh.vertices if len(used) == len(mesh.vertices) else mesh.vertices[used])
        self.box.append(np.array(list(product(*mesh.bounds.T))))
        self.result.blocks.append(block)

    def _add_piece_and_duplicates(self, instance: Any, key: tuple[int, tuple[str, ...]], data: str, *, hair: bool) -> None:
        drawn, number = instance.object, self.index[key]
        mesh = self.result.meshes[number]
        pose = self.poses.instance_pose(instance)
        unseen = self._cached_why_unseen(drawn)
        look = (
            unseen in (None, Unseen.VOLUME),
            *look_attribute_values(drawn)[1:],
        )  # a collection may hide it from the camera, too
        scattered = _is_scattered(instance)
        bounds = self._bounds_in_meters(drawn.name, pose, self.box[number] if scattered or hair else self.used[number])
        level, filled = (0.0, 0.0) if hair else self._level_and_filled_share(number, pose, bounds)
        self.result.pieces.append(
            Piece(
                data=data,
                chain=self._instance_and_parents(instance, pose, scattered=scattered),
                mesh=number,
                pose=pose,
                bounds=bounds,
                faces=len(mesh.faces),
                scattered=scattered,
                anonymous=scattered and _lacks_own_object(instance),
                hair=hair,
                unseen=unseen,
                hidden=not instance.is_instance and is_hidden_in_viewport(drawn.original),
                carrier=instance.parent.name if instance.is_instance else "",
                materials=key[1] if not hair else (),
                clear=self.clear.get(number, False),
                level=level,
                filled=filled,
                look=self.looks.setdefault(look, look),
                random=instance_random_number(instance),
            )
        )
        for duplicate in () if hair else self._instance_duplicates(instance):
            self._add_duplicate_piece(duplicate, self.result.pieces[-1])

    def _add_duplicate_piece(self, duplicate: Duplicate, piece: Piece) -> None:
        bounds = self._bounds_in_meters(duplicate.name, duplicate.pose, self.used[piece.mesh])
        link = replace(piece.chain[0], name=duplicate.name, pose=duplicate.pose)
        level, filled = self._level_and_filled_share(piece.mesh, duplicate.pose, bounds)
        placed = replace(piece, data=duplicate.data, chain=(link,), pose=duplicate.pose, bounds=bounds)
        random = random_number_of_name(duplicate.name)
        self.result.pieces.append(replace(placed, level=level, filled=filled, random=random))

    def _bounds_in_meters(
        self, name: str, pose: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "2 3"]:
        """Return the bounds in meters of a mesh's points where it's drawn."""
        _refuse_infinite_pose(name, pose)
        with np.errstate(over="ignore", invalid="ignore"):
            seen = transform_points(self.meters @ pose, points)
        if not np.abs(seen).max() <= MAX_COORDINATE_M:
            problem = f"object {name!r} reaches {np.abs(seen).max():.3g} m from the origin"
            raise AssetError(f"{problem}, more than {MAX_COORDINATE_M:g} m", remedy="move, shrink or delete it in Blender")
        return np.stack([seen.min(axis=0), seen.max(axis=0)])

    def _level_and_filled_share(
        self, number: int, pose: Float[np.ndarray, "4 4"], bounds: Float[np.ndarray, "2 3"]
    ) -> tuple[float, float]:
        """Return the level share of a piece as wide as ground or water, and the share of its bounds that it fills."""
        length, width, height = bounds[1] - bounds[0]
        if min(length, width) < MIN_SHEET_WIDTH_M or height > max(length, width):
            return 0.0, 0.0
        key = number, pose[:3, :3].tobytes()
        if key not in self.level:
            self.level[key] = level_share_and_area(self.result.meshes[number], self.meters @ pose)
        share, area = self.level[key]
        return share, area / (length * width)

    def _add_geometry_doubts(self, drawn: Any) -> None:
        """Add doubts about geometry that only Cycles makes, or that depends on the camera, which can't be read."""
        name = drawn.original.name
        if why := camera_dependence_reason(drawn.original):
            self.following[why].append(name)
            self.result.varying.add(name)
        texts = [
            f"{name!r} is displaced by its material {material.name!r}, unlike its mesh"
            for material in (slot.material for slot in drawn.material_slots)
            if material and material.displacement_method != "BUMP" and is_displaced_material(material)
        ]
        rendered = [modifier for modifier in drawn.modifiers if modifier.type == "SUBSURF" and modifier.show_render]
        if any(getattr(modifier, "use_adaptive_subdivision", False) for modifier in rendered):
            texts.append(f"{name!r} is subdivided adaptively, which is left out")
        self.result.doubts += [Doubt(DoubtKind.NOT_READ, text) for text in texts]
        self.result.varying.update([name] if texts else [])

    def _cached_why_unseen(self, drawn: Any) -> Unseen | None:
        key = (drawn.original.as_pointer(), drawn.data.as_pointer())
        if key not in self.unseen:
            self.unseen[key] = why_unseen(drawn, self.depsgraph)
        return self.unseen[key]

    def _instance_and_parents(self, instance: Any, pose: Float[np.ndarray, "4 4"], *, scattered: bool) -> tuple[Link, ...]:
        """Return the drawn object and its parents, in the poses where they're drawn, or their own if it's scattered."""
        if not instance.is_instance:
            return self.poses.chain(instance.object)
        if _lacks_own_object(instance):
            return self.poses.chain(instance.parent)
        inner = instance.instance_object
        if not scattered:
            own = self.poses.pose(inner)
            moved = pose @ np.linalg.inv(own) if abs(np.linalg.det(own)) > 1e-30 else np.eye(4)
            return (*self.poses.chain(inner, moved), *self.poses.chain(instance.parent))
        key = (inner.original.as_pointer(), instance.parent.original.as_pointer())
        if key not in self.chains:
            self.chains[key] = (*self.poses.chain(inner), *self.poses.chain(instance.parent))
        return self.chains[key]


def _is_scattered(instance: Any) -> bool:
    if not instance.is_instance or _is_surface_of_parent(instance):
        return False
    return bool(instance.parent.instance_type != "COLLECTION")


def _lacks_own_object(instance: Any) -> bool:
    """Return whether an instance has no object of its own: a curve's surface, or a mesh that geometry nodes made."""
    inner = instance.instance_object
    return inner is None or inner.original == instance.parent.original


def _is_surface_of_parent(instance: Any) -> bool:
    if not _lacks_own_object(instance) or instance.parent.type == "MESH":
        return False
    return bool(np.array_equal(np.array(instance.matrix_world), np.array(instance.parent.matrix_world)))


def _refuse_infinite_pose(name: str, pose: Float[np.ndarray, "4 4"]) -> None:
    if not np.isfinite(pose).all():
        raise AssetError(f"object {name!r} has a position that isn't finite", remedy=REPAIR_REMEDY)


@contextmanager
def _name_object_in_errors(drawn: Any) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise AssetError(f"object {drawn.name!r}: {error}", remedy=REPAIR_REMEDY) from None


def _has_only_clear_materials(drawn: Any) -> bool:
    dressed = [slot.material for slot in drawn.material_slots]
    if drawn.type == "MESH" and len(dressed) > 1:
        worn = read_property(drawn.data.polygons, "material_index", np.int32)
        dressed = [dressed[i] for i in np.unique(np.minimum(worn, len(dressed) - 1)).tolist()]
    return any(dressed) and all(material is not None and is_clear_material(material) for material in dressed)


def _mesh_with_cutouts(drawn: Any, cutouts: CutoutReader) -> Mesh | None:
    data = drawn.data
    data.calc_loop_triangles()
    if not len(data.loop_triangles):
        return None
    vertices = read_property(data.vertices, "co", np.float32, 3)
    faces = read_property(data.loop_triangles, "vertices", np.int32, 3)
    holes = cutouts.mesh_cutouts(data, [slot.material for slot in drawn.material_slots])
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), drawn.name, holes)


def _slot_triangle_mask(data: Any, slots: Sequence[int], count: int) -> Bool[np.ndarray, " f"]:
    return np.isin(np.minimum(read_property(data.loop_triangles, "material_index", np.int32), count - 1), slots)
