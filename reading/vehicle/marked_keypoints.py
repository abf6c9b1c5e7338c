"""Keypoints of a vehicle that empties with keypoint names mark."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hulldown.reading.pieces.roles import Link
from hulldown.reading.vehicle.part_names import link_key

_NAMED = re.compile(r"(?:kp_|keypoint[_.\- ]*)(.*)", re.IGNORECASE | re.DOTALL)


def read_keypoint(name: str) -> str | None:
    """Return the keypoint of an empty with this name; None if it isn't one."""
    found = _NAMED.fullmatch(name)
    return (found[1] or name) if found else None


def marked_points(
    markers: Sequence[tuple[Link, ...]], chains: Sequence[tuple[Link, ...]], piece_part: Sequence[int]
) -> dict[str, tuple[Float[np.ndarray, "3"], int | None]]:
    """Keypoints of empties: positions in the file, and the part that each belongs to, if any."""
    parts_below: dict[tuple[str, bytes], set[int]] = {}
    for chain, part in zip(chains, piece_part, strict=True):
        for link in chain:
            parts_below.setdefault(link_key(link), set()).add(part)
    own = {link_key(chain[0]): part for chain, part in zip(chains, piece_part, strict=True)}
    found: dict[str, tuple[Float[np.ndarray, "3"], int | None]] = {}
    for marker, *above in markers:
        if (name := read_keypoint(marker.name)) is None or name in found:
            continue
        # The first one above it that is a piece, or only holds pieces of one part.
        below = (({own[key]} if key in own else parts_below.get(key, set())) for key in map(link_key, above))
        found[name] = marker.pose[:3, 3], next((min(parts) for parts in below if len(parts) == 1), None)
    return found
