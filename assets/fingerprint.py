"""Two values that tell whether two readings of a file gave the same geometry.

Another Blender may evaluate modifiers differently, and another NumPy rounds products of matrices differently: up to
1e-13 m between NumPy 1.26 and 2.5. A hash of coordinates would tell these apart, so coordinates are compared by a
weighted sum.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape

GOLDEN_RATIO = (5**0.5 - 1) / 2  # multiples of it, modulo 1, are spread evenly
SHAPE_TOLERANCE = 1e-5  # of the weighted sum of all coordinates; a coordinate that changes by 0.02 mm changes it more


class Fingerprint(msgspec.Struct, frozen=True):
    """The fingerprint of a vehicle's or scenery's geometry."""

    topology: str  # SHA-256 of all that isn't a coordinate: faces, parts, textures, and how many of each there are
    shape: float  # weighted sum of all coordinates, in meters

    def agrees_with_other(self, other: Fingerprint) -> bool:
        """Return whether another fingerprint is of the same geometry."""
        return self.topology == other.topology and abs(self.shape - other.shape) <= SHAPE_TOLERANCE


def asset_fingerprint(asset: VehicleShape | Scenery) -> Fingerprint:
    """Return the fingerprint of an asset as it was read; names and what follows from its meshes don't count."""
    if isinstance(asset, VehicleShape):
        asset = replace(asset, underside=np.zeros((0, 0)))  # by rays, for which rounding may make the difference
    topology, shape, count = hashlib.sha256(), 0.0, 0

    def take(array: np.ndarray) -> Any:
        nonlocal shape, count
        topology.update(f"{array.dtype.name} {array.shape}\n".encode())
        if array.dtype.kind == "f":
            weight = np.arange(count, count + array.size) * GOLDEN_RATIO
            weight -= np.floor(weight)  # modulo 1, in a tenth of the time that NumPy's `%` takes
            weight -= 0.5
            weight += np.copysign(0.5, weight)  # no coordinate counts less than half
            shape += float(weight @ np.nan_to_num(array.ravel().astype(np.float64), posinf=0.0, neginf=0.0))
            count += array.size
        else:
            topology.update(array.tobytes())
        return None

    msgspec.to_builtins(asset, enc_hook=take)
    return Fingerprint(topology.hexdigest(), shape)
