"""The sequence of training pictures, fixed before training, and its pictures and boxes for a network.

"25,000 randomly sampled images (with replacement)" (paper, section 2.2). Row k is a function of the seed and k alone,
and has the same pixels in any process.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch.utils.data import Dataset, Sampler

from hulldown.base.errors import ConfigError, HulldownError
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.sources import LabeledPictures, Sample

KEPT_PICTURE_BYTES = 256 * 2**20  # in each worker


@dataclass(frozen=True, eq=False, slots=True)
class Example:
    """A picture at the network's size, and its labels."""

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
        self._room = KEPT_PICTURE_BYTES

    def __len__(self) -> int:
        return len(self.draws)

    def __getitem__(self, k: int) -> Example | HulldownError:
        """Return draw k, or why it can't be read, since PyTorch's loader would add its traceback to an exception."""
        cv2.setNumThreads(0)  # its threads compete with the loader's workers and the network
        try:
            return make_example(self.augment(self._sample_of_draw(k), int(self.draws.seed[k])), self.size)
        except HulldownError as error:
            return error

    def _sample_of_draw(self, k: int) -> Sample:
        """Return the sample of draw k before augmentation. Small datasets are kept in memory, since reading is slow."""
        key = int(self.draws.source[k]), int(self.draws.image[k])
        if key in self._kept:
            return self._kept[key]
        sample = shrink_for_augmentation(self.sources[key[0]].read_sample(key[1], masks=self.masks), self.size)
        arrays = [sample.picture, *sample.masks]
        needed = sum(array.nbytes for array in arrays)
        if needed <= self._room:
            self._room -= needed
            for array in arrays:
                array.flags.writeable = False
            self._kept[key] = sample
        return sample


def shrink_for_augmentation(sample: Sample, size: tuple[int, int]) -> Sample:
    """Return a sample at the size for augmentation: shrunk, but no side smaller than the network's."""
    height, width = sample.picture.shape[:2]
    scale = max(size[0] / width, size[1] / height)
    return sample if scale >= 1.0 else sample.resized_sample(round(width * scale), round(height * scale))


def make_example(sample: Sample, size: tuple[int, int]) -> Example:
    """Return a sample at a network's size (width, height)."""
    seen = replace(sample, masks=()).resized_sample(*size)
    corners = np.concatenate((seen.xywh[:, :2], seen.xywh[:, :2] + seen.xywh[:, 2:]), axis=1)
    return Example(
        torch.from_numpy(np.ascontiguousarray(seen.picture.transpose(2, 0, 1))),
        torch.from_numpy(corners.astype(np.float32)),
        torch.from_numpy(seen.class_index),
    )


class Batches(Sampler[list[int]]):
    """Batches of draws in order, from the batch `first` on; Lightning counts those before it."""

    def __init__(self, draws: int, *, batch: int, first: int = 0) -> None:
        self._draws, self._batch, self._first = draws, batch, first

    def __len__(self) -> int:
        return math.ceil(self._draws / self._batch)

    def __iter__(self) -> Iterator[list[int]]:
        for start in range(self._first * self._batch, self._draws, self._batch):
            yield list(range(start, min(start + self._batch, self._draws)))


def pictures_at_network_size(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]], size: tuple[int, int]
) -> UInt8[torch.Tensor, "n 3 h w"]:
    """Return pictures of any sizes at a network's size (width, height), as in training."""
    nothing = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    return torch.stack([make_example(shrink_for_augmentation(Sample(image, *nothing), size), size).picture for image in images])


@dataclass(frozen=True, eq=False, slots=True)
class Draws:
    """n draws from the pictures of several sources."""

    source: Int[np.ndarray, " n"]
    image: Int[np.ndarray, " n"]
    seed: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.source)


def make_draws(sizes: Sequence[int], budget: int, *, seed: int, shares: Sequence[float] = ()) -> Draws:
    """Draw pictures with replacement, by `fill_source_shares`, or without `shares` all equally often."""
    if not sizes or min(sizes) < 1:
        raise ValueError(f"sizes: expected at least one picture in each of at least one source, got {list(sizes)}")
    if shares and len(shares) != len(sizes):
        raise ValueError(f"shares: expected one for each of {len(sizes)} sources, got {list(shares)}")
    low = np.concatenate(([0.0], np.cumsum(shares or np.divide(sizes, sum(sizes)))))
    # Raw output of a counter-based generator: the same on every machine and with every version of NumPy.
    raw = np.random.Philox(key=seed).random_raw(3 * budget).reshape(budget, 3)
    unit = (raw[:, :2] >> np.uint64(11)) * 2.0**-53
    source = np.minimum(np.searchsorted(low, unit[:, 0], side="right") - 1, len(sizes) - 1)
    image = (unit[:, 1] * np.asarray(sizes)[source]).astype(np.int64)
    return Draws(source.astype(np.int64), image, (raw[:, 2] >> np.uint64(32)).astype(np.int64))


def fill_source_shares(sizes: Mapping[str, int], shares: Mapping[str, float]) -> list[float]:
    """Return each source's share of the draws: by `shares`, or a part of the rest by its number of pictures."""
    for name, share in shares.items():
        if name not in sizes:
            raise ConfigError(f"shares.{name}: no source has this name; there are {', '.join(sizes)}")
        if not 0.0 <= share <= 1.0:
            raise ConfigError(f"shares.{name} = {share:g}: expected a number from 0 to 1")
    total = math.fsum(shares.values())
    if total > 1.0 + 1e-9 or (len(shares) == len(sizes) and total < 1.0 - 1e-9):
        raise ConfigError(f"shares: they add up to {total:g}, expected 1", remedy="leave one of them out")
    open_pictures = sum(size for name, size in sizes.items() if name not in shares)
    return [shares[name] if name in shares else (1.0 - total) * n / open_pictures for name, n in sizes.items()]
