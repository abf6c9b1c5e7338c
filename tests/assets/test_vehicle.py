"""Poses of a vehicle's parts when they turn."""

import numpy as np
import pytest

from hulldown.assets.vehicle import VehicleShape
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import axis_rotation, rigid_matrix, transform_points
from hulldown.tests.builders.shapes import vertices_at

RNG = np.random.default_rng(0)
AXIS = np.array([[0.0, 0, 1], [0, 0, 1], [0.1, -1, 0.2], [1, 2, 3]])
SHAPE = VehicleShape(
    name="rig",
    mesh=Mesh(RNG.normal(size=(12, 3)), np.arange(12).reshape(4, 3), "rig"),
    vertex_part=np.repeat(np.arange(4), 3),
    part_names=("hull", "turret", "gun", "mast"),
    part_parent=np.array([-1, 0, 1, 0]),
    part_pivot=np.array([[0.0, 0, 0], [0.3, 0.1, 2], [1.2, 0, 2.4], [-1, 0.5, 3]]),
    part_axis=AXIS / np.linalg.norm(AXIS, axis=1, keepdims=True),
    part_limits=np.zeros((4, 2)),
    vehicle_from_file=np.eye(4),
)
TURNED = {"turret": 0.8, "gun": -0.3}


def twin(articulation: dict[str, float]) -> np.ndarray:
    """One part after the other, by matrix products."""
    poses = [np.eye(4)]
    for i, name in enumerate(SHAPE.part_names[1:], start=1):
        turn = axis_rotation(SHAPE.part_axis[i], articulation.get(name, 0.0))
        poses.append(poses[SHAPE.part_parent[i]] @ rigid_matrix(turn, SHAPE.part_pivot[i] - turn @ SHAPE.part_pivot[i]))
    return np.array(poses)


@pytest.mark.parametrize("articulation", [{}, TURNED, {"mast": 3.0}, {"gun": 1e-9}, {"turret": -2.0, "gun": 0.4, "mast": 1.0}])
def test_parts_turn_about_their_pivots_and_move_with_their_parents(articulation: dict[str, float]) -> None:
    expected = twin(articulation)
    np.testing.assert_allclose(SHAPE.vehicle_from_parts(articulation), expected, rtol=0, atol=1e-15 * 8)
    vertices = np.concatenate([transform_points(expected[i], SHAPE.mesh.vertices[3 * i : 3 * i + 3]) for i in range(4)])
    np.testing.assert_allclose(vertices_at(SHAPE, articulation), vertices, rtol=0, atol=1e-14)


def test_one_articulation_equals_a_row_of_many_bit_for_bit() -> None:
    drawn = RNG.uniform(-3, 3, (7, 3)) * (RNG.random((7, 3)) < 0.6)
    many = [dict(zip(SHAPE.part_names[1:], row, strict=True)) for row in [*drawn.tolist(), [0.0] * 3]]
    poses = SHAPE.vehicle_from_parts(many)
    assert poses.shape == (8, 4, 4, 4)
    for row, articulation in zip(poses, many, strict=True):
        np.testing.assert_array_equal(row, SHAPE.vehicle_from_parts(articulation))
    np.testing.assert_array_equal(poses[-1], np.tile(np.eye(4), (4, 1, 1)))
    assert SHAPE.vehicle_from_parts([]).shape == (0, 4, 4, 4)


def test_a_missing_part_is_named() -> None:
    with pytest.raises(ValueError, match=r"articulation: 'rig' has no part 'hull'; it has \['turret', 'gun', 'mast'\]"):
        SHAPE.vehicle_from_parts([{}, {"hull": 1.0}])
