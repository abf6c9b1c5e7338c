"""Everything that Blender draws of a file, as plain arrays for analysis without Blender."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from hulldown.geometry.meshes import Mesh
from hulldown.reading.report import ObjectRow
from hulldown.reading.roles import Link, Piece


@dataclass(eq=False, slots=True)
class Evaluated:
    """The evaluated contents of a scene.

    Parameters
    ----------
    meshes
        Unique evaluated meshes, each in its own frame and the file's units.
    wet
        By mesh index, the faces whose material is named like water, if only some are.
    pieces
        Every drawn mesh, where it is drawn; `bounds` after `meters_from_file`.
    markers
        Chains of all empties.
    left
        Rows of objects without a piece, and how often they're drawn.
    doubts
        Sentences about things that are rendered differently than read.
    dressed
        Whether anything of it has a material.
    """

    meshes: list[Mesh] = field(default_factory=list)
    wet: dict[int, Bool[np.ndarray, " f"]] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    markers: list[tuple[Link, ...]] = field(default_factory=list)
    left: Counter[ObjectRow] = field(default_factory=Counter)
    doubts: list[str] = field(default_factory=list)
    dressed: bool = False
