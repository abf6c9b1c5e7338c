"""A sheet of augmented pictures of a dataset (paper, Figure 4)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.annotate.drawing import Overlay, picture_with_labels
from hulldown.base.arguments import AnyPath, Count, PngFile
from hulldown.base.indices import even_sample
from hulldown.base.terminal import track_items
from hulldown.pictures.own_files import require_replaceable_picture, save_picture
from hulldown.pictures.sheets import contact_sheet
from hulldown.training.inputs.extra import require_training_extra
from hulldown.training.inputs.settings import load_settings
from hulldown.training.inputs.sources import Sample, read_classes_and_sources

AUGMENTATIONS_PER_ROW = 8
SHEET_PICTURE_SIZE = (512, 288)  # as for a network of that size
TILE_WIDTH = 256


def write_augmentation_sheet(
    dataset: AnyPath, output: PngFile, *, augmentation: str = "table1", seed: int = 0, rows: Count = 6
) -> None:
    """Show augmented pictures of a dataset.

    Reads a dataset; writes a sheet: in each row a picture as it is and eight times augmented, with its boxes.

    Parameters
    ----------
    dataset
        The dataset's folder.
    output
        The picture.
    augmentation
        An Albumentations file, or table1, mild, or aerial.
    seed
        Seed of the augmentations.
    rows
        Number of pictures, evenly spread over the dataset.
    """
    require_training_extra()
    # Not at the top: this module can be imported without the extra.
    from hulldown.training.inputs.augment import Augmenter
    from hulldown.training.inputs.data import shrink_for_augmentation

    require_replaceable_picture(Path(output))
    augment = Augmenter(load_settings(None, {"augmentation": augmentation}).augmentation)
    classes, (source,) = read_classes_and_sources({"dataset": dataset})
    chosen = even_sample(len(source), rows)
    pictures = []
    for i in track_items("augmenting", chosen.tolist(), len(chosen)):
        sample = shrink_for_augmentation(source.read_sample(i, masks=source.has_all_masks), SHEET_PICTURE_SIZE)
        seeds = [int(np.random.SeedSequence((seed, i, k)).generate_state(1)[0]) for k in range(AUGMENTATIONS_PER_ROW)]
        changed = [augment(sample, own_seed) for own_seed in seeds]
        pictures += [_labeled_sample_picture(one, classes) for one in (sample, *changed)]
    save_picture(contact_sheet(pictures, columns=AUGMENTATIONS_PER_ROW + 1, tile_width=TILE_WIDTH), Path(output))


def _labeled_sample_picture(sample: Sample, classes: Sequence[str]) -> Image.Image:
    labels = zip(sample.xywh, sample.class_index.tolist(), strict=True)
    return picture_with_labels(
        Image.fromarray(sample.picture), [Overlay(xywh, label + 1, classes[label]) for xywh, label in labels]
    )
