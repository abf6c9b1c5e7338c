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
from functools import partial
from pathlib import Path

import numpy as np
import pytorch_lightning as pl
import torch
from jaxtyping import UInt8
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR
from torchvision.models.detection import FCOS
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.fcos import FCOSHead
from torchvision.models.resnet import BasicBlock, conv1x1
from torchvision.ops import FeaturePyramidNetwork

from training.data import Example, network_pictures
from training.detector import Detections, DetectorError, read_weights
from training.settings import Settings, rate_factor

RESOLUTION = 256  # pixels of the longer side
ASPECT = 9 / 16
STEP = 16  # pixels: sides are multiples of it
WIDTHS = (16, 32, 64, 128, 128)  # channels at strides 2, 4, 8, 16, 32
NECK = 64  # channels of the pyramid and the head
STRIDES = (8, 16, 32)  # of the head's maps; one more of stride 4 nearly doubles a step
FIRST_EXTENT = 2.0  # strides from a cell to each side of its box, before anything is learnt
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
    """Residual blocks and a feature pyramid at strides 8, 16 and 32."""

    def __init__(self) -> None:
        super().__init__()
        first, *rest = WIDTHS
        self.stem = nn.Sequential(nn.Conv2d(3, first, 3, 2, 1, bias=False), nn.BatchNorm2d(first), nn.ReLU())
        self.stages = nn.ModuleList(_stage(before, after) for before, after in zip(WIDTHS[:-1], rest, strict=True))
        self.pyramid = FeaturePyramidNetwork(rest[-len(STRIDES) :], NECK)
        self.out_channels = NECK

    def forward(self, pictures: Tensor) -> OrderedDict[str, Tensor]:
        """(n, 3, h, w) pictures to maps of `NECK` channels, finest first."""
        maps = [self.stem(pictures)]
        for stage in self.stages:
            maps.append(stage(maps[-1]))
        return self.pyramid(OrderedDict(zip(map(str, STRIDES), maps[-len(STRIDES) :], strict=True)))


def _stage(before: int, after: int) -> nn.Module:
    shortcut = nn.Sequential(conv1x1(before, after, 2), nn.BatchNorm2d(after))
    return nn.Sequential(BasicBlock(before, after, 2, shortcut), BasicBlock(after, after))


class Head(FCOSHead):
    """FCOS's head, whose loss also asks which class it is, where there is something.

    The focal loss asks each class for itself, and mostly whether there is anything at all: a small network finds
    vehicles long before it tells them apart.
    """

    def compute_loss(
        self,
        targets: list[dict[str, Tensor]],
        head_outputs: dict[str, Tensor],
        anchors: list[Tensor],
        matched_idxs: list[Tensor],
    ) -> dict[str, Tensor]:
        """Losses by name: FCOS's, and the cross-entropy of the classes over the cells that have a box."""
        losses = super().compute_loss(targets, head_outputs, anchors, matched_idxs)
        labels = torch.cat([t["labels"][m[m >= 0]] for t, m in zip(targets, matched_idxs, strict=True)])
        logits = torch.cat([one[m >= 0] for one, m in zip(head_outputs["cls_logits"], matched_idxs, strict=True)])
        between = nn.functional.cross_entropy(logits, labels, reduction="sum") / max(1, len(labels))
        return losses | {"between_classes": between}


def small_network(classes: int, size: tuple[int, int]) -> FCOS:
    """The network with random weights, for pictures that it squeezes to (width, height)."""
    head = Head(NECK, 1, classes, num_convs=2)
    # From torchvision's zero every box begins empty, where half of the ReLUs behind it are dead.
    nn.init.constant_(head.regression_head.bbox_reg.bias, FIRST_EXTENT)
    return FCOS(
        Trunk(),
        num_classes=classes,
        anchor_generator=AnchorGenerator(tuple((stride,) for stride in STRIDES), ((1.0,),) * len(STRIDES)),
        head=head,
        score_thresh=MIN_SCORE,
        fixed_size=size,
        min_size=min(size),
        max_size=max(size),
        size_divisible=STEP,
    )


class SmallDetector:
    """The small network as a detector; see `training.detector.Detector`."""

    def __init__(self, network: FCOS, classes: tuple[str, ...], size: tuple[int, int], device: torch.device) -> None:
        self.classes, self._size = classes, size
        self._network = network.to(device, memory_format=torch.channels_last).eval()
        self._device = device

    @torch.inference_mode()
    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """What is in each of some RGB pictures."""
        if not images:
            return []
        pictures = network_pictures(images, self._size).to(self._device).float() / 255
        scales = [(image.shape[1] / self._size[0], image.shape[0] / self._size[1]) for image in images]
        return [_detections(*one) for one in zip(self._network(list(pictures)), scales, strict=True)]


def _detections(found: dict[str, Tensor], scale: tuple[float, float]) -> Detections:
    score, order = found["scores"].sort(descending=True, stable=True)
    corners = found["boxes"][order].cpu().double().numpy() * (scale * 2)
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
    return SmallDetector(network, tuple(found["classes"]), (width, height), device)


class SmallModule(pl.LightningModule):
    """The small network as Lightning trains it.

    Parameters
    ----------
    network
        To be trained.
    settings
        Completed.
    steps
        Of the whole run.
    """

    def __init__(self, network: FCOS, settings: Settings, steps: int) -> None:
        super().__init__()
        self.network = network.to(memory_format=torch.channels_last)
        self._settings, self._steps = settings, steps

    def transfer_batch_to_device(
        self, batch: list[Example], device: torch.device, dataloader_idx: int
    ) -> list[Example]:
        """Leave it to the step, which is where the pictures become floats."""
        return batch

    def training_step(self, batch: list[Example], batch_idx: int) -> Tensor:
        """The loss of a batch."""
        pictures = [example.picture.to(self.device).float() / 255 for example in batch]
        targets = [{"boxes": e.xyxy.to(self.device), "labels": e.label.to(self.device)} for e in batch]
        return torch.stack(list(self.network(pictures, targets).values())).sum()

    def configure_optimizers(self) -> dict[str, object]:
        """AdamW with the run's schedule."""
        settings = self._settings
        optimizer = torch.optim.AdamW(self.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        rates = LambdaLR(optimizer, partial(rate_factor, settings=settings, steps=self._steps))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": rates, "interval": "step"}}
