"""Water that is part of the ground's mesh: faces with a material named like water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import apply
from hulldown.reading.evaluated import Evaluated
from hulldown.reading.roles import Piece
from hulldown.reading.scenery.scenery_roles import is_water_name
from hulldown.reading.scenery.shape import is_wide_and_level, level_share

NARROWEST = 1.0  # meters, as for water objects


def wet_slots(materials: Sequence[str]) -> list[int]:
    """Materials of a mesh that are named like water."""
    return [slot for slot, name in enumerate(materials) if is_water_name(name)]


def is_partly_water(piece: Piece, drawn: Evaluated, meters: Float[np.ndarray, "4 4"]) -> bool:
    """Whether faces with a material named like water are water: together wide and mostly level.

    Parameters
    ----------
    piece
        Ground.
    drawn
        Everything that the file draws.
    meters
        (4, 4) affine, the file's scale and up axis.
    """
    if piece.mesh not in drawn.wet:
        return False
    part, meters_from_mesh = part_of(piece.mesh, drawn, wet=True), meters @ piece.pose
    seen = apply(meters_from_mesh, part.vertices)
    bounds = np.stack([seen.min(axis=0), seen.max(axis=0)])
    level, _ = level_share(part, meters_from_mesh)
    return is_wide_and_level(replace(piece, bounds=bounds, level=level), least=NARROWEST)


def part_of(number: int, drawn: Evaluated, *, wet: bool) -> Mesh:
    """The faces of a mesh with a material named like water, or the others."""
    return drawn.meshes[number].of_faces(np.flatnonzero(drawn.wet[number] == wet))
