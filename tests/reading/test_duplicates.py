"""Objects that are read without evaluation equal evaluated ones."""

import json
from pathlib import Path

import numpy as np

from hulldown.assets.bundle import load_scenery

SCRIPT = "twin_blends.py"
ALIKE = {
    # Objects that others depend on aren't twins: 0 and 1 are parents, 4 to 9 targets; 10 is the first, which is kept.
    *(f"posed {number}" for number in (2, 3, *range(11, 24))),
    *("without faces 1", "unrendered 1", "unrendered 2", "excluded 1", "excluded 2", "in the scene and one 1"),
    *("spare equal", "spare equal too", "spare unnamed 1"),
}


def test_only_indistinguishable_objects_are_twins(written: Path) -> None:
    assert set(json.loads((written / "answer.json").read_text())["taken"]) == ALIKE


def test_bundles_are_equal(written: Path) -> None:
    every, few = (load_scenery(written / name / "bundle.npz") for name in ("all", "few"))

    def things(scenery):
        return sorted(
            (name, pose.tobytes(), scenery.obstacle_meshes[mesh].vertices.tobytes(), bool(soft), bool(water))
            for name, pose, mesh, soft, water in zip(
                scenery.instance_names,
                scenery.world_from_instance,
                scenery.instance_mesh,
                scenery.instance_gives_way,
                scenery.instance_is_water,
                strict=True,
            )
        )

    assert things(every) == things(few)
    assert len(every.instance_names) > 50
    assert every.ground_names == few.ground_names
    np.testing.assert_array_equal(every.ground.vertices, few.ground.vertices)
    np.testing.assert_array_equal(every.origin, few.origin)


def test_reports_are_equal(written: Path) -> None:
    every, few = (json.loads((written / name / "answer.json").read_text()) for name in ("all", "few"))
    for answer in (every, few):
        answer["report"]["rows"].sort(key=json.dumps)
    assert every == few
    assert sum("xcluded" in json.dumps(row) for row in every["report"]["rows"])


def test_renders_are_equal(written: Path) -> None:
    answer = json.loads((written / "answer.json").read_text())
    assert answer["all"] == answer["few"]
    assert len(answer["all"]) > 50
