"""Contact of planned vehicles takes the height of their undersides into account."""

from dataclasses import replace

import numpy as np
import pytest

from hulldown.assets.library import Assets
from hulldown.geometry.meshes import Mesh, merge
from hulldown.planning.search.stage import make_stage
from hulldown.planning.write import write_plan
from hulldown.tests.planning_assets import hills, small_assets, small_config, vehicle
from hulldown.tests.shapes import box

BELLY = 0.45
UP = np.array([0.0, 0.0, BELLY])


def on_rails():
    """The tank of the other tests, with its hull on two rails with raised ends."""
    level = vehicle("t72")
    rails = [box((-4.2, y - 0.3, -BELLY), (2.0, y + 0.3, 0.2)) for y in (-1.4, 1.4)]
    toes = [box((2.0, y - 0.3, 0.05 - BELLY), (2.6, y + 0.3, 0.2)) for y in (-1.4, 1.4)]
    mesh, _ = merge([level.mesh, *rails, *toes])
    return replace(
        level,
        mesh=Mesh(mesh.vertices + UP, mesh.faces, "t72"),
        vertex_part=np.concatenate([level.vertex_part, np.zeros(32, dtype=np.int64)]),
        part_pivot=level.part_pivot + UP * (np.arange(3) > 0)[:, None],
    )


def test_gaps_are_measured_to_the_underside(tmp_path):
    config = small_config(
        assets={"vehicles": [{"path": "t72.blend", "category": "tank"}], "sceneries": [{"path": "hills.blend"}]},
        budget={"images_per_class": 24, "images_per_position": 1},
    )
    scenery = hills("hills", height=2.0, size=120.0, cells=60, trees=0)
    assets = Assets({"t72": on_rails()}, {"t72": "tank"}, {"hills": scenery}, ("noon",))
    made = write_plan(config, assets, tmp_path / "plan.jsonl")
    # Rigid rails on this ground: they don't touch everywhere, and the belly doesn't touch.
    gap = [row.target.gap for row in made]
    assert 0.02 < np.median(gap) < BELLY


def test_contact_footprint_models_the_belly_and_contact_box_does_not():
    assets = small_assets()
    footings = {}
    for contact in ("footprint", "box"):
        config = small_config(assets={"sceneries": [{"path": "hills.blend"}]}, placement={"contact": contact})
        stage = make_stage(config, replace(assets, vehicles={**assets.vehicles, "t72": on_rails()}))
        footings[contact] = stage.models["t72"].footing.contact
    belly = np.abs(footings["footprint"].xy[:, 1]) < 0.5
    assert np.median(footings["footprint"].height[belly]) == pytest.approx(BELLY)
    assert not footings["box"].height.any()
    np.testing.assert_array_equal(footings["box"].xy[[0, -1]], [[-4.2, -1.7], [4.2, 1.7]])
