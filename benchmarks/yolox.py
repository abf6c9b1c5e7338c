"""YOLOX-nano, pretrained on COCO, from its ONNX file as a detector that can be trained.

References
----------
Ge, Liu, Wang, Li, Sun, YOLOX: exceeding YOLO series in 2021, arXiv 2107.08430. Its weights: Apache-2.0.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from rfdetr.assets.coco_classes import COCO_CLASSES
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchvision.ops import batched_nms, box_convert, box_iou, clip_boxes_to_image, generalized_box_iou_loss

from hulldown.training.detectors.detector import Detections
from hulldown.training.inputs.data import DrawnExamples, pictures_at_network_size

COCO_NAMES = tuple(COCO_CLASSES[label] for label in sorted(COCO_CLASSES))  # the 80 classes in the order of the weights
INPUT_SIZE_PX = (320, 256)  # width and height of the input, pixels
STRIDES_PX = (8, 16, 32)
HEAD_NAMES = ("reg", "obj", "cls")
MIN_SCORE, MAX_KEPT_IOU, MAX_CLASS_DETECTIONS = 0.005, 0.6, 100  # of a class in a picture
BATCH_PICTURES, LEARNING_RATE, WEIGHT_DECAY, MAX_GRADIENT_NORM, AVERAGING_DECAY = 8, 5e-5, 0.01, 10.0, 0.97
BOX_WEIGHT, CORNER_WEIGHT = 5.0, 0.5
CENTER_REACH_STRIDES = 2.5  # strides from an object's center within which its cells are
FAR_CELL_COST = 1e5  # cost of a cell out of an object or of its center's reach


class Yolox(nn.Module):
    """The network; `rows`: for each class, the class of COCO whose weights it starts from."""

    def __init__(self, path: Path, rows: Sequence[int]) -> None:
        super().__init__()
        graph = onnx.load(str(path)).graph
        arrays = {one.name: torch.from_numpy(numpy_helper.to_array(one).copy()) for one in graph.initializer}
        self.weights = nn.ParameterList()
        self._steps: list[tuple[str, list[str], str, dict, int]] = []
        sigmoids: dict[str, str] = {}
        known: set[str] = set()
        for node in graph.node:
            given, result, kind = list(node.input), node.output[0], node.op_type
            keys = {one.name: helper.get_attribute_value(one) for one in node.attribute}
            if kind == "Concat" and not known:
                self._first = result  # of slices: every second row and column
            elif kind == "Sigmoid":
                sigmoids[result] = given[0]
                continue
            elif kind == "Conv":
                if given[1].startswith("head.") and "_preds." in given[1]:
                    result = given[1].removeprefix("head.").removesuffix(".weight")
                kept = list(rows) if result.startswith("cls_preds") else slice(None)
                self._steps.append((kind, given[:1], result, keys, len(self.weights)))
                self.weights.extend(nn.Parameter(arrays[name][kept].float()) for name in given[1:3])
            elif kind == "Mul" and sigmoids.get(given[1]) == given[0]:
                self._steps.append(("Silu", given[:1], result, keys, 0))
            elif kind == "Resize" and given[0] in known:
                self._steps.append((kind, given[:1], result, keys, 0))
            elif kind in ("Add", "Concat", "MaxPool") and known.issuperset(given):
                self._steps.append((kind, given, result, keys, 0))
            else:
                continue
            known.add(result)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return boxes xyxy (n, cells, 4), logits of an object and of each class (n, cells, 1 + classes), and cells.

        `pictures`: (n, 3, h, w) RGB, 0 to 255. A cell is x, y of its corner and its stride, pixels.
        """
        blue_first = pictures.float().flip(1)
        quarters = [blue_first[..., y::2, x::2] for x in (0, 1) for y in (0, 1)]
        values = {self._first: torch.cat(quarters, 1).contiguous(memory_format=torch.channels_last)}
        for kind, given, result, keys, at in self._steps:
            x = [values[name] for name in given]
            values[result] = self._run(kind, x, keys, at)
        boxes, logits, cells = [], [], []
        for k, stride in enumerate(STRIDES_PX):
            reg, obj, cls = (values[f"{head}_preds.{k}"].flatten(2).transpose(1, 2) for head in HEAD_NAMES)
            height, width = values[f"obj_preds.{k}"].shape[2:]
            y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
            corner = torch.stack([x.flatten(), y.flatten()], 1) * float(stride)
            boxes.append(torch.cat([reg[..., :2] * stride + corner, reg[..., 2:].clamp(max=8.0).exp() * stride], 2))
            logits.append(torch.cat([obj, cls], 2))
            cells.append(F.pad(corner, (0, 1), value=float(stride)))
        return box_convert(torch.cat(boxes, 1), "cxcywh", "xyxy"), torch.cat(logits, 1), torch.cat(cells)

    def _run(self, kind: str, x: list[Tensor], keys: dict, at: int) -> Tensor:
        if kind == "Conv":
            weight, bias = self.weights[at], self.weights[at + 1]
            return F.conv2d(x[0], weight, bias, keys["strides"], keys["pads"][:2], keys["dilations"], keys["group"])
        if kind == "Silu":
            return F.silu(x[0])
        if kind == "Add":
            return x[0] + x[1]
        if kind == "Concat":
            return torch.cat(x, keys["axis"])
        if kind == "MaxPool":
            return F.max_pool2d(x[0], keys["kernel_shape"], keys["strides"], keys["pads"][:2])
        return F.interpolate(x[0], scale_factor=2.0, mode="nearest")


class YoloxDetector:
    """The network as a detector; see `training.detectors.detector.Detector`."""

    def __init__(self, network: nn.Module, classes: Sequence[str]) -> None:
        self.classes, self._network = tuple(classes), network.eval()

    @torch.inference_mode()
    def detect(self, images: Sequence[np.ndarray]) -> list[Detections]:
        found = []
        boxes, logits, _ = self._network(pictures_at_network_size(images, INPUT_SIZE_PX))
        for image, corners, scores in zip(images, boxes, log_scores(logits).exp(), strict=True):
            height, width = image.shape[:2]
            cell, label = (scores > MIN_SCORE).nonzero(as_tuple=True)
            scale = torch.tensor([width / INPUT_SIZE_PX[0], height / INPUT_SIZE_PX[1]] * 2)
            inside = clip_boxes_to_image(corners[cell] * scale, (height, width))
            kept = batched_nms(inside, scores[cell, label], label, MAX_KEPT_IOU)
            kept = kept[(label[kept, None] == label[kept]).tril().sum(1) <= MAX_CLASS_DETECTIONS]
            xywh = box_convert(inside[kept], "xyxy", "xywh").double().numpy()
            found.append(Detections(xywh, scores[cell, label][kept].double().numpy(), label[kept].numpy()))
        return found


def log_scores(logits: Tensor) -> Tensor:
    """Return the logarithm of the score of each class: an object's probability times the class's."""
    return F.logsigmoid(logits[..., :1]) + F.logsigmoid(logits[..., 1:])


@torch.no_grad()
def assign_cells(boxes: Tensor, score: Tensor, cells: Tensor, wanted: Tensor, label: Tensor) -> tuple[Tensor, ...]:
    """Return the cells that learn an object, their objects, and IoUs: SimOTA (paper, section 2.1), for one picture.

    `score`: its logarithm, of each cell and class. `wanted`: xyxy of the objects.
    """
    center, reach = cells[:, :2] + cells[:, 2:] / 2, CENTER_REACH_STRIDES * cells[:, 2:]
    inside = ((center[:, None] > wanted[:, :2]) & (center[:, None] < wanted[:, 2:])).all(2)
    near = ((center[:, None] - (wanted[:, :2] + wanted[:, 2:]) / 2).abs() < reach[:, None]).all(2)
    some = (inside | near).any(1).nonzero()[:, 0]
    overlap = box_iou(boxes[some], wanted)
    cost = FAR_CELL_COST * ~(inside & near)[some] - score[some][:, label] - 3.0 * (overlap + 1e-8).log()
    count = overlap.topk(min(10, len(some)), 0).values.sum(0).int().clamp(min=1)
    taken = cost.argsort(0).argsort(0) < count
    taken &= F.one_hot(cost.where(taken, torch.inf).argmin(1), len(wanted)).bool()  # a cell learns one object
    cell, thing = taken.nonzero(as_tuple=True)
    return some[cell], thing, overlap[cell, thing]


def network_loss(network: nn.Module, pictures: Tensor, wanted: Sequence[Tensor], labels: Sequence[Tensor]) -> Tensor:
    """Return the loss of a batch: of boxes by GIoU and L1, of the score by cross-entropy with the IoU."""
    boxes, logits, cells = network(pictures)
    score = log_scores(logits)
    target, of_boxes, count = torch.zeros_like(score), boxes.sum() * 0.0, 0
    for k, (objects, label) in enumerate(zip(wanted, labels, strict=True)):
        if len(objects):
            cell, thing, overlap = assign_cells(boxes[k], score[k], cells, objects, label)
            target[k, cell, label[thing]] = overlap
            found, true = boxes[k, cell], objects[thing]
            of_boxes = of_boxes + BOX_WEIGHT * generalized_box_iou_loss(found, true, reduction="sum")
            stride = cells[cell, 2:]
            (found, true) = (box_convert(one, "xyxy", "cxcywh") for one in (found, true))
            found, true = (torch.cat([one[:, :2] / stride, (one[:, 2:] / stride).log()], 1) for one in (found, true))
            of_boxes = of_boxes + CORNER_WEIGHT * (found - true).abs().sum()
            count += len(cell)
    nothing = torch.log1p(-score.exp().clamp(max=1.0 - 1e-6))
    return (of_boxes - (target * score + (1.0 - target) * nothing).sum()) / max(count, 1)


def train_yolox(path: Path, examples: DrawnExamples, rows: Sequence[int]) -> nn.Module:
    """Return the averaged network after all draws."""
    network = Yolox(path, rows)
    averaged = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(AVERAGING_DECAY))
    steps = len(examples) // BATCH_PICTURES
    groups = [
        {"params": [one for one in network.parameters() if one.ndim > 1], "weight_decay": WEIGHT_DECAY},
        {"params": [one for one in network.parameters() if one.ndim == 1], "weight_decay": 0.0},
    ]
    optimizer = torch.optim.AdamW(groups, lr=LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, LEARNING_RATE, steps, pct_start=0.1, div_factor=10.0, final_div_factor=2.0, cycle_momentum=False
    )
    for step in range(steps):
        batch = [examples[k] for k in range(step * BATCH_PICTURES, (step + 1) * BATCH_PICTURES)]
        pictures = torch.stack([one.picture for one in batch])
        loss = network_loss(network, pictures, [one.xyxy for one in batch], [one.class_index for one in batch])
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT_NORM)
        optimizer.step()
        schedule.step()
        averaged.update_parameters(network)
    return averaged.module
