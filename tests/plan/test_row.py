"""The schema of a plan: rounding, and the tables of docs/plan-file.md."""

from pathlib import Path

import numpy as np
import pytest

from hulldown.geometry.transforms import axis_rotation, rigid_matrix
from hulldown.plan.row import Header, PlannedVehicle, Row, round_field, row_fields

PAGE = (Path(__file__).parents[2] / "docs" / "plan-file.md").read_text(encoding="utf-8")

KEYS = row_fields(Row) | row_fields(PlannedVehicle)


def described(kind):
    """The page's table for a type, with a line per field."""
    return [
        f"| `{name}` | {field.expected}{f'; to {field.to}' if field.to else ''} | {field.meaning} |"
        for name, field in row_fields(kind).items()
    ]


@pytest.mark.parametrize("kind", [Header, Row, PlannedVehicle])
def test_the_docs_describe_every_field(kind):
    wanted = "\n".join(described(kind))
    assert wanted in PAGE, f"docs/plan-file.md is to have these lines:\n{wanted}"


def test_rounding_is_idempotent():
    rng = np.random.default_rng(0)
    poses = rigid_matrix(axis_rotation([0.0, 0.6, 0.8], rng.uniform(-3, 3, 1000)), rng.normal(scale=1e4, size=(1000, 3)))
    values = {
        "world_from_camera": poses,
        "bbox": rng.uniform(-1e4, 1e4, (1000, 4)),
        **{key: rng.uniform(0, 180, 1000) for key, field in KEYS.items() if field.to == "1e-12 degrees"},
        **{key: rng.uniform(0, 1, 1000) for key, field in KEYS.items() if field.to.startswith("1e-9")
           and field.rounding and not key.startswith("world")},
    }  # fmt: skip
    for key, drawn in values.items():
        once = round_field(key, drawn)
        assert np.array_equal(round_field(key, once), once), key
        assert 0.0 < np.abs(once - drawn).max() < 1.1e-6


def test_numbers_have_the_documented_decimals():
    rng = np.random.default_rng(1)
    pose = round_field("world_from_vehicle", rigid_matrix(axis_rotation([0.0, 0.0, 1.0], 1.0), rng.normal(scale=1e3, size=3)))
    boxes = round_field("bbox", rng.uniform(100.0, 1000.0, (1000, 4)))
    for values, decimals in ((pose[:3, 3], 9), (pose[:3, :3], 12), (boxes, 6)):
        assert max(len(repr(value).partition(".")[2]) for value in values.ravel().tolist()) <= decimals
    assert np.signbit(round_field("strength", np.array([-1e-12]))).tolist() == [False]


def test_a_box_that_ends_at_the_frame_still_does_after_rounding():
    rng = np.random.default_rng(2)
    low = rng.uniform(0.0, 1900.0, (100_000, 2))
    boxes = round_field("bbox", np.concatenate([low, 1920.0 - low], axis=1))
    assert (boxes[:, :2] + boxes[:, 2:]).max() <= 1920.0 + 1e-9
