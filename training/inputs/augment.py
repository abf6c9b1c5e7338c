"""Augmentation of pictures and boxes by an Albumentations file; `augmentations/table1.yaml` is the paper's Table 1.

The paper, section 2.2 and Table 1. Buslaev et al., Albumentations: fast and flexible image augmentations,
Information 11(2), 2020.
"""

from __future__ import annotations

import random
import warnings
from collections.abc import Mapping

import albumentations as A
import numpy as np

from hulldown.annotate.masks import mask_box
from hulldown.base.errors import ConfigError
from hulldown.training.inputs.sources import Sample

MIN_KEPT_BOX_SHARE = 0.2  # inside the picture
MASK_ROUNDING_PX = 1.0  # between the box of a mask and that of its outline
MIN_BOX_SIDE_PX = 1.0


class Augmenter:
    """Augments samples by an Albumentations file and a seed."""

    def __init__(self, augmentation: Mapping[str, object]) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Albumentations only warns of a wrong argument's name
            try:
                loaded = A.from_dict(dict(augmentation))
            except KeyError as error:
                raise ConfigError(f"augmentation: Albumentations {A.__version__} has no {error.args[0]}") from None
            except (AttributeError, TypeError, ValueError, UserWarning) as error:
                raise ConfigError(f"augmentation: {' '.join(str(error).split())}") from None
            warnings.filterwarnings("ignore", message="Got processor for bboxes")  # a file may leave boxes alone
            # The file's own treatment of boxes is replaced.
            self._compose = A.Compose(
                loaded.transforms if isinstance(loaded, A.Compose) else [loaded],
                p=getattr(loaded, "p", 1.0) if isinstance(loaded, A.Compose) else 1.0,
                bbox_params=A.BboxParams(
                    format="pascal_voc", label_fields=["index"], min_visibility=MIN_KEPT_BOX_SHARE,
                    min_width=MIN_BOX_SIDE_PX, min_height=MIN_BOX_SIDE_PX, clip=True, check_each_transform=False,
                ),
            )  # fmt: skip

    def __call__(self, sample: Sample, seed: int) -> Sample:
        """Augment a sample with boxes inside its picture, which follow masks; drop boxes that end up mostly outside."""
        # One generator for all: Albumentations' own seeding gives each transform the same numbers, and what is
        # applied with a probability of 0.05 would then be applied with all the rest.
        self._compose.set_random_state(np.random.default_rng(seed), random.Random(seed))
        given: dict[str, object] = {
            "image": sample.picture,
            "bboxes": np.concatenate((sample.xywh[:, :2], sample.xywh[:, :2] + sample.xywh[:, 2:]), axis=1),
            "index": np.arange(len(sample.class_index)),
        }
        if sample.masks:
            given["masks"] = [mask.view(np.uint8) for mask in sample.masks]
        found = self._compose(**given)
        picture = np.ascontiguousarray(found["image"])
        if picture.dtype != np.uint8 or picture.shape[2:] != (3,):
            kind = f"{picture.dtype} and shape {picture.shape}"
            raise ConfigError(f"augmentation: makes pictures of {kind}; training needs uint8 and three colors")
        index = np.asarray(found["index"], dtype=np.int64)
        corners = np.asarray(found["bboxes"], dtype=np.float64).reshape(-1, 4)
        xywh = np.concatenate((corners[:, :2], corners[:, 2:] - corners[:, :2]), axis=1)
        changed, kept = Sample(picture, xywh, sample.class_index[index]), []
        if not sample.masks:
            return changed
        masks = [np.asarray(found["masks"][i], dtype=bool) for i in index.tolist()]
        for row, mask in enumerate(masks):
            seen = mask_box(mask)
            if seen is None:
                continue
            x, y, width, height = seen
            if np.abs([x, y, x + width, y + height] - corners[row]).max() > MASK_ROUNDING_PX:
                xywh[row] = seen
            kept.append(row)
        return Sample(changed.picture, xywh[kept], changed.class_index[kept], tuple(masks[row] for row in kept))
