"""benchmarks.like: plans of its arms differ only in cameras."""

import pytest

from hulldown.benchmarks.like import ARMS, SETS, SHARES, read_renders, read_stand_ins
from hulldown.benchmarks.stand_ins import write_side
from hulldown.plan.config.scene_sections import CameraSection
from hulldown.plan.config.schema import Config


@pytest.mark.parametrize("name", SETS)
def test_arms_differ_in_cameras_only(name, tmp_path):
    configs = {key: Config.read(write_side(side, tmp_path)) for key, side in read_renders(name).items()}
    assert set(configs) == {part for parts in ARMS.values() for part in parts}
    sizes = [sum(configs[part].budget.images_per_class for part in parts) for parts in ARMS.values()]
    assert len(set(sizes)) == 1
    for parts in ARMS.values():  # positions planned twice must differ
        assert len({configs[part].seed for part in parts}) == 2
    for key, config in configs.items():
        like = None if key.startswith("default") else f"{name}-photographs/train"
        assert config.camera == CameraSection(like=like)
        same = {section: getattr(config, section) for section in ("assets", "placement", "light", "budget", "render")}
        assert same == {section: getattr(configs["default"], section) for section in same}


@pytest.mark.parametrize("name", SETS)
def test_stand_ins_share_neither_assets_nor_cameras_with_renders(name, tmp_path):
    stand_ins, renders = (Config.read(write_side(s, tmp_path)) for s in (read_stand_ins(name), read_renders(name)["like"]))
    for kind in ("vehicles", "sceneries"):
        first, second = ({one.path for one in getattr(config.assets, kind)} for config in (stand_ins, renders))
        assert len(first | second) == len(first) + len(second) > 1
    assert not set(stand_ins.assets.hdris) & set(renders.assets.hdris)
    low, high = stand_ins.camera.elevation_deg
    assert renders.camera.elevation_deg[0] <= low < high <= renders.camera.elevation_deg[1]  # otherwise limits override
    assert sum(SHARES) == 1.0
