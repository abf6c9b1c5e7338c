"""Keypoints: position, visibility, configuration, storage, export."""

import numpy as np
import pytest
import yaml
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from hulldown.annotate.labels.keypoints import category_keypoint_fields, keypoints_in_image
from hulldown.assets.bundle import load_vehicle, save_asset
from hulldown.base.errors import ConfigError, DatasetError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.exports.export import export_dataset
from hulldown.geometry.meshes import Mesh
from hulldown.reading.vehicle.pivots import keypoints_from_empties
from hulldown.render.verify import verify_dataset
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.ray_caster import RayCaster
from hulldown.tests.annotate.test_silhouettes import CAMERA, CUBE, SHAPE
from hulldown.tests.builders.editing import append, edit
from hulldown.tests.builders.planning_assets import small_assets
from hulldown.tests.builders.shapes import FACES, vertices_at
from hulldown.tests.reading.test_roles import link

# In the center of each face of the cube, and in front of the camera but outside the picture.
POINTS = {
    "near": ([0.0, -1.0, 0.2], None),
    "far": ([0.0, 1.0, 0.2], None),
    "middle": ([0.0, 0.0, 0.0], None),
    "sunk": ([0.0, -0.995, 0.0], None),
    "aside": ([30.0, 0.0, 0.0], None),
    "behind": ([0.0, -9.0, 0.0], None),
}
CUBE_WITH_POINTS = SHAPE.with_keypoints(POINTS)


def seen(vehicle, *others, camera=CAMERA, ground=None):
    found = keypoints_in_image(vehicle, camera, Scene(ground, vehicles=[vehicle, *others]))
    return dict(zip(vehicle.caster.shape.keypoint_names, found.tolist(), strict=True))


def test_keypoints_behind_a_surface_are_hidden_and_outside_the_picture_unlabeled():
    here = PosedVehicle(VehicleCaster(CUBE_WITH_POINTS), np.eye(4)[None], {})
    found = seen(here)
    assert [found[name][2] for name in POINTS] == [2, 1, 1, 2, 0, 0]
    # 4 m away, with f = 100 px, in an image of 200 x 100.
    np.testing.assert_allclose(found["near"], [100.0, 45.0, 2.0], rtol=0, atol=1e-9)
    assert found["aside"] == found["behind"] == [0.0, 0.0, 0.0]
    wall = RayCaster(Mesh(CUBE * [2.0, 0.1, 2.0] + [0.0, -3.0, 0.0], FACES))
    assert seen(here, ground=wall)["near"][2] == 1


def test_a_keypoint_moves_with_the_part_of_the_nearest_surface(tmp_path):
    shape = next(shape for shape in small_assets().vehicles.values() if len(shape.part_names) == 3)
    points = shape.mesh.vertices[:: max(1, len(shape.mesh.vertices) // 40)]
    marked = shape.with_keypoints({f"p{i}": (point, None) for i, point in enumerate(points)})
    turned = {name: 0.3 for name in shape.part_names[1:]}
    moved = vertices_at(shape, turned)[:: max(1, len(shape.mesh.vertices) // 40)]
    shared = np.abs(marked.articulated_keypoints(turned) - moved).max(axis=1) > 1e-9
    assert shared.mean() < 0.2  # two parts touch there
    save_asset(tmp_path / "v.npz", marked)
    again = load_vehicle(tmp_path / "v.npz")
    assert again.keypoint_names == marked.keypoint_names
    assert np.array_equal(again.articulated_keypoints(turned), marked.articulated_keypoints(turned))


def test_names_and_skeletons_of_categories(tmp_path):
    shapes = [CUBE_WITH_POINTS, SHAPE.with_keypoints({"muzzle": ([1, 0, 0], 0), "turret": ([0, 0, 1], 0)})]
    found = category_keypoint_fields(shapes, ["muzzle", "turret", "[n]ear*"], None, path=tmp_path)
    assert found == {"keypoints": ["near", "muzzle", "turret"], "skeleton": []}
    assert category_keypoint_fields(shapes, ["*"], [("far", "near")], path=tmp_path)["skeleton"] == [[2, 1]]
    assert category_keypoint_fields(shapes, None, None, path=tmp_path) == {}
    with pytest.raises(ConfigError, match=r"'wheel_.' matches no keypoint of a vehicle; there are: 'near'"):
        category_keypoint_fields(shapes, ["wheel_*"], None, path=tmp_path)
    with pytest.raises(ConfigError, match="'far' is no keypoint; these are: 'near'"):
        category_keypoint_fields(shapes, ["near"], [("far", "near")], path=tmp_path)


NAMES = ["muzzle", "wheel_left", "wheel_right"]


def record(*points):
    flat = [float(n) for point in points for n in point]
    return {"category": "tank", "bbox": [1, 2, 20, 10], "keypoints": flat, "num_keypoints": sum(n > 0 for n in flat[2::3])}


@pytest.fixture
def dataset(tmp_path):
    with CocoDataset.open(tmp_path / "d") as dataset:
        dataset.add_categories([{"name": "tank", "keypoints": NAMES, "skeleton": [[1, 2]]}])
        for i in range(4):
            labels = [record((3 + i, 4, 2), (0, 0, 0), (9, 9.5, 1))] if i else []
            append(dataset, f"{i}.png", Image.new("RGB", (64, 48)), labels)
    return tmp_path / "d"


def test_pycocotools_evaluates_them(dataset, tmp_path, capsys):
    assert list(verify_dataset(dataset, fast=True)) == []
    export_dataset(dataset, tmp_path / "out", fractions=(1.0, 0.0, 0.0))
    truth = COCO(str(tmp_path / "out/train/_annotations.coco.json"))
    found = [{**each, "score": 0.9} for each in truth.dataset["annotations"]]
    evaluation = COCOeval(truth, truth.loadRes(found), "keypoints")
    evaluation.params.kpt_oks_sigmas = np.full(len(NAMES), 0.05)
    evaluation.evaluate()
    evaluation.accumulate()
    evaluation.summarize()
    assert evaluation.stats[0] == 1.0


def test_yolo_pose_has_ultralytics_format(dataset, tmp_path):
    export_dataset(dataset, tmp_path / "out", layout="yolo-pose", fractions=(1.0, 0.0, 0.0))
    data = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert (data["kpt_shape"], data["flip_idx"], data["names"]) == ([3, 3], [0, 2, 1], {0: "tank"})
    numbers = np.array((tmp_path / "out/labels/train/2.txt").read_text().split(), dtype=float)
    np.testing.assert_allclose(numbers[:5] * [1, 64, 48, 64, 48], [0, 11, 7, 20, 10], atol=1e-6)
    points = numbers[5:].reshape(3, 3) * [64, 48, 1]
    np.testing.assert_allclose(points, [[5, 4, 2], [0, 0, 0], [9, 9.5, 1]], atol=1e-6)
    assert (tmp_path / "out/labels/train/0.txt").read_text() == ""


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"keypoints": [1.0, 2.0, 2]}, "keypoints has 3 numbers, its category has 3 keypoints"),
        ({"keypoints": [1.0, 2.0, 3, 0, 0, 0, 0, 0, 0]}, "'muzzle' has the visibility 3"),
        ({"keypoints": [65.0, 2.0, 2, 0, 0, 0, 0, 0, 0], "num_keypoints": 1}, "'muzzle' is outside"),
        ({"num_keypoints": 3}, "num_keypoints is 3"),
        ({"keypoints": "many"}, "keypoints is 'many'"),
    ],
)
def test_verify_finds_invalid_keypoints(dataset, change, problem):
    edit(dataset, lambda coco: coco["annotations"][0].update(change))
    assert any(problem in finding.problem for finding in verify_dataset(dataset, fast=True))


@pytest.mark.parametrize("name", [None, 5, ""])
def test_verify_checks_keypoints_of_a_category_without_a_usable_name(dataset, name):
    edit(dataset, lambda coco: coco["categories"][0].update(name=name))
    edit(dataset, lambda coco: coco["annotations"][0].update(num_keypoints=3))
    problems = [finding.problem for finding in verify_dataset(dataset, fast=True)]
    assert any(problem.startswith("name is") for problem in problems)
    assert "num_keypoints is 3" in problems


def test_other_keypoints_of_a_category_are_refused(dataset, tmp_path):
    with CocoDataset.open(dataset) as again, pytest.raises(DatasetError, match="'tank' has the keypoints"):
        again.add_categories([{"name": "tank", "keypoints": ["muzzle"]}], keypoints=True)
    with CocoDataset.open(tmp_path / "plain", categories=["tank"]):
        pass
    with CocoDataset.open(tmp_path / "plain") as plain, pytest.raises(DatasetError, match="'tank' has no keypoints"):
        plain.add_categories([{"name": "tank", "keypoints": ["muzzle"]}], keypoints=True)
    with pytest.raises(DatasetError, match="its categories have no keypoints"):
        export_dataset(tmp_path / "plain", tmp_path / "out", layout="yolo-pose")


def test_empties_mark_points_of_their_parents_part():
    hull, roof, gun = (link(name, at=(x, 0, 0)) for name, x in (("hull", 0.5), ("roof", 1.5), ("barrel", 2.0)))
    root, turret = link("root", kind="EMPTY"), link("Turret node", kind="EMPTY", at=(1, 0, 0))
    chains = [(hull, root), (roof, turret, root), (gun, turret, root)]
    above = {
        ("kp_muzzle", 5.0): (gun, turret, root),
        ("Keypoint-hatch", 6.0): (roof, turret, root),
        ("KP_free", 7.0): (root,),
        ("kp_muzzle", 8.0): (),
        ("keypoint", 9.0): (),
        ("pivot", 9.0): (root,),
    }
    markers = [(link(name, kind="EMPTY", at=(x, 0, 0)), *chain) for (name, x), chain in above.items()]
    found = keypoints_from_empties(markers, chains, [0, 1, 2])
    assert {name: (at[0], part) for name, (at, part) in found.items()} == {
        "muzzle": (5.0, 2),
        "hatch": (6.0, 1),
        "free": (7.0, None),
        "keypoint": (9.0, None),
    }
