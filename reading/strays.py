"""What is kept of a vehicle's file and may be no part of it: hidden from its author, unedited, or below the wheels."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from assets.naming import words
from geometry.meshes import Mesh
from reading.axes import Wheels
from reading.roles import Piece

# What Blender calls a new mesh, and how many vertices it has, None for any.
PRIMITIVES = {
    "cube": 8, "plane": 4, "sphere": None, "icosphere": None, "cylinder": None, "cone": None, "torus": None,
    "suzanne": None, "monkey": None, "circle": None, "grid": None,
}  # fmt: skip
BELOW = 0.03  # of the vehicle's height: a tyre that is pressed into the ground
OUT = 0.1  # of the length of the rest
APART = 0.02  # of the length of the rest: so much air around it
FLAT = 1e-4  # of its longest side: a sheet without thickness
NAMES = 6  # that a sentence lists


def stray_doubts(
    pieces: Sequence[Piece],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    meshes: Sequence[Mesh],
    wheels: Wheels | None,
    *,
    wheeled: Collection[int],
) -> list[str]:
    """A sentence for each kind of stray among the kept pieces of a vehicle, with the key to set.

    Parameters
    ----------
    pieces
        What is kept.
    points
        For each its vertices, x forward, z up.
    meshes
        The file's unique meshes.
    wheels
        Upright too.
    wheeled
        Pieces that wheels are part of, and so no strays.
    """
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    height = float(bounds[:, 1, 2].max() - bounds[:, 0, 2].min())
    hidden = [p.name for p in pieces if p.hidden]
    low = (
        []
        if wheels is None
        else [p.name for p, b in zip(pieces, bounds, strict=True) if b[0, 2] < wheels.level - BELOW * height]
    )
    # If much hangs below, the wheels are not what it stands on: tracks around them, or skirts.
    low = low if len(low) <= max(2, len(pieces) // 10) else []
    unedited = [p.name for p in pieces if _is_primitive(p, meshes[p.mesh])]
    apart = [p.name for i, p in enumerate(pieces) if i not in wheeled and _is_apart(i, bounds)]
    out = [p.name for i, p in enumerate(pieces) if i not in wheeled and _sticks_out(i, bounds)]
    doubts, told = [], set()
    for names, what in (
        (hidden, "hidden from the viewport, but rendered"),
        (low, "reaching below the wheels"),
        (unedited, "a new mesh of Blender's, as it comes"),
        (apart, "not touching the rest"),
        (out, "a flat sheet or a bulk that sticks out of the rest"),
    ):
        new = [n for n in dict.fromkeys(names) if n not in told]
        told |= set(new)
        if new:
            those = f"{', '.join(map(repr, new[:NAMES]))}{_more(new)}"
            doubts.append(f"{those}: {what}; set drop = {_listed(new)} if that is no part of it")
    return doubts


def _is_primitive(piece: Piece, mesh: Mesh) -> bool:
    """Called like a new mesh, of its shape and size, and not stretched into a part of something."""
    kind = next((w for w in words(piece.name) if not w.isdigit()), "")
    if kind not in PRIMITIVES or len([w for w in words(piece.name) if not w.isdigit()]) > 1:
        return False
    count = PRIMITIVES[kind]
    scale = np.linalg.norm(piece.pose[:3, :3], axis=0)
    size = np.ptp(mesh.vertices, axis=0)
    whole = np.abs(size[size > 0] - 2.0).max() < 1e-3
    return bool((count is None or len(mesh.vertices) == count) and whole and np.ptp(scale) < 1e-3 * scale.max())


def _sticks_out(i: int, bounds: np.ndarray) -> bool:
    """A sheet without thickness beyond the rest, or what is larger than all the rest."""
    if len(bounds) < 2:
        return False
    rest = np.delete(bounds, i, axis=0)
    low, high = rest[:, 0].min(axis=0), rest[:, 1].max(axis=0)
    size = bounds[i, 1] - bounds[i, 0]
    beyond = np.maximum(low - bounds[i, 0], bounds[i, 1] - high)
    sheet = bool(size.min() <= FLAT * size.max())
    longest = float((high - low).max())
    larger = int((size > 1.3 * (high - low)).sum())
    return bool(sheet and beyond.max() > OUT * longest) or larger >= 2


def _is_apart(i: int, bounds: np.ndarray) -> bool:
    """Whether its box is clear of the boxes of all others."""
    if len(bounds) < 2:
        return False
    rest = np.delete(bounds, i, axis=0)
    slack = APART * float((rest[:, 1].max(axis=0) - rest[:, 0].min(axis=0)).max())
    near = (rest[:, 0] < bounds[i, 1] + slack) & (rest[:, 1] > bounds[i, 0] - slack)
    return not near.all(axis=1).any()


def _more(names: Sequence[str]) -> str:
    return f" and {len(names) - NAMES} more" if len(names) > NAMES else ""


def _listed(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{n}"' for n in names[:NAMES]) + "]"
