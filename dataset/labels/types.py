"""All types of labels, in the order of their fields in a record."""

from __future__ import annotations

from typing import Any, get_type_hints

import msgspec
import orjson
from msgspec import Struct

from hulldown.dataset.labels.amodal_mask import AMODAL_MASK
from hulldown.dataset.labels.box import BOX
from hulldown.dataset.labels.box_3d import BOX_3D
from hulldown.dataset.labels.corners import CORNERS
from hulldown.dataset.labels.keypoints import KEYPOINTS
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.labels.mask import MASK
from hulldown.dataset.labels.oriented_box import ORIENTED_BOX
from hulldown.dataset.store.declared import LabelRecord
from hulldown.planning.plan.row import PlannedVehicle, Row, encode

LABEL_TYPES: tuple[LabelType[Any], ...] = (BOX, BOX_3D, CORNERS, MASK, AMODAL_MASK, ORIENTED_BOX, KEYPOINTS)

# The fields of a label, those of all types included.
LabelFields = msgspec.defstruct(
    "LabelFields",
    [
        (field.name, get_type_hints(kind.fields, include_extras=True)[field.name], None)
        for kind in LABEL_TYPES
        for field in msgspec.structs.fields(kind.fields)
    ],
    bases=(LabelRecord,),
    kw_only=True,
)


def fields_of_row(vehicle: PlannedVehicle, row: Row) -> dict[str, object]:
    """Return the fields of a label that its row determines, beside those that datasets copy from rows."""
    return _json(*(kind.of_row(vehicle, row) for kind in LABEL_TYPES if kind.of_row))


def fields_of_scene(vehicle: SeenVehicle) -> dict[str, object]:
    """Return the fields of a label that need the scene."""
    return _json(*(fields for kind in LABEL_TYPES if kind.of_scene and (fields := kind.of_scene(vehicle)) is not None))


def _json(*parts: Struct) -> dict[str, object]:
    return {key: value for part in parts for key, value in orjson.loads(encode(part)).items()}
