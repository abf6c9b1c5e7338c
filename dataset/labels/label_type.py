"""What a type of label is: fields of a record, where they come from, and their check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from jaxtyping import Bool
from msgspec import Struct
from numpy import ndarray

from hulldown.assets.coco_types import Record
from hulldown.planning.plan.row import PlannedVehicle, Row
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle


@dataclass(frozen=True, eq=False, slots=True)
class SeenVehicle:
    """A labeled vehicle of a row in its scene.

    Parameters
    ----------
    row
        Its image.
    posed
        The vehicle in its pose.
    scene
        Everything in the image, this vehicle included.
    whole, visible
        (h, w) pixels whose center is on the vehicle, and those of them that nothing hides.
    keypoints
        Names of the dataset's keypoints, in order; empty: it has none.
    """

    row: Row
    posed: PosedVehicle
    scene: Scene
    whole: Bool[ndarray, "h w"]
    visible: Bool[ndarray, "h w"]
    keypoints: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class LabelType:
    """A type of label.

    Parameters
    ----------
    fields
        Its fields in a record, with types and ranges; all may be missing.
    problems
        Function from the records of a label, its image, and its category to a sentence for each problem. The fields
        have their declared types, and the image has a size.
    of_row
        Function from a vehicle and its row to the fields that a plan determines alone; None if there are none, or if
        the row has them itself.
    of_scene
        Function to the fields that need the scene; None if there are none.
    """

    fields: type[Struct]
    problems: Callable[[Record, Record, Record], Iterator[str]]
    of_row: Callable[[PlannedVehicle, Row], dict[str, Any]] | None = None
    of_scene: Callable[[SeenVehicle], dict[str, Any]] | None = None
