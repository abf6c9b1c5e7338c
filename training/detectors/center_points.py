"""A network that finds objects as points: maps of each class's center probability, and of boxes.

It's small enough to learn from random weights on a CPU. Objects are peaks of its maps, so there is no matching of
anchors and no suppression of boxes. Targets are as wide as their boxes, and every cell near a center learns box and
class, which takes fewer steps than the center's cell alone.

References
----------
Zhou, Wang, Krähenbühl, Objects as points, 2019. Liu, Zheng, Xu, Yang, Liu, Cai, Training-time-friendly network for
real-time object detection, AAAI 2020: targets of a box's width and height, boxes learnt near centers. Lin et al.,
Feature pyramid networks for object detection, CVPR 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional
from torchvision.models import shufflenet_v2_x1_0
from torchvision.ops import Conv2dNormActivation

STRIDE = 8  # pixels between cells of the maps, that of the first stage
WIDTHS = (116, 232, 464)  # channels of the backbone's stages, at strides 8, 16, 32
NECK = 64  # channels on the way back to the maps; the head has twice as many
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colors, from 0 to 1
RARE = 0.01  # initial probability of a center in a cell
USUAL = (32.0, 16.0)  # pixels: initial width and height of a box
SPREAD = 0.15  # standard deviation of a target as a share of its box's sides
LEAST_SPREAD = 0.4  # cells
AXIS_WEIGHTS = (0.5, 0.5, 1.0, 1.0)  # of errors of x, y, width and height
NEAR_BOX, NEAR_CLASS = 0.5, 0.3  # height of a target from which cells learn its box and class


class CenterMaps(NamedTuple):
    """The network's output for n pictures, in cells of `STRIDE` pixels."""

    heat: Float[Tensor, "n c h w"]
    # from the cell's middle to the box's, x and y in cells; logarithms of width and height over `USUAL`
    box: Float[Tensor, "n 4 h w"]


class CenterNetwork(nn.Module):
    """ShuffleNet down to stride 32, a pyramid back to the maps' stride, and the maps of each class."""

    def __init__(self, classes: int, *, frozen: bool = False) -> None:
        super().__init__()
        self.backbone, self.frozen = Backbone().requires_grad_(not frozen), frozen
        self.across = nn.ModuleList(nn.Conv2d(width, NECK, 1) for width in WIDTHS)
        self.merged = nn.ModuleList(Conv2dNormActivation(NECK, NECK) for _ in WIDTHS[:-1])
        self.head = Conv2dNormActivation(NECK, 2 * NECK)
        self.heat, self.box = nn.Conv2d(2 * NECK, classes, 1), nn.Conv2d(2 * NECK, 4, 1)
        nn.init.constant_(self.heat.bias, float(torch.logit(torch.tensor(RARE))))
        nn.init.zeros_(self.box.weight)
        nn.init.zeros_(self.box.bias)
        for name, values in (("mean", MEAN), ("deviation", DEVIATION)):
            self.register_buffer(name, 255 * torch.tensor(values).view(1, 3, 1, 1), persistent=False)
        self.train()  # Lightning doesn't call it

    def train(self, mode: bool = True) -> Self:
        """Switch between training and use; a frozen backbone stays in use."""
        super().train(mode)
        if self.frozen:
            self.backbone.eval()
        return self

    def forward(self, pictures: UInt8[Tensor, "n 3 h w"]) -> CenterMaps:
        """Return maps of RGB pictures."""
        x = ((pictures.float() - self.mean) / self.deviation).contiguous(memory_format=torch.channels_last)
        levels = self.backbone(x)
        found = self.across[-1](levels[-1])
        finer = zip(levels[:-1], self.across[:-1], self.merged, strict=True)
        for level, across, merged in reversed(list(finer)):
            height, width = level.shape[-2:]
            found = merged(across(level) + functional.interpolate(found, scale_factor=2.0)[..., :height, :width])
        found = self.head(found)
        return CenterMaps(self.heat(found).float(), self.box(found).float())


class Backbone(nn.Module):
    """Torchvision's `shufflenet_v2_x1_0` without its last convolution and classifier, under the same names.

    References
    ----------
    Ma, Zhang, Zheng, Sun, ShuffleNet V2: practical guidelines for efficient CNN architecture design, ECCV 2018.
    """

    def __init__(self) -> None:
        super().__init__()
        whole = shufflenet_v2_x1_0()
        self.conv1, self.maxpool = whole.conv1, whole.maxpool
        self.stage2, self.stage3, self.stage4 = whole.stage2, whole.stage3, whole.stage4

    def forward(self, x: Float[Tensor, "n 3 h w"]) -> list[Tensor]:
        """Return features at strides 8, 16, and 32."""
        x = self.maxpool(self.conv1(x))
        found = []
        for stage in (self.stage2, self.stage3, self.stage4):
            x = stage(x)
            found.append(x)
        return found


def center_bumps(xyxy: Float[Tensor, "k 4"], height: int, width: int) -> Float[Tensor, "k h w"]:
    """Target maps: for each object a Gaussian of its box's size around its center, 1 in the center's cell."""
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / (2 * STRIDE)
    spread = ((xyxy[:, 2:] - xyxy[:, :2]) * (SPREAD / STRIDE)).clamp(min=LEAST_SPREAD)

    def along(axis: int, cells: int) -> Tensor:
        cell = middle[:, axis].long().clamp(0, cells - 1)
        away = torch.arange(cells, device=xyxy.device)[None] - cell[:, None]
        return torch.exp(-0.5 * (away / spread[:, axis, None]) ** 2)

    return along(1, height)[:, :, None] * along(0, width)[:, None, :]


def center_loss(maps: CenterMaps, xyxy: Sequence[Float[Tensor, "_ 4"]], labels: Sequence[Int[Tensor, " _"]]) -> Tensor:
    """Return the focal loss of centers and, over cells near each, the loss of boxes and cross-entropy of classes.

    The focal loss treats each class separately and mostly teaches whether there is an object: a small network finds
    objects long before it distinguishes classes.

    `xyxy`, `labels`: corners in pixels, and classes, of the objects in each.
    """
    height, width = maps.heat.shape[-2:]
    picture = torch.tensor([i for i, own in enumerate(labels) for _ in own], dtype=torch.int64, device=maps.heat.device)
    boxes, label = torch.cat(list(xyxy)), torch.cat(list(labels))
    bumps = center_bumps(boxes, height, width)
    target = torch.zeros_like(maps.heat)
    for at, bump in zip(zip(picture.tolist(), label.tolist(), strict=True), bumps, strict=True):
        target[at] = torch.maximum(target[at], bump)
    heat = _focal(maps.heat, target) / max(1, len(bumps))
    if not len(bumps):
        return heat
    which, row, column, weight = _near(bumps, NEAR_BOX)
    wanted = encoded(boxes[which], row, column)
    away = (maps.box[picture[which], :, row, column] - wanted).abs() * wanted.new_tensor(AXIS_WEIGHTS)
    box = (away.sum(dim=1) * weight).sum()
    which, row, column, weight = _near(bumps, NEAR_CLASS)
    logits = maps.heat[picture[which], :, row, column]
    between = (functional.cross_entropy(logits, label[which], reduction="none") * weight).sum()
    return heat + box + between


def _near(bumps: Tensor, least: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Object, row, column, and weight of each cell near a center; each object has the same total weight."""
    which, row, column = torch.where(bumps > least)
    weight = bumps[which, row, column]
    sums = torch.zeros(len(bumps), device=weight.device).index_add_(0, which, weight)
    return which, row, column, weight / (sums[which] * len(bumps))


def _focal(logits: Tensor, target: Tensor) -> Tensor:
    """Zhou et al., equation 1, summed; cells near a center count less."""
    score = logits.sigmoid()
    there = (1 - score) ** 2 * functional.logsigmoid(logits)
    nothing = (1 - target) ** 4 * score**2 * functional.logsigmoid(-logits)
    return -torch.where(target == 1, there, nothing).sum()


def encoded(xyxy: Float[Tensor, "k 4"], row: Int[Tensor, " k"], column: Int[Tensor, " k"]) -> Float[Tensor, "k 4"]:
    """Encode boxes with corners in pixels for cells; the inverse of `corners`."""
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / (2 * STRIDE)
    sides = xyxy[:, 2:] - xyxy[:, :2]
    return torch.cat((middle - torch.stack((column, row), dim=1) - 0.5, (sides / sides.new_tensor(USUAL)).log()), dim=1)


def corners(box: Float[Tensor, "k 4"], row: Int[Tensor, " k"], column: Int[Tensor, " k"]) -> Float[Tensor, "k 4"]:
    """Decode corners in pixels from cells' boxes."""
    middle = STRIDE * (torch.stack((column, row), dim=1) + 0.5 + box[:, :2])
    half = box[:, 2:].clamp(-3.0, 3.0).exp() * box.new_tensor(USUAL) / 2
    return torch.cat((middle - half, middle + half), dim=1)


def peaks(maps: CenterMaps, count: int) -> tuple[Float[Tensor, "n k 4"], Float[Tensor, "n k"], Int[Tensor, "n k"]]:
    """Return each picture's k most likely objects by falling score: cells as likely as all of their neighbors."""
    scores = maps.heat.sigmoid()
    highest = functional.max_pool2d(scores, 3, 1, 1)
    n, _, height, width = scores.shape
    flat = torch.where(scores == highest, scores, 0.0).flatten(1)
    score, place = flat.topk(min(count, flat.shape[1]))
    label, cell = place // (height * width), place % (height * width)
    row, column = cell // width, cell % width
    picture = torch.arange(n, device=row.device).repeat_interleave(row.shape[1])
    boxes = maps.box[picture, :, row.flatten(), column.flatten()]
    return corners(boxes, row.flatten(), column.flatten()).view(n, -1, 4), score, label
