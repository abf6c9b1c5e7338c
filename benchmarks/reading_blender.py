"""Write hard vehicle files with Blender and read them back, one after the other in this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
from mathutils import Matrix

from hulldown.benchmarks.reading_cases import Case, Truth, build, cases, file_from_vehicle, world_from_written
from hulldown.benchmarks.reading_things import LITTER_PART, PARTS, Model, Thing, node
from hulldown.demo.vehicles import VEHICLE_LOOKS, build_vehicle_file
from hulldown.geometry.transforms import transform_points
from hulldown.reading.blender.depsgraph import evaluate_scene
from hulldown.reading.blender.importers import Opened, open_asset_in_blender
from hulldown.reading.build import build_vehicle
from hulldown.reading.pieces.options import DEFAULT_TEXTURE_SIZE, Options
from hulldown.reading.pieces.roles import Evaluated
from hulldown.reading.vehicle.stance import meters_from_file, turn_pieces_upright


def corpus(each: Sequence[int]) -> Iterator[tuple[Case, Truth, Opened, Evaluated]]:
    """Each case with `each` files of every demo vehicle and group: its truth, what the importer says, what is drawn."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in VEHICLE_LOOKS:
            build_vehicle_file(name, folder, rng=np.random.default_rng(0))
        bases = {file.stem: _base(file) for file in sorted(folder.glob("*.blend"))}
        for case in cases(list(bases), each=each):
            model, path = build(bases[case.vehicle], case), folder / f"case{case.suffix}"
            _write(model, case, path)
            opened, drawn = _read(path, {".glb": "gltf"}.get(path.suffix, path.suffix[1:]))
            points = np.concatenate([t.vertices for t in model.things if t.part != LITTER_PART])
            world_from_vehicle = world_from_written(case) @ file_from_vehicle(case)
            part_of = {t.name: t.part for t in model.things}
            yield case, Truth(part_of, model.pivots, world_from_vehicle, np.ptp(points, axis=0)), opened, drawn


def _read(path: Path, kind: str) -> tuple[Opened, Evaluated]:
    opened = open_asset_in_blender(path, kind, Options())
    meters = meters_from_file(opened.unit, opened.up)
    given = {"meters_from_file": meters, "duplicates": opened.duplicates}
    return opened, evaluate_scene(bpy.context.scene, **given, texture_size=DEFAULT_TEXTURE_SIZE)


def _base(path: Path) -> Model:
    """A demo vehicle as it is rendered: its objects with their parts, empties of parts included, litter left out."""
    opened, drawn = _read(path, "blend")
    meters = meters_from_file(opened.unit, "z")
    upright = turn_pieces_upright(drawn, unit=opened.unit, stated_up="z", up="z")
    built = build_vehicle(path.stem, upright, Options(forward="+x"))
    names = built.shape.part_names
    from_vehicle = meters @ np.linalg.inv(built.shape.vehicle_from_file)
    pivot = dict(zip(names, transform_points(from_vehicle, built.shape.part_pivot), strict=True))
    things: list[Thing] = []
    links = [link for chain in (*(p.chain for p in drawn.pieces), *drawn.markers) for link in chain]
    for row in built.parts:  # what carries the part: an empty, or the turret's own mesh
        carrier = next(link for link in links if link.name == row.why.split("'")[1])
        origin = transform_points(meters, carrier.pose[:3, 3][None])[0]
        things.append(node(carrier.name, PARTS.index(row.name), origin, len(things) - 1))
    place = {thing.name: i for i, thing in enumerate(things)}
    for piece, part in zip(drawn.pieces, built.piece_part, strict=True):
        if part < 0:
            continue
        mesh, index = drawn.meshes[piece.mesh], PARTS.index(names[part])
        vertices = transform_points(meters @ piece.pose, mesh.vertices)
        if (i := place.get(piece.name)) is not None:
            things[i] = replace(things[i], vertices=vertices, faces=mesh.faces)
            continue
        parent = next((i for i, t in enumerate(things) if t.part == index and not len(t.faces)), -1) if index else -1
        parent = next((place[link.name] for link in piece.chain[1:] if link.name in place), parent)
        things.append(Thing(piece.name, index, vertices, mesh.faces, np.zeros(3), parent))
    return Model(tuple(things), (pivot.get("turret"), pivot.get("gun")))


def _write(model: Model, case: Case, path: Path) -> None:
    """Write the objects, turned as the case is: all of their vertices and origins, or what they hang from."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pose, root_turned = file_from_vehicle(case), case.layout == "root turned"
    baked = np.eye(4) if root_turned else pose
    origins = transform_points(baked, np.array([thing.origin for thing in model.things]))
    objects = []
    for thing, origin in zip(model.things, origins, strict=True):
        data = None
        # Origins at zero mean the file's zero, with the turn applied to the vertices.
        if len(thing.faces):
            data = bpy.data.meshes.new(thing.name)
            data.from_pydata((transform_points(baked, thing.vertices) - origin).tolist(), [], thing.faces.tolist())
        objects.append(bpy.data.objects.new(thing.name, data))
        bpy.context.scene.collection.objects.link(objects[-1])
    for thing, made, origin in zip(model.things, objects, origins, strict=True):
        if thing.parent >= 0:
            made.parent, made.location = objects[thing.parent], (origin - origins[thing.parent]).tolist()
        elif root_turned:
            made.matrix_basis = Matrix(pose.tolist()) @ Matrix.Translation(origin.tolist())
        else:
            made.location = origin.tolist()
    bpy.context.view_layer.update()
    for thing, made in zip(model.things, objects, strict=True):
        if thing.hidden:
            made.hide_set(True)
    if path.suffix == ".blend":
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    elif path.suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path), export_yup=case.up != "z glb", export_format="GLB")
    elif path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path))
    else:
        up, ahead = ("Y", "NEGATIVE_Z") if case.up == "y obj" else ("Z", "Y")
        bpy.ops.wm.obj_export(filepath=str(path), up_axis=up, forward_axis=ahead, export_materials=False)
