"""The process that reads an asset file with Blender, which may crash or keep data: a job as JSON in, files out."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy
import msgspec
import numpy as np

from hulldown.assets.bundle import save_asset
from hulldown.base.errors import AssetError, HulldownError
from hulldown.base.files import atomic_writer
from hulldown.reading.blender.depsgraph import evaluate_scene
from hulldown.reading.blender.file_pictures import lost_geometry_doubts
from hulldown.reading.blender.geotiff_object import TERRAIN_NAME
from hulldown.reading.blender.hdri_picture import run_hdri_job
from hulldown.reading.blender.importers import open_asset_in_blender
from hulldown.reading.blender.surfaces.material_rows import material_rows
from hulldown.reading.blender.surfaces.object_inputs import lost_input_doubts
from hulldown.reading.blender.surfaces.textures import missing_or_unreadable_files, pictures_near_asset, referenced_file_paths
from hulldown.reading.blender.tidy import write_tidy_scenery, write_tidy_vehicle
from hulldown.reading.blender.vehicle_picture import render_vehicle_picture
from hulldown.reading.build import build_scenery_and_wet_names, build_vehicle
from hulldown.reading.doubts import scenery_doubts, vehicle_doubts
from hulldown.reading.pieces.asset_report import By, FileReport, Missing, ObjectRow, merge_copy_rows, xyz_tuple
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.roles import Evaluated, Piece, PieceRole
from hulldown.reading.reader_process import ANSWER_NAME, DIFFERENCES_NAME, PICTURE_NAME, FoundAsset, Job, Refused
from hulldown.reading.scenery.parked import parked_vehicles
from hulldown.reading.scenery.scenery_roles import scenery_roles
from hulldown.reading.scenery.top_view import top_view_and_doubts
from hulldown.reading.vehicle.seen_colors import color_doubts, save_picture_on_gray
from hulldown.reading.vehicle.stance import Upright, meters_from_file, turn_pieces_upright
from hulldown.reading.vehicle_or_scenery import likely_kind, refuse_or_doubt_kind

NO_MATERIAL_DOUBT = "nothing in it has a material, so all of it is rendered plain white (an .obj needs its .mtl beside it)"


def main(job_path: str) -> None:
    """Do the job in the JSON file `job_path` and write the answer."""
    job = msgspec.convert(json.loads(Path(job_path).read_text(encoding="utf-8")), Job)
    try:
        answer = msgspec.to_builtins(run_hdri_job(job) if job.format == "hdri" else run_asset_job(job))
    except HulldownError as error:
        path = str(error.path or job.path)
        answer = {"error": Refused(problem=error.problem, path=path, remedy=error.remedy)}
    with atomic_writer(job.file(ANSWER_NAME)) as file:
        file.write(json.dumps(answer).encode())


def run_asset_job(job: Job) -> FoundAsset:
    """Read the file, and write bundle and tidy twin."""
    path, options = Path(job.path).resolve(), job.options
    opened = open_asset_in_blender(path, job.format, options)
    unit, up = options.scale or opened.unit, options.up or opened.up
    if opened.terrain:
        unit = opened.unit  # its scale is that of the elevations alone
    files = sorted({*referenced_file_paths(), *opened.files})
    drawn = evaluate_scene(
        bpy.context.scene,
        meters_from_file=meters_from_file(unit, up),
        duplicates=opened.duplicates,
        texture_size=options.texture_size,
    )
    if opened.terrain:
        (ground,) = (piece.mesh for piece in drawn.pieces if piece.name == TERRAIN_NAME)
        drawn.meshes[ground] = drawn.meshes[ground].with_vertices(opened.terrain.mesh.vertices)  # Blender has float32
    _refuse_all_hidden(drawn, job.kind)
    if not any(material for block in drawn.blocks for material in block.materials):
        drawn.doubts.append(Doubt(DoubtKind.NO_MATERIAL, NO_MATERIAL_DOUBT))
    upright, judged = None, drawn.pieces
    kind = job.kind or likely_kind(judged, options)
    if kind == "vehicle":  # of a scenery, every solid would be looked at
        upright = turn_pieces_upright(drawn, unit=unit, stated_up=opened.up, up=options.up)
        judged = upright.drawn.pieces
        kind = job.kind or likely_kind(judged, options)
    odd = refuse_or_doubt_kind(job.kind, judged, options) if job.kind else None
    if not opened.terrain:
        drawn.doubts += lost_geometry_doubts(
            drawn,
            up=meters_from_file(1.0, up)[2, :3],
            kind=kind,
            absent={duplicate.name for same in opened.duplicates.values() for duplicate in same},
            drop=options.drop,
            picture=job.file(DIFFERENCES_NAME),
        )
    if kind == "vehicle":
        assert upright is not None, "a vehicle is stood upright first"
        report = _save_and_report_vehicle(job, upright, unit=unit)
    else:
        report = _save_and_report_scenery(job, drawn, unit=unit, up=up, crs=opened.terrain.crs if opened.terrain else "")
    doubts = (*([odd] if odd else []), *report.doubts, *opened.doubts, *drawn.doubts)
    return FoundAsset(replace(report, doubts=doubts, written_by=opened.written_by), tuple(files))


def _save_and_report_vehicle(job: Job, upright: Upright, *, unit: float) -> FileReport:
    vehicle = build_vehicle(Path(job.path).stem, upright, job.options)
    drawn, shape = upright.drawn, vehicle.shape
    save_asset(job.file("bundle.npz"), shape)
    lost = lost_input_doubts(_used_materials(drawn, vehicle.roles), moved=True)
    twin = write_tidy_vehicle(job.file("tidy.blend"), drawn, vehicle.piece_part, shape.vehicle_from_file)
    picture = render_vehicle_picture(twin, shape.surface[0].bounds)
    save_picture_on_gray(picture, job.file(PICTURE_NAME))
    report = FileReport(
        kind="vehicle",
        path=job.path,
        size=xyz_tuple(shape.size_xyz),
        triangles=len(shape.mesh.faces),
        unit=unit,
        up=upright.up.value,
        rows=_object_rows(drawn, vehicle.roles),
        parts=vehicle.parts,
        missing=_missing_files_of_pieces(drawn, vehicle.roles),
        axes=vehicle.axes,
        materials=material_rows(drawn.blocks, drawn.pieces, vehicle.piece_part),
        things=vehicle.things,
    )
    if len(report.things) > 1:  # doubts about all of them together are of no use
        return replace(report, doubts=tuple(d for d in vehicle.doubts if d.kind == DoubtKind.SEVERAL))
    beside = partial(pictures_near_asset, Path(job.path).resolve())
    blocks = [drawn.blocks[piece.mesh] for piece in _used_pieces(drawn, vehicle.roles)]
    mapped = any(getattr(block, "uv_layers", None) for block in blocks)
    looks = (*color_doubts(picture, report, beside=beside, mapped=mapped), *lost)
    return replace(report, doubts=(*vehicle.doubts, *vehicle_doubts(report, job.options), *looks))


def _save_and_report_scenery(job: Job, drawn: Evaluated, *, unit: float, up: str, crs: str) -> FileReport:
    roles = scenery_roles(drawn.pieces, job.options)
    scenery, wet = build_scenery_and_wet_names(
        Path(job.path).stem, drawn, roles, meters=meters_from_file(unit, up), options=job.options
    )
    save_asset(job.file("bundle.npz"), replace(scenery, crs=crs))
    moved = not np.allclose(scenery.scenery_from_file, np.eye(4), rtol=0.0, atol=1e-12)
    lost = lost_input_doubts(_used_materials(drawn, roles), moved=moved)
    write_tidy_scenery(job.file("tidy.blend"), drawn, roles, scenery.scenery_from_file)
    used = [(p, role.use) for p, role in zip(drawn.pieces, roles, strict=True)]
    solid = [p for p, use in used if use in ("ground", "water", "obstacle")]
    extent = [p.bounds for p, use in used if use == "ground"] or [p.bounds for p in solid]
    view, sunken = top_view_and_doubts(scenery)
    report = FileReport(
        kind="scenery",
        path=job.path,
        size=xyz_tuple(np.max(extent, axis=0)[1] - np.min(extent, axis=0)[0]),
        triangles=sum(piece.faces for piece in solid),
        unit=unit,
        up=up,
        origin=xyz_tuple(scenery.origin),
        rows=_object_rows(drawn, roles),
        missing=_missing_files_of_pieces(drawn, roles),
        top_view=view,
    )
    parked = parked_vehicles(drawn, roles, meters_from_file(unit, up))
    doubts = scenery_doubts(report, drawn.pieces, roles, job.options, wet=wet, parked=parked)
    return replace(report, doubts=(*doubts, *sunken, *lost))


def _refuse_all_hidden(drawn: Evaluated, kind: str | None) -> None:
    """Refuse a file without anything to draw by the reason why all is hidden, which no pattern can change."""
    hidden = [left for left in drawn.left if left.by is By.HIDDEN]
    if drawn.pieces or not hidden:
        return
    nothing = "it contains nothing that is rendered"
    if kind == "scenery":
        nothing = "nothing in it is rendered as ground or obstacle"
    more = f" (and {len(hidden) - 1} more)" if len(hidden) > 1 else ""
    raise AssetError(
        f"{nothing}: {hidden[0].name!r} is {hidden[0].why}{more}",
        remedy="switch on the camera icon beside it in Blender's outliner and save",
    )


def _used_pieces(drawn: Evaluated, roles: Sequence[PieceRole]) -> list[Piece]:
    return [p for p, role in zip(drawn.pieces, roles, strict=True) if role.use not in ("dropped", "removed")]


def _used_materials(drawn: Evaluated, roles: Sequence[PieceRole]) -> list[bpy.types.Material]:
    blocks = [drawn.blocks[number] for number in dict.fromkeys(piece.mesh for piece in _used_pieces(drawn, roles))]
    return list(dict.fromkeys(material for block in blocks for material in block.materials if material is not None))


def _missing_files_of_pieces(drawn: Evaluated, roles: Sequence[PieceRole]) -> tuple[Missing, ...]:
    return missing_or_unreadable_files({link.name for piece in _used_pieces(drawn, roles) for link in piece.chain})


def _object_rows(drawn: Evaluated, roles: Sequence[PieceRole]) -> tuple[ObjectRow, ...]:
    groups: dict[tuple[str, PieceRole], list[Piece]] = defaultdict(list)
    for piece, role in zip(drawn.pieces, roles, strict=True):
        groups[piece.name, role].append(piece)
    rows = []
    for (name, role), pieces in groups.items():
        first, size = pieces[0], xyz_tuple(np.max([p.size for p in pieces], axis=0))
        rows.append(ObjectRow(name, first.chain[0].kind, role.use, role.why, len(pieces), first.faces, size, role.by))
    rows += [replace(left, count=count) for left, count in drawn.left.items()]
    return merge_copy_rows(rows)


if __name__ == "__main__":
    for each in sys.argv[1:]:
        main(each)
