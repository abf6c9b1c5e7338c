import numpy as np
import pytest
import torch

from hulldown.tests.test_augment import augmentation
from hulldown.tests.training_pictures import make_dataset
from hulldown.training.detectors.center_points import (
    STRIDE,
    CenterMaps,
    CenterNetwork,
    center_bumps,
    center_loss,
    encoded,
    peaks,
)
from hulldown.training.train import train

pytestmark = pytest.mark.usefixtures("one_thread")
HEIGHT, WIDTH = 12, 20  # cells
XYXY = torch.tensor([[3.0, 5.0, 40.0, 31.0], [90.0, 40.0, 131.0, 77.0]]), torch.tensor([[100.0, 2.0, 109.0, 12.0]])
LABELS = torch.tensor([1, 0]), torch.tensor([1])  # of two pictures


@pytest.fixture(scope="module")
def one_thread():
    """Limit PyTorch to one thread, since several are slower on small pictures."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def maps():
    """Outputs of a network that knows the truth."""
    heat, box = torch.full((2, 3, HEIGHT, WIDTH), -20.0), torch.zeros(2, 4, HEIGHT, WIDTH)
    row, column = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    for picture in (0, 1):
        bumps = center_bumps(XYXY[picture], HEIGHT, WIDTH)
        for xyxy, label, bump in zip(XYXY[picture], LABELS[picture], bumps, strict=True):
            near = bump > 0.1
            heat[picture, label, near] = -4.0
            heat[picture, label, bump == 1] = 20.0
            box[picture][:, near] = encoded(xyxy.expand(int(near.sum()), 4), row[near], column[near]).T
    return CenterMaps(heat, box)


def test_a_bump_is_1_only_in_the_cell_of_its_center():
    xyxy = torch.cat(XYXY)
    bumps = center_bumps(xyxy, HEIGHT, WIDTH)
    middle = ((xyxy[:, :2] + xyxy[:, 2:]) / 2 / STRIDE).long()
    assert torch.nonzero(bumps == 1).tolist() == [[i, y, x] for i, (x, y) in enumerate(middle.tolist())]
    assert bumps.max() == 1


def test_peaks_of_perfect_maps_are_the_truth(maps):
    for xyxy, score, label, true, classes in zip(*peaks(maps, 4), XYXY, LABELS, strict=True):
        # No peaks in neighboring cells.
        assert (score > 0.5).sum() == (score > 0.01).sum() == len(true)
        order = [int((xyxy - box).abs().sum(dim=1).argmin()) for box in true]
        torch.testing.assert_close(xyxy[order], true)
        assert label[order].tolist() == classes.tolist()


def loss(maps: CenterMaps, cell=None, value=0.0) -> float:
    """The loss, with another value in a cell of the centers' map: picture, class, row, column."""
    heat = maps.heat.clone()
    if cell is not None:
        heat[cell] = value
    return float(center_loss(CenterMaps(heat, maps.box), XYXY, LABELS))


def test_the_loss_is_0_for_the_truth_and_positive_for_each_mistake(maps):
    assert loss(maps) < 0.02
    assert loss(maps, (1, 1, 0, 13), -20.0) > 5  # the third object is missed
    assert loss(maps, (1, 2, 9, 2), 20.0) > 5  # a false positive
    assert loss(CenterMaps(maps.heat, maps.box + 0.3)) > 0.5
    assert loss(maps, (0, 1, 2, 3)) < loss(maps, (0, 1, 9, 3))
    # Cells near a center learn its class: another class has -4 there, too little for the focal loss.
    assert loss(maps, (0, 2, 2, 3), -2.0) > loss(maps) + 0.05
    assert loss(maps, (0, 2, 9, 3), -2.0) < loss(maps) + 0.01  # far from it


def test_a_center_counts_although_the_next_object_overlaps_it(maps):
    one = XYXY[0][0]
    both, labels = torch.stack((one, one + 8)), torch.tensor([1, 1])
    missed = CenterMaps(torch.full_like(maps.heat[:1], -20.0), maps.box[:1])
    assert center_loss(missed, [both], [labels]) > 15  # nearly 20 for each, over their number


def test_pictures_without_objects_have_a_loss_and_gradients():
    network = CenterNetwork(2)
    nothing = [torch.zeros(0, 4)] * 2, [torch.zeros(0, dtype=torch.int64)] * 2
    found = center_loss(network(torch.zeros(2, 3, 32, 64, dtype=torch.uint8)), *nothing)
    found.backward()
    assert torch.isfinite(found)
    assert float(network.heat.weight.grad.abs().sum()) > 0


@pytest.mark.parametrize(("width", "height"), [(64, 32), (80, 48), (256, 144)])
def test_maps_cover_the_picture(width, height):
    maps = CenterNetwork(3)(torch.zeros(2, 3, height, width, dtype=torch.uint8))
    assert maps.heat.shape == (2, 3, height // STRIDE, width // STRIDE)
    assert maps.box.shape == (2, 4, height // STRIDE, width // STRIDE)


def test_it_can_memorize_a_few_pictures(tmp_path):
    pictures = make_dataset(tmp_path / "set", 8)
    keys = {
        "model": "small",
        "weights": "none",
        "resolution": 96,
        "budget": 320,
        "batch": 8,
        "learning_rate": 4e-3,
        "augmentation": augmentation(),
    }
    run = train({"demo": pictures}, tmp_path / "run", settings=keys, valid=pictures, workers=0, device="cpu")
    assert run.figures.valid["ap50"] == pytest.approx(1.0)
    losses = np.loadtxt(tmp_path / "run" / "metrics.csv", delimiter=",", skiprows=1)[:, 1]
    assert losses[-5:].mean() < losses[:5].mean() / 5
