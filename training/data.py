"""Draws as pictures and boxes for a network: draw k gives the same pixels in any process at any time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch.utils.data import Dataset, Sampler

from hulldown.training.augment import Augmenter, Sample, Table
from hulldown.training.draws import Draws
from hulldown.training.sources import Source

KEPT_BYTES = 256 * 2**20  # of pictures that each worker keeps in memory


@dataclass(frozen=True, eq=False, slots=True)
class Example:
    """A picture at the network's size, with what is on it.

    Parameters
    ----------
    picture
        (3, h, w) RGB.
    xyxy
        (n, 4) corners of boxes, pixels.
    label
        (n,) of each.
    """

    picture: UInt8[torch.Tensor, "3 h w"]
    xyxy: Float[torch.Tensor, "n 4"]
    label: Int[torch.Tensor, " n"]


class DrawnExamples(Dataset[Example]):
    """Draw k, augmented, at the network's size.

    Parameters
    ----------
    sources, draws
        What is drawn from, and what.
    size
        Width and height that the network sees; pictures are squeezed into it, as RF-DETR has it.
    table
        The augmentation; an empty one for none.
    masks
        Whether boxes follow their masks when a picture is turned; one rule for all sources.
    """

    def __init__(
        self, sources: Sequence[Source], draws: Draws, size: tuple[int, int], table: Table, *, masks: bool
    ) -> None:
        self.sources, self.draws, self.size, self.masks = sources, draws, size, masks
        self.augment = Augmenter(table, height=size[1])
        self._kept: dict[tuple[int, int], Sample] = {}
        self._room = KEPT_BYTES

    def __len__(self) -> int:
        return len(self.draws)

    def __getitem__(self, k: int) -> Example:
        cv2.setNumThreads(0)  # its threads fight for the cores that the loader's workers and the network use
        return example(self.augment(self._sample(k), int(self.draws.seed[k])), self.size)

    def _sample(self, k: int) -> Sample:
        """What draw k is of, before augmentation. A small dataset is read once: reading takes longer than the rest."""
        key = int(self.draws.source[k]), int(self.draws.image[k])
        if key in self._kept:
            return self._kept[key]
        sample = at_work_size(self.sources[key[0]].sample(key[1], masks=self.masks), self.size)
        arrays = [sample.picture, *(mask for mask in sample.masks if mask is not None)]
        needed = sum(array.nbytes for array in arrays)
        if needed <= self._room:
            self._room -= needed
            for array in arrays:
                array.flags.writeable = False
            self._kept[key] = sample
        return sample


def at_work_size(sample: Sample, size: tuple[int, int]) -> Sample:
    """A sample as large as augmentation needs it: shrunk as long as neither side is smaller than the network's."""
    height, width = sample.picture.shape[:2]
    scale = max(size[0] / width, size[1] / height)
    return sample if scale >= 1.0 else sample.resized(round(width * scale), round(height * scale))


def example(sample: Sample, size: tuple[int, int]) -> Example:
    """A sample as a network sees it, at (width, height)."""
    seen = sample.resized(*size)
    corners = np.concatenate((seen.xywh[:, :2], seen.xywh[:, :2] + seen.xywh[:, 2:]), axis=1)
    return Example(
        torch.from_numpy(np.ascontiguousarray(seen.picture.transpose(2, 0, 1))),
        torch.from_numpy(corners.astype(np.float32)),
        torch.from_numpy(seen.label),
    )


class Batches(Sampler[list[int]]):
    """The draws of each step in order, cut into the batches that go through the network at once.

    A step has as many draws as the others, but for the last, which has what is left of the budget; a step's batches
    are as even as they can be. So no step weighs its draws otherwise than the next, and every draw is used once.

    Parameters
    ----------
    draws
        How many there are.
    batch
        Draws in a batch.
    parts
        Batches in a step: of one process after the other, and of several at once.
    rank, ranks
        Which of the batches that several processes work on at once are this one's.
    first
        The step to begin with: those before it are done.
    """

    def __init__(
        self, draws: int, *, batch: int, parts: int = 1, rank: int = 0, ranks: int = 1, first: int = 0
    ) -> None:
        whole = batch * parts
        ends = [*range(whole, draws, whole), draws]
        # A rest too small to give every batch a draw goes with the step before.
        if len(ends) > 1 and ends[-1] - ends[-2] < parts:
            del ends[-2]
        self._steps = list(zip([0, *ends[:-1]], ends, strict=True))
        self._parts, self._rank, self._ranks, self._first = parts, rank, ranks, first

    @property
    def steps(self) -> int:
        """How many times the weights change."""
        return len(self._steps)

    def __len__(self) -> int:
        """Batches of this process in all, those before `first` counted: Lightning knows itself that they are done."""
        return len(self._steps) * (self._parts // self._ranks)

    def __iter__(self) -> Iterator[list[int]]:
        for start, end in self._steps[self._first :]:
            pieces = np.array_split(np.arange(start, end), self._parts)
            yield from (piece.tolist() for piece in pieces[self._rank :: self._ranks])


def network_pictures(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]], size: tuple[int, int]
) -> UInt8[torch.Tensor, "n 3 h w"]:
    """Pictures of any sizes as a network of (width, height) sees them, made as for training."""
    nothing = np.zeros((0, 4)), np.zeros(0, dtype=np.int64), ()
    return torch.stack([example(at_work_size(Sample(image, *nothing), size), size).picture for image in images])
