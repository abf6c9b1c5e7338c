"""What a type of label is: fields of a record, where they come from, and their check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic

from jaxtyping import Bool
from numpy import ndarray

from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.store.declared import Declared, fields_of
from hulldown.planning.plan.row import PlannedVehicle, Row
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


@dataclass(frozen=True, slots=True)
class LabelType(Generic[Declared]):
    """A type of label."""

    fields: type[Declared]  # its fields in a record, with types and ranges; all may be missing
    # function from a label, its image, and its class (None: unknown) to a sentence for each problem
    problems: Callable[[Label, Image, Category | None], Iterator[str]]
    # function from a vehicle and its row to the fields that a plan determines alone; None if there are none, or if the
    # row has them itself
    of_row: Callable[[PlannedVehicle, Row], Declared] | None = None
    # function to the fields that need the scene, if there are any; None if there never are
    of_scene: Callable[[SeenVehicle], Declared | None] | None = None

    def read(self, label: Label) -> Declared:
        """Return the fields of a label; those that don't fit are missing."""
        return fields_of(label.record, self.fields)
