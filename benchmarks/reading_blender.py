"""Writes hard vehicle files with Blender and reads them back.

`python -P reading_blender.py DEMO FOLDER TUNED SECOND THIRD`, where the last three are how many files of each vehicle.
All in one process, one after the other; what reading draws of each is pickled, so that it can be judged again and again
without Blender.
"""

import pickle
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import bpy
import numpy as np
from mathutils import Matrix

from hulldown.benchmarks.reading_cases import Case, Truth, build, cases, file_from_vehicle, world_from_written
from hulldown.benchmarks.reading_things import LITTER, Model, Thing
from hulldown.geometry.transforms import apply
from hulldown.reading.blender.evaluate import evaluate
from hulldown.reading.blender.importers import Opened, open_file
from hulldown.reading.blender.tidy import Keeper
from hulldown.reading.build import build_vehicle
from hulldown.reading.options import TEXTURE_SIZE, Options
from hulldown.reading.roles import Evaluated
from hulldown.reading.vehicle.stance import meters_from_file, stand_upright


def main() -> None:
    demo, folder = Path(sys.argv[1]), Path(sys.argv[2])
    each = [int(count) for count in sys.argv[3:6]]
    files = sorted(demo.glob("*.blend"))
    bases = {file.stem: _base(file) for file in files}
    for number, case in enumerate(cases(list(bases), each=each)):
        model = build(bases[case.vehicle], case)
        path = folder / f"{number:04d}{case.suffix}"
        world_from_vehicle = world_from_written(case) @ file_from_vehicle(case)
        _write(model, case, path)
        opened = open_file(path, {".glb": "gltf"}.get(path.suffix, path.suffix[1:]), Options())
        meters = meters_from_file(opened.unit, opened.up)
        drawn = _drawn(opened, meters)
        points = np.concatenate([t.vertices for t in model.things if t.part != LITTER])
        truth = Truth({t.name: t.part for t in model.things}, model.pivots, world_from_vehicle, np.ptp(points, axis=0))
        (folder / f"{number:04d}.pickle").write_bytes(pickle.dumps((case, truth, opened, drawn)))
        if path.suffix != ".blend" or number % 20:
            path.unlink()  # a few are left to be looked at


def _drawn(opened: Opened, meters: np.ndarray) -> Evaluated:
    given = {"meters_from_file": meters, "duplicates": opened.duplicates}
    return evaluate(bpy.context.scene, **given, texture_size=TEXTURE_SIZE, keeper=Keeper())


def _base(path: Path) -> Model:
    """A demo vehicle as it is rendered: its objects with their parts, empties of parts included, litter left out."""
    opened = open_file(path, "blend", Options())
    meters = meters_from_file(opened.unit, "z")
    drawn = _drawn(opened, meters)
    upright = stand_upright(drawn, unit=opened.unit, stated_up="z", up="z")
    built = build_vehicle(path.stem, upright, Options(forward="+x"))
    names = built.shape.part_names
    shift = np.linalg.inv(built.shape.vehicle_from_file @ np.linalg.inv(meters))
    pivots = [
        apply(shift, built.shape.part_pivot[names.index(p)][None])[0] if p in names else None for p in ("turret", "gun")
    ]
    things: list[Thing] = []
    node: dict[str, int] = {}  # empties and meshes that carry a part, by their name
    part_at = {p: i for i, p in enumerate(("hull", "turret", "gun"))}
    for link, part in _carriers(drawn, built, names):
        node[link.name] = len(things)
        origin = apply(meters, link.pose[:3, 3][None])[0]
        things.append(Thing(link.name, part_at[part], np.empty((0, 3)), np.empty((0, 3), int), origin))
    if len(things) == 2:
        things[1] = Thing(**{f: getattr(things[1], f) for f in Thing.__slots__} | {"parent": 0})
    for piece, part in zip(drawn.pieces, built.piece_part, strict=True):
        if part < 0:
            continue
        mesh, index = drawn.meshes[piece.mesh], part_at[names[part]]
        parent = next((i for i, t in enumerate(things) if t.part == index and not len(t.faces)), -1) if index else -1
        vertices = apply(meters @ piece.pose, mesh.vertices)
        if piece.name in node:  # the turret that is itself a mesh
            i = node[piece.name]
            things[i] = Thing(piece.name, index, vertices, mesh.faces, things[i].origin, things[i].parent)
            continue
        parent = next((node[link.name] for link in piece.chain[1:] if link.name in node), parent)
        things.append(Thing(piece.name, index, vertices, mesh.faces, np.zeros(3), parent))
    return Model(tuple(things), (pivots[0], pivots[1]))


def _carriers(drawn, built, names):
    """The object whose origin is the pivot of turret, and of gun."""
    found = []
    for row in built.parts:
        name = row.why.split("'")[1]
        links = [k for p in drawn.pieces for k in p.chain] + [k for m in drawn.markers for k in m]
        found.append((next(k for k in links if k.name == name), row.name))
    return found


def _write(model: Model, case: Case, path: Path) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    pose = file_from_vehicle(case)
    baked = case.layout != "root turned"
    root = Matrix(pose.tolist())
    objects = []
    for thing in model.things:
        data = None
        # Origins at zero mean the file's zero, with the turn applied to the vertices.
        if len(thing.faces):
            data = bpy.data.meshes.new(thing.name)
            local = (
                (apply(pose, thing.vertices) - apply(pose, thing.origin[None]))
                if baked
                else (thing.vertices - thing.origin)
            )
            data.from_pydata(local.tolist(), [], thing.faces.tolist())
        made = bpy.data.objects.new(thing.name, data)
        scene.collection.objects.link(made)
        objects.append(made)
    for thing, made in zip(model.things, objects, strict=True):
        if thing.parent >= 0:
            made.parent = objects[thing.parent]
    bpy.context.view_layer.update()
    for thing, made in zip(model.things, objects, strict=True):
        origin = apply(pose, thing.origin[None])[0] if baked else thing.origin
        inner = model.things[thing.parent].origin if thing.parent >= 0 else np.zeros(3)
        if baked and thing.parent >= 0:
            inner = apply(pose, inner[None])[0]
        made.location = (origin - inner).tolist()
    if not baked:
        for thing, made in zip(model.things, objects, strict=True):
            if thing.parent < 0:
                made.matrix_basis = (
                    root @ made.matrix_basis.copy() if False else root @ Matrix.Translation(thing.origin.tolist())
                )
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


if __name__ == "__main__":
    main()
