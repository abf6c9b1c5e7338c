"""Targets of the requested size: the exact measures of `camera.size_measure`, from config to plan to check."""

import pytest

from hulldown.annotate.boxes import surface_box
from hulldown.geometry.transforms import apply
from hulldown.planning.row import encode_rows
from hulldown.tests.planning_assets import filled_share, plan, small_assets, small_config

ASSETS = small_assets(vehicles=["t72"])
# relative to the requested size, as plans promise
RELATIVE = 1e-9


def planned(**camera):
    return list(plan(small_config(camera=camera, budget={"images_per_class": 6}), ASSETS))


def amodal_share(row, measure):
    """Share of the image by the exact rule, from the row's poses alone."""
    shape = ASSETS.vehicles[row.target.vehicle]
    vertices = apply(row.target.world_from_vehicle, shape.vertices_at(row.target.articulation))
    return filled_share(surface_box(vertices, shape.mesh.faces, row.camera, frame=False)[2:], row, measure)


@pytest.mark.parametrize("truncated", [[0.0, 0.0], [0.1, 0.4]], ids=["whole", "cut"])
@pytest.mark.parametrize("measure", ["height", "width", "diagonal", "area"])
def test_the_box_has_the_requested_size(measure, truncated):
    for row in planned(size_measure=measure, target_fraction=0.15, framing=1.0, truncated_fraction=truncated):
        assert amodal_share(row, measure) == pytest.approx(0.15, rel=RELATIVE)
        assert truncated[0] <= row.target.truncated_fraction <= truncated[1]


def test_sizes_cover_their_range_and_the_distance_factor_is_unused():
    options = {"size_measure": "area", "target_fraction": [0.0005, 0.0044]}
    rows = planned(**options, distance_factor=1.0)
    shares = [amodal_share(row, "area") for row in rows]
    assert 0.0005 <= min(shares) < 0.0015 < 0.003 < max(shares) <= 0.0044
    assert encode_rows(planned(**options, distance_factor=4.0)) == encode_rows(rows)


def test_a_size_that_no_distance_gives_is_counted():
    # A box ten times as high as the image needs a camera inside the vehicle or too close to it.
    rows = planned(
        size_measure="height", target_fraction=[0.3, 10.0], truncated_fraction=[0.0, 1.0], distance_m=[0.0, 5000.0],
        obstacle_clearance=0.0, fov_x_deg=120.0, max_tries=500,
    )  # fmt: skip
    assert sum(row.rejected.get("size", 0) for row in rows) > 0
