"""All types of labels: what computes their fields from a scene, in the order of a record, and what checks them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.box import box_problems
from hulldown.dataset.labels.box_3d import box_3d_problems, corner_problems
from hulldown.dataset.labels.keypoints import keypoint_problems, seen_keypoints
from hulldown.dataset.labels.mask import amodal_mask_problems, mask_problems, seen_masks
from hulldown.dataset.labels.oriented_box import oriented_box_problems, seen_rectangle
from hulldown.dataset.labels.seen_vehicle import SeenVehicle

SCENE_FIELDS: tuple[Callable[[SeenVehicle], dict[str, object]], ...] = (seen_masks, seen_rectangle, seen_keypoints)
# Functions from a label, its image, and its class (None: unknown) to a sentence for each problem.
LABEL_CHECKS: tuple[Callable[[Label, Image, Category | None], Iterator[str]], ...] = (
    *(box_problems, box_3d_problems, corner_problems, mask_problems),
    *(amodal_mask_problems, oriented_box_problems, keypoint_problems),
)


def fields_of_scene(vehicle: SeenVehicle) -> dict[str, object]:
    """Return the fields of a label that need the scene."""
    return {key: value for fields in SCENE_FIELDS for key, value in fields(vehicle).items()}
