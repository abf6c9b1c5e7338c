"""A vehicle file made ready for rendering: real meshes, each knowing its part, and nothing else of the file.

A person's file has parents, modifiers, constraints, key frames and drivers. Once evaluated, none of that is needed:
what is left are meshes with materials in the vehicle's frame, which the plan's matrices then move (the paper merges
to one object for the same reason, section 2.1.3). Runs where bpy is a module.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import numpy as np

from geometry.transforms import apply
from render.cleanup import vehicle_roles
from render.evaluate import evaluate
from render.parts import find_parts
from render.scene import PART, REST


def prepare_vehicle(path: str, vehicle_from_file: np.ndarray, options: Mapping[str, Any], output: str) -> None:
    """Write the vehicle in the file `path` as a .blend with one collection of posed meshes.

    Parameters
    ----------
    path
        The vehicle's file.
    vehicle_from_file
        (4, 4), see `assets.vehicle.VehicleShape`.
    options
        The vehicle's entry in the config.
    output
        Where to write.
    """
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    meshes: list[Any] = []

    def keep(depsgraph: Any, drawn: Any) -> None:
        meshes.append(bpy.data.meshes.new_from_object(drawn, preserve_all_data_layers=True, depsgraph=depsgraph))

    found = evaluate(bpy.context.scene, metres_from_file=np.eye(4), keep_mesh=keep)
    roles = vehicle_roles(found.pieces, keep=options["keep"], drop=options["drop"])
    pieces = [piece for piece, role in zip(found.pieces, roles, strict=True) if role.use == "vehicle"]
    points = [apply(vehicle_from_file @ piece.pose, found.meshes[piece.mesh].vertices) for piece in pieces]
    parts = find_parts(
        pieces,
        points,
        found.markers,
        vehicle_from_file=vehicle_from_file,
        turret=options["turret"],
        gun=options["gun"],
    )
    collection = bpy.data.collections.new("hulldown vehicle")
    for piece, part in zip(pieces, parts.piece_part, strict=True):
        obj = bpy.data.objects.new("hulldown part", meshes[piece.mesh])
        obj[PART] = part
        obj[REST] = (vehicle_from_file @ piece.pose).ravel().tolist()
        collection.objects.link(obj)
    bpy.data.libraries.write(output, {collection}, path_remap="ABSOLUTE")
