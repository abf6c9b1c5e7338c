"""A labeled vehicle of a row in its scene, from which labels are computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Bool
from numpy import ndarray

from hulldown.plan.row import Row
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle


@dataclass(frozen=True, eq=False, slots=True)
class SeenVehicle:
    """A labeled vehicle of a row in its scene."""

    row: Row
    posed: PosedVehicle  # the vehicle in its pose
    scene: Scene  # everything in the image, this vehicle included
    # whole, visible: pixels whose center is on the vehicle, and those of them that nothing hides
    whole: Bool[ndarray, "h w"]
    visible: Bool[ndarray, "h w"]
    keypoints: Sequence[str] = ()  # names of the dataset's keypoints, in order; empty: it has none
