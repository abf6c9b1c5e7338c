"""Jobs for rendering workers."""

import orjson

from hulldown.plan.row import decode_row
from hulldown.render.blender.messages import CyclesSettings
from hulldown.render.jobs import make_render_job
from hulldown.tests.builders.render_plans import CUBES, make_row


def test_seeds_for_cycles_have_31_bits(tmp_path):
    """Blender's properties are signed 32-bit integers; seeds in an edited plan may be larger."""
    for seed in (0, 2**31 - 1, 2**31 + 5, 2**62, -1):
        row = decode_row(orjson.dumps(make_row(0, sample_seed=seed)))
        assert 0 <= make_render_job(row, CUBES, CyclesSettings(2, False, 0.0, 4), tmp_path / "a.png").seed < 2**31
