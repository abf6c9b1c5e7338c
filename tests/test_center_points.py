import numpy as np
import pytest
import torch

from hulldown.tests.training_pictures import make_dataset
from hulldown.training.augment import TABLE
from hulldown.training.detectors.center_points import (
    STRIDE,
    CenterMaps,
    CenterNetwork,
    Truth,
    center_bumps,
    center_loss,
    encoded,
    peaks,
    truth_of,
)
from hulldown.training.train import train

pytestmark = pytest.mark.usefixtures("one_thread")
HEIGHT, WIDTH = 12, 20  # cells
XYXY = torch.tensor([[3.0, 5.0, 40.0, 31.0], [90.0, 40.0, 131.0, 77.0], [100.0, 2.0, 109.0, 12.0]])
TRUTH = Truth(torch.tensor([0, 0, 1]), XYXY, torch.tensor([1, 0, 1]))


@pytest.fixture(scope="module")
def one_thread():
    """Limit PyTorch to one thread, since several are slower on small pictures."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def perfect_maps(truth: Truth, pictures: int, classes: int) -> CenterMaps:
    """Outputs of a network that knows the truth."""
    heat = torch.full((pictures, classes, HEIGHT, WIDTH), -20.0)
    box = torch.zeros(pictures, 4, HEIGHT, WIDTH)
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    bumps = center_bumps(truth.xyxy, HEIGHT, WIDTH)
    for owner, xyxy, label, bump in zip(truth.owner, truth.xyxy, truth.label, bumps, strict=True):
        near = bump > 0.1
        heat[owner, label, near] = -4.0
        heat[owner, label, bump == 1] = 20.0
        box[owner][:, near] = encoded(xyxy.expand(int(near.sum()), 4), row[near], column[near]).T
    return CenterMaps(heat, box)


def test_a_bump_is_1_only_in_the_cell_of_its_center():
    bumps = center_bumps(XYXY, HEIGHT, WIDTH)
    middle = ((XYXY[:, :2] + XYXY[:, 2:]) / 2 / STRIDE).long()
    assert torch.nonzero(bumps == 1).tolist() == [[i, y, x] for i, (x, y) in enumerate(middle.tolist())]
    assert bumps.max() == 1


def test_peaks_of_perfect_maps_are_the_truth():
    found = peaks(perfect_maps(TRUTH, 2, 3), 4)
    assert (found.score > 0.5).sum(dim=1).tolist() == [2, 1]
    assert (found.score > 0.01).sum(dim=1).tolist() == [2, 1]  # no peaks in neighboring cells
    for picture in (0, 1):
        own = TRUTH.owner == picture
        order = [int((found.xyxy[picture, :2] - box).abs().sum(dim=1).argmin()) for box in XYXY[own]]
        torch.testing.assert_close(found.xyxy[picture, order], XYXY[own])
        assert found.label[picture, order].tolist() == TRUTH.label[own].tolist()


def with_heat(maps: CenterMaps, value: float, picture: int, label: int, row: int, column: int) -> CenterMaps:
    heat = maps.heat.clone()
    heat[picture, label, row, column] = value
    return CenterMaps(heat, maps.box)


def test_the_loss_is_0_for_the_truth_and_positive_for_each_mistake():
    maps = perfect_maps(TRUTH, 2, 3)
    row, column = 0, 13  # the cell of the third object's center
    assert center_loss(maps, TRUTH) < 0.02
    assert center_loss(with_heat(maps, -20.0, 1, 1, row, column), TRUTH) > 5  # missed
    assert center_loss(with_heat(maps, 20.0, 1, 2, 9, 2), TRUTH) > 5  # a false positive
    assert center_loss(CenterMaps(maps.heat, maps.box + 0.3), TRUTH) > 0.5
    assert center_loss(with_heat(maps, 0.0, 0, 1, 2, 3), TRUTH) < center_loss(with_heat(maps, 0.0, 0, 1, 9, 3), TRUTH)


def test_cells_near_a_center_learn_its_class():
    maps = perfect_maps(TRUTH, 2, 3)
    beside = with_heat(maps, -2.0, 0, 2, 2, 3)  # where another class has -4, too little for the focal loss
    assert center_loss(beside, TRUTH) > center_loss(maps, TRUTH) + 0.05
    assert center_loss(with_heat(maps, -2.0, 0, 2, 9, 3), TRUTH) < center_loss(maps, TRUTH) + 0.01  # far from it


def test_pictures_without_objects_have_a_loss_and_gradients():
    network = CenterNetwork(2)
    truth = truth_of([torch.zeros(0, 4)] * 2, [torch.zeros(0, dtype=torch.int64)] * 2)
    loss = center_loss(network(torch.zeros(2, 3, 32, 64, dtype=torch.uint8)), truth)
    loss.backward()
    assert torch.isfinite(loss)
    assert float(network.heat.weight.grad.abs().sum()) > 0


@pytest.mark.parametrize(("width", "height"), [(64, 32), (80, 48), (256, 144)])
def test_maps_cover_the_picture(width, height):
    maps = CenterNetwork(3)(torch.zeros(2, 3, height, width, dtype=torch.uint8))
    assert maps.heat.shape == (2, 3, height // STRIDE, width // STRIDE)
    assert maps.box.shape == (2, 4, height // STRIDE, width // STRIDE)


def test_it_can_memorize_a_few_pictures(tmp_path):
    pictures = make_dataset(tmp_path / "set", 8)
    still = {name: {"probability": 0.0} for name in TABLE}
    keys = {"model": "small", "resolution": 96, "budget": 480, "batch": 8, "augmentation": still}
    run = train({"demo": pictures}, tmp_path / "run", settings=keys, valid=pictures, workers=0, device="cpu")
    assert run["figures"]["valid"]["ap50"] == pytest.approx(1.0)
    losses = np.loadtxt(tmp_path / "run" / "metrics.csv", delimiter=",", skiprows=1)[:, 1]
    assert losses[-5:].mean() < losses[:5].mean() / 5
