"""Pictures with a simulated sensor, rendered by Cycles."""

import numpy as np
import pytest

from hulldown.camera.sensor import Sensor
from hulldown.dataset.exports.export import export
from hulldown.dataset.verification.verify import verify
from hulldown.planning.check import check_plan
from hulldown.planning.inputs.loading import load_library
from hulldown.rendering.supervisor import render_plan
from hulldown.tests.blender_plans import draw, make_plan
from hulldown.tests.plan_lines import altered

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def plan(own_worlds):
    return make_plan(own_worlds, budget={"images_per_class": 2}, sensor={"preset": "camera"})


def test_a_sensor_without_effects_gives_blenders_own_picture(plan, library, own_worlds):
    row = plan[0]
    turned = altered(row, exposure_ev=row.exposure_ev + 1.0, white_balance_k=1500.0)
    rows = [altered(each, sensor=sensor) for each in (row, turned) for sensor in (None, Sensor())]
    pictures = draw(own_worlds, [(each, library) for each in rows], samples=2)
    for own, developed in zip(pictures[::2], pictures[1::2], strict=True):
        apart = np.abs(own - developed)
        assert np.ptp(own) > 100.0
        assert np.percentile(apart, 99.9) <= 1.0  # Blender dithers: some pixels differ by one level
        assert apart.max() <= 2.0


def test_a_dataset_of_jpeg_files_is_sound_and_reproducible(plan, library, own_worlds):
    assert check_plan(plan, load_library(plan.config).assets) == []
    datasets = [own_worlds / name for name in ("one", "again")]
    for dataset in datasets:
        assert render_plan(plan.path, dataset, library=library).complete
    names = [f"images/{i:08d}.jpg" for i in (1, 2)]
    contents = [[(dataset / name).read_bytes() for name in names] for dataset in datasets]
    assert contents[0] == contents[1], "the noise doesn't follow from the row's seed"
    assert all(content.startswith(b"\xff\xd8\xff") for content in contents[0])
    assert list(verify(datasets[0], plan=plan.path)) == []
    export(datasets[0], own_worlds / "yolo", layout="yolo")
    assert len(list((own_worlds / "yolo").rglob("*.jpg"))) == 2
