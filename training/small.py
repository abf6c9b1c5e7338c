"""A small detector that learns from random weights on a CPU in minutes: FCOS of torchvision on a light trunk.

It is what tests, demos and studies use where there are neither weights to start from nor a GPU.

References
----------
Tian, Shen, Chen, He, FCOS: fully convolutional one-stage object detection, ICCV 2019. Lin et al., Feature pyramid
networks for object detection, CVPR 2017.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn
from torchvision.models.detection import FCOS
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.fcos import FCOSHead
from torchvision.models.resnet import BasicBlock, conv1x1
from torchvision.ops import FeaturePyramidNetwork

from training.detector import Detections, DetectorError, read_weights

RESOLUTION = 256  # pixels of the longer side
ASPECT = 9 / 16
STEP = 16  # pixels: sides are multiples of it
WIDTHS = (16, 32, 64, 128)  # channels at strides 2, 4, 8, 16
NECK = 64  # channels of the pyramid and the head
STRIDES = (4, 8, 16)
MIN_SCORE = 0.01


def small_size(resolution: int = RESOLUTION) -> tuple[int, int]:
    """Width and height that the network sees.

    Examples
    --------
    >>> small_size()
    (256, 144)
    """
    return resolution, max(STEP, round(resolution * ASPECT / STEP) * STEP)


class Trunk(nn.Module):
    """Residual blocks and a feature pyramid at strides 4, 8 and 16."""

    def __init__(self) -> None:
        super().__init__()
        first, *rest = WIDTHS
        self.stem = nn.Sequential(nn.Conv2d(3, first, 3, 2, 1, bias=False), nn.BatchNorm2d(first), nn.ReLU())
        self.stages = nn.ModuleList(_stage(before, after) for before, after in zip(WIDTHS[:-1], rest, strict=True))
        self.pyramid = FeaturePyramidNetwork(rest, NECK)
        self.out_channels = NECK

    def forward(self, pictures: Tensor) -> OrderedDict[str, Tensor]:
        """(n, 3, h, w) pictures to maps of `NECK` channels, finest first."""
        found = self.stem(pictures)
        maps: OrderedDict[str, Tensor] = OrderedDict()
        for stride, stage in zip(STRIDES, self.stages, strict=True):
            found = stage(found)
            maps[str(stride)] = found
        return self.pyramid(maps)


def _stage(before: int, after: int) -> nn.Module:
    shortcut = nn.Sequential(conv1x1(before, after, 2), nn.BatchNorm2d(after))
    return nn.Sequential(BasicBlock(before, after, 2, shortcut), BasicBlock(after, after))


def small_network(classes: int, size: tuple[int, int]) -> FCOS:
    """The network with random weights, for pictures that it squeezes to (width, height)."""
    return FCOS(
        Trunk(),
        num_classes=classes,
        anchor_generator=AnchorGenerator(tuple((stride,) for stride in STRIDES), ((1.0,),) * len(STRIDES)),
        head=FCOSHead(NECK, 1, classes, num_convs=2),
        score_thresh=MIN_SCORE,
        fixed_size=size,
        min_size=min(size),
        max_size=max(size),
        size_divisible=STEP,
    )


class SmallDetector:
    """The small network as a detector; see `training.detector.Detector`."""

    def __init__(self, network: FCOS, classes: tuple[str, ...], device: torch.device) -> None:
        self.classes = classes
        self._network = network.to(device, memory_format=torch.channels_last).eval()
        self._device = device

    @torch.inference_mode()
    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """What is in each of some RGB pictures."""
        if not images:
            return []
        pictures = [torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))) for image in images]
        found = self._network([picture.to(self._device).float() / 255 for picture in pictures])
        return [_detections(one) for one in found]


def _detections(found: dict[str, Tensor]) -> Detections:
    score, order = found["scores"].sort(descending=True, stable=True)
    corners = found["boxes"][order].cpu().double().numpy()
    return Detections(
        np.concatenate((corners[:, :2], corners[:, 2:] - corners[:, :2]), axis=1),
        score.cpu().double().numpy(),
        found["labels"][order].cpu().numpy(),
    )


def save_small(network: FCOS, classes: Sequence[str], size: tuple[int, int]) -> dict[str, object]:
    """What a weights file holds."""
    state = {key: value.detach().cpu() for key, value in network.state_dict().items()}
    return {"hulldown": "small", "classes": list(classes), "size": list(size), "model": state}


def load_small(path: Path, *, device: torch.device) -> SmallDetector:
    """The detector of a weights file.

    Raises
    ------
    DetectorError
        If it holds none.
    """
    found = read_weights(path)
    if found.get("hulldown") != "small":
        raise DetectorError("holds no small model of hulldown", path=path, remedy="name another")
    width, height = found["size"]
    network = small_network(len(found["classes"]), (width, height))
    network.load_state_dict(found["model"])
    return SmallDetector(network, tuple(found["classes"]), device)
