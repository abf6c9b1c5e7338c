"""A sheet of augmented pictures of a dataset (paper, Figure 4)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.base.terminal import tracked
from hulldown.geometry.indices import spread
from hulldown.pictures.drawing import Overlay, contact_sheet, draw
from hulldown.training.inputs.augment import Augmenter
from hulldown.training.inputs.data import at_work_size
from hulldown.training.inputs.settings import load_settings
from hulldown.training.inputs.sources import Sample, read_sources

TIMES = 8  # augmentations in a row
WORK_SIZE = (512, 288)  # size of the pictures, as for a network of that size
TILE_WIDTH = 256


def augmentation_sheet(
    dataset: Path | str,
    *,
    rows: int = 6,
    seed: int = 0,
    augmentation: str = "table1",
) -> Image.Image:
    """Make a sheet; each row has a picture, and eight augmentations of it, by a file or one of our own."""
    augment = Augmenter(load_settings(None, {"augmentation": augmentation}).augmentation)
    classes, (source,) = read_sources({"dataset": dataset})
    chosen = spread(len(source), rows)
    pictures = []
    for i in tracked("augmenting", chosen.tolist(), len(chosen)):
        sample = at_work_size(source.sample(i, masks=source.masked), WORK_SIZE)
        seeds = [int(np.random.SeedSequence((seed, i, k)).generate_state(1)[0]) for k in range(TIMES)]
        changed = [augment(sample, own_seed) for own_seed in seeds]
        pictures += [_drawn(one, classes) for one in (sample, *changed)]
    return contact_sheet(pictures, columns=TIMES + 1, tile_width=TILE_WIDTH)


def _drawn(sample: Sample, classes: Sequence[str]) -> Image.Image:
    labels = zip(sample.xywh, sample.class_index.tolist(), strict=True)
    return draw(Image.fromarray(sample.picture), [Overlay(xywh, label + 1, classes[label]) for xywh, label in labels])
