"""Draws as pictures and boxes for a network: draw k has the same pixels in any process."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch.utils.data import Dataset, Sampler

from hulldown.base.errors import HulldownError
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.draws import Draws
from hulldown.training.inputs.sources import LabeledPictures, Sample

KEPT_BYTES = 256 * 2**20  # bytes of pictures that each worker keeps in memory


@dataclass(frozen=True, eq=False, slots=True)
class Example:
    """A picture at the network's size, with its labels."""

    picture: UInt8[torch.Tensor, "3 h w"]
    xyxy: Float[torch.Tensor, "n 4"]  # corners of boxes, pixels
    class_index: Int[torch.Tensor, " n"]


class DrawnExamples(Dataset[Example | HulldownError]):
    """A PyTorch dataset of augmented draws at the network's size."""

    def __init__(
        self,
        sources: Sequence[LabeledPictures],
        draws: Draws,
        size: tuple[int, int],
        augmentation: Mapping[str, object],
        *,
        masks: bool,
    ) -> None:
        self.sources, self.draws, self.size, self.masks = sources, draws, size, masks
        self.augment = Augmenter(augmentation)
        self._kept: dict[tuple[int, int], Sample] = {}
        self._room = KEPT_BYTES

    def __len__(self) -> int:
        return len(self.draws)

    def __getitem__(self, k: int) -> Example | HulldownError:
        """Return draw k, or why it can't be read: PyTorch's loader would add its traceback to an exception."""
        cv2.setNumThreads(0)  # its threads compete with the loader's workers and the network
        try:
            return make_example(self.augment(self._sample(k), int(self.draws.seed[k])), self.size)
        except HulldownError as error:
            return error

    def _sample(self, k: int) -> Sample:
        """Return the sample of draw k before augmentation. Small datasets are kept in memory, since reading is slow."""
        key = int(self.draws.source[k]), int(self.draws.image[k])
        if key in self._kept:
            return self._kept[key]
        sample = at_work_size(self.sources[key[0]].sample(key[1], masks=self.masks), self.size)
        arrays = [sample.picture, *sample.masks]
        needed = sum(array.nbytes for array in arrays)
        if needed <= self._room:
            self._room -= needed
            for array in arrays:
                array.flags.writeable = False
            self._kept[key] = sample
        return sample


def at_work_size(sample: Sample, size: tuple[int, int]) -> Sample:
    """Return a sample at the size for augmentation: shrunk, but no side smaller than the network's."""
    height, width = sample.picture.shape[:2]
    scale = max(size[0] / width, size[1] / height)
    return sample if scale >= 1.0 else sample.resized(round(width * scale), round(height * scale))


def make_example(sample: Sample, size: tuple[int, int]) -> Example:
    """Return a sample at a network's size (width, height)."""
    seen = replace(sample, masks=()).resized(*size)
    corners = np.concatenate((seen.xywh[:, :2], seen.xywh[:, :2] + seen.xywh[:, 2:]), axis=1)
    return Example(
        torch.from_numpy(np.ascontiguousarray(seen.picture.transpose(2, 0, 1))),
        torch.from_numpy(corners.astype(np.float32)),
        torch.from_numpy(seen.class_index),
    )


class Batches(Sampler[list[int]]):
    """Draws in batches, in order, from the batch `first` on; Lightning counts those before it."""

    def __init__(self, draws: int, *, batch: int, first: int = 0) -> None:
        self._draws, self._batch, self._first = draws, batch, first

    def __len__(self) -> int:
        return math.ceil(self._draws / self._batch)

    def __iter__(self) -> Iterator[list[int]]:
        for start in range(self._first * self._batch, self._draws, self._batch):
            yield list(range(start, min(start + self._batch, self._draws)))


def network_pictures(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]], size: tuple[int, int]
) -> UInt8[torch.Tensor, "n 3 h w"]:
    """Pictures of any sizes at a network's size (width, height), as in training."""
    nothing = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    return torch.stack([make_example(at_work_size(Sample(image, *nothing), size), size).picture for image in images])
