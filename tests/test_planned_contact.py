"""Contact of planned vehicles takes the height of their undersides into account."""

from dataclasses import replace

import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge
from hulldown.planning.search.stage import make_stage
from hulldown.tests.planning_assets import small_assets, small_config, vehicle
from hulldown.tests.shapes import box

BELLY = 0.45
UP = np.array([0.0, 0.0, BELLY])


def on_rails():
    """The tank of the other tests, with its hull on two rails."""
    level = vehicle("t72")
    rails = [box((-4.2, y - 0.3, -BELLY), (2.6, y + 0.3, 0.2)) for y in (-1.4, 1.4)]
    mesh, _ = merge([level.mesh, *rails])
    return replace(
        level,
        mesh=Mesh(mesh.vertices + UP, mesh.faces, "t72"),
        vertex_part=np.concatenate([level.vertex_part, np.zeros(16, dtype=np.int64)]),
        part_pivot=level.part_pivot + UP * (np.arange(3) > 0)[:, None],
    )


def test_contact_footprint_models_the_belly_and_contact_box_does_not():
    assets, footings = replace(small_assets(), vehicles={"t72": on_rails()}), {}
    for contact in ("footprint", "box"):
        stage = make_stage(small_config(placement={"contact": contact}), assets)
        footings[contact] = stage.models["t72"].footing.contact
    belly = np.abs(footings["footprint"].xy[:, 1]) < 0.5
    assert np.median(footings["footprint"].height[belly]) == pytest.approx(BELLY)
    assert not footings["box"].height.any()
    np.testing.assert_array_equal(footings["box"].xy[[0, -1]], [[-4.2, -1.7], [4.2, 1.7]])
