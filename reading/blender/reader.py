"""The process that reads one asset file with Blender: a job as JSON in, bundle, tidy twin and report as files out.

Run as ``python -m hulldown.reading.blender.reader JOB.json...``. Blender may crash on a damaged file, keeps what it
once loaded, and talks on stdout; so every file gets a process of its own and answers come in files.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.assets.bundle import save_scenery, save_vehicle
from hulldown.geometry.errors import AssetError, HulldownError
from hulldown.geometry.files import replacing
from hulldown.reading.blender.evaluate import HIDDEN, evaluate
from hulldown.reading.blender.importers import open_file
from hulldown.reading.blender.pictures import read_picture
from hulldown.reading.blender.surfaces.materials import material_rows
from hulldown.reading.blender.surfaces.textures import missing_files, used_files
from hulldown.reading.blender.tidy import Keeper, write_scenery, write_vehicle
from hulldown.reading.build import build_scenery, build_vehicle
from hulldown.reading.doubts import scenery_doubts, vehicle_doubts
from hulldown.reading.evaluated import Evaluated
from hulldown.reading.kinds import likely_kind, refuse_wrong_kind
from hulldown.reading.options import Options
from hulldown.reading.report import FileReport, Missing, Row, gathered
from hulldown.reading.roles import Piece
from hulldown.reading.scenery.scenery_roles import scenery_roles
from hulldown.reading.vehicle.stance import metres_from_file, stand_upright

BARE = "nothing in it has a material, so all of it is rendered plain white (an .obj needs its .mtl beside it)"


def main(job_path: str) -> None:
    """Do the job in the JSON file `job_path` and write the answer to the path that it names."""
    job = json.loads(Path(job_path).read_text(encoding="utf-8"))
    try:
        answer = read_picture(job) if job["format"] == "hdri" else read(job)
    except HulldownError as error:
        answer = {"error": {"problem": error.problem, "remedy": error.remedy}}
    with replacing(Path(job["answer"])) as file:
        file.write(json.dumps(answer).encode())


def read(job: Mapping[str, Any]) -> dict[str, Any]:
    """Read the file, write bundle and tidy twin, and return report and dependencies."""
    path = Path(job["path"])
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in job["options"].items()}
    options = Options(**given)
    opened = open_file(path, job["format"])
    unit, up = options.scale or opened.unit, options.up or opened.up
    metres = metres_from_file(unit, up)
    files = used_files()
    keeper = Keeper()
    drawn = evaluate(
        bpy.context.scene,
        metres_from_file=metres,
        duplicates=opened.duplicates,
        texture_size=options.texture_size,
        keep_mesh=keeper.keep_mesh,
        keep_look=keeper.keep_look,
    )
    _refuse_nothing(drawn, job["kind"])
    if not drawn.dressed:
        drawn.doubts.append(BARE)
    common: dict[str, Any] = {"path": str(path), "unit": unit, "up": up, "written_by": opened.written_by}
    upright = stand_upright(drawn, unit=unit, said=opened.up, up=options.up) if job["kind"] != "scenery" else None
    pieces = upright.pieces if upright else drawn.pieces
    roles = scenery_roles(pieces, options)
    kind = job["kind"] or likely_kind(pieces, options, roles=roles)
    odd = refuse_wrong_kind(kind, pieces, options, roles=roles) if job["kind"] else ""
    tidy = Path(job["tidy"])
    if kind == "vehicle":
        assert upright is not None, "a vehicle is stood upright first"
        drawn.pieces, common["up"] = upright.pieces, upright.up.axis
        vehicle = build_vehicle(job["name"], drawn.meshes, upright, drawn.markers, options=options)
        save_vehicle(job["bundle"], vehicle.shape)
        names = vehicle.shape.part_names
        uses = [names[part] if part >= 0 else "dropped" for part in vehicle.piece_part]
        size = _xyz(vehicle.shape.size_xyz)
        rows, missing = _rows(drawn, uses, [r.why for r in vehicle.roles]), _missing(drawn, uses)
        report = FileReport(
            kind=kind,
            size=size,
            triangles=len(vehicle.shape.mesh.faces),
            rows=rows,
            parts=vehicle.parts,
            axes=vehicle.axes,
            materials=material_rows(keeper.meshes, drawn.pieces, vehicle.piece_part),
            missing=missing,
            doubts=(
                *vehicle.doubts,
                *vehicle_doubts(size, rows, missing, unit=unit, options=options),
                *opened.doubts,
                *drawn.doubts,
            ),
            **common,
        )
        write_vehicle(tidy, keeper, drawn.pieces, vehicle.piece_part, vehicle.shape.vehicle_from_file)
    else:
        if pieces is not drawn.pieces:  # stood upright, as for a vehicle
            roles = scenery_roles(drawn.pieces, options)
        scenery = build_scenery(job["name"], drawn, roles, metres=metres, options=options)
        save_scenery(job["bundle"], scenery.scenery)
        uses = [r.use for r in roles]
        solid = [(p, use) for p, use in zip(drawn.pieces, uses, strict=True) if use in ("ground", "water", "obstacle")]
        extent = [p.bounds for p, use in solid if use == "ground"] or [p.bounds for p, _ in solid]
        size = _xyz(np.max(extent, axis=0)[1] - np.min(extent, axis=0)[0])
        rows, missing = _rows(drawn, uses, [r.why for r in roles]), _missing(drawn, uses)
        report = FileReport(
            kind=kind,
            size=size,
            triangles=sum(p.faces for p, _ in solid),
            rows=rows,
            origin=_xyz(scenery.scenery.origin),
            missing=missing,
            doubts=(
                *([odd] if odd else []),
                *scenery_doubts(size, drawn.pieces, roles, missing, wet=scenery.wet_names, unit=unit, options=options),
                *opened.doubts,
                *drawn.doubts,
            ),
            **common,
        )
        write_scenery(tidy, keeper, drawn.pieces, uses, scenery.scenery.scenery_from_file)
    return {"report": report.to_json(), "files": files}


def _refuse_nothing(drawn: Evaluated, kind: str | None) -> None:
    """Say what hides everything; that is no matter of names, so no pattern in the config helps."""
    hidden = [left for left in drawn.left if left.why.startswith(HIDDEN)]
    if drawn.pieces or not hidden:
        return
    nothing = "no vehicle is left after clean-up; in it is nothing that is rendered"
    if kind == "scenery":
        nothing = "nothing in it is rendered as ground or obstacle"
    more = f" (and {len(hidden) - 1} more)" if len(hidden) > 1 else ""
    raise AssetError(
        f"{nothing}: {hidden[0].name!r} is {hidden[0].why}{more}",
        remedy="switch on the camera icon beside it in Blender's outliner and save",
    )


def _missing(drawn: Evaluated, uses: Sequence[str]) -> tuple[Missing, ...]:
    """What is missing of that which is used."""
    used = zip(drawn.pieces, uses, strict=True)
    return missing_files(
        {link.name for piece, use in used if use not in ("dropped", "removed") for link in piece.chain}
    )


def _rows(drawn: Evaluated, uses: Sequence[str], why: Sequence[str]) -> tuple[Row, ...]:
    """One row for all pieces of one object that are used alike, then what is no piece."""
    groups: dict[tuple[str, str, str], list[Piece]] = defaultdict(list)
    for piece, use, reason in zip(drawn.pieces, uses, why, strict=True):
        groups[piece.name, use, reason].append(piece)
    rows = [
        Row(
            name,
            pieces[0].chain[0].kind,
            use,
            reason,
            len(pieces),
            pieces[0].faces,
            _xyz(np.max([p.bounds[1] - p.bounds[0] for p in pieces], axis=0)),
        )
        for (name, use, reason), pieces in groups.items()
    ]
    rows += [Row(left.name, left.kind, "dropped", left.why, count) for left, count in drawn.left.items()]
    return gathered(rows)


def _xyz(vector: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


if __name__ == "__main__":
    for each in sys.argv[1:]:
        main(each)
