"""Augmentation of pictures and boxes: the paper's Table 1, by Albumentations.

Where the paper leaves a choice: saturation and value are shifted by the number without its percent sign in
steps of 0 to 255, as in Albumentations, since 30 % of the range makes gray roads green. The hue is in
OpenCV's half degrees. Borders of turned pictures are black, since mirrored borders have vehicles without
labels. Kernels are in pixels of the picture at about the model's input size.

References
----------
The paper, section 2.2 and Table 1. Buslaev et al., Albumentations: fast and flexible image augmentations,
Information 11(2), 2020.
"""

from __future__ import annotations

import random
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, TypeAlias

import albumentations as A
import cv2
import numpy as np

from hulldown.annotate.masks import mask_box
from hulldown.base.errors import ConfigError
from hulldown.geometry.arrays import are_numbers
from hulldown.training.inputs.samples import Sample

Number: TypeAlias = int | float
Option: TypeAlias = Number | tuple[Number, Number]

MIN_VISIBLE = 0.2  # least share of a box inside the picture
MASK_ROUNDING = 1.0  # pixels between the box of a mask and that of its outline
MIN_SIDE = 1.0  # least width and height of a box in pixels


@dataclass(frozen=True, slots=True)
class Change:
    """A line of the table."""

    probability: float  # probability of being applied; within a group, of being selected
    options: Mapping[str, Option] = field(default_factory=dict)  # numbers and ranges, as in the paper
    group: str = ""  # the line of its group, of which at most one is applied; empty for a single line


Table: TypeAlias = Mapping[str, Change]

TABLE: Table = {
    # geometric
    "horizontal_flip": Change(0.5),
    "vertical_flip": Change(0.0),  # beyond the paper: of pictures from above
    "shift_scale_rotate": Change(0.6, {"shift": 0.05, "scale": (0.8, 1.2), "rotate_deg": 15}),
    "shear": Change(0.3, {"shear_deg": 10}),
    # photometric
    "brightness": Change(0.7),
    "brightness_contrast": Change(1 / 3, {"brightness": 0.3, "contrast": 0.3}, "brightness"),
    "gamma": Change(1 / 3, {"gamma": (0.7, 1.3)}, "brightness"),
    "clahe": Change(1 / 3, {"clip_limit": (1.0, 4.0), "tiles": 8}, "brightness"),
    "hue_saturation_value": Change(0.5, {"hue": 15, "saturation": 30, "value": 20}),
    "color_jitter": Change(0.3, {"brightness": 0.1, "contrast": 0.1, "saturation": 0.2, "hue": 0.05}),
    "channel_shuffle": Change(0.05),
    # blur and noise
    "blur": Change(0.3),
    "gaussian_blur": Change(1 / 3, {"kernel": (3, 7)}, "blur"),
    "motion_blur": Change(1 / 3, {"kernel": (3, 7)}, "blur"),
    "median_blur": Change(1 / 3, {"kernel": (3, 5)}, "blur"),  # the paper's kernel of 1 is no blur
    "gaussian_noise": Change(0.3, {"std": (0.01, 0.05)}),
    # from clean renders to photographs
    "compression": Change(0.3, {"quality": (40, 90)}),
    "downscale": Change(0.2, {"scale": (0.5, 0.8)}),
    "shadow": Change(0.2, {"count": (1, 3), "darkness": (0.3, 0.6)}),
    "flare": Change(0.1, {"count": (1, 3), "radius": 0.15}),  # radius: share of the picture's height
}


class Augmenter:
    """Applies a table to samples, as a function of a seed."""

    def __init__(self, table: Table, *, height: int) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Albumentations only warns of a wrong argument's name
            warnings.filterwarnings("ignore", message="Got processor for bboxes")  # a table may leave boxes alone
            self._compose = A.Compose(
                [_line(name, table, height) for name, change in table.items() if not change.group],
                bbox_params=A.BboxParams(
                    format="pascal_voc", label_fields=["index"], min_visibility=MIN_VISIBLE,
                    min_width=MIN_SIDE, min_height=MIN_SIDE, clip=True, check_each_transform=False,
                ),
            )  # fmt: skip

    def __call__(self, sample: Sample, seed: int) -> Sample:
        """Augment a sample; boxes that are mostly outside of the picture are dropped.

        Boxes follow their masks if there are any, else the ellipses in them, since a turned object's outline
        rarely reaches the corners of its box. Boxes of `sample` must be inside its picture.
        """
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
        index = np.asarray(found["index"], dtype=np.int64)
        corners = np.asarray(found["bboxes"], dtype=np.float64).reshape(-1, 4)
        xywh = np.concatenate((corners[:, :2], corners[:, 2:] - corners[:, :2]), axis=1)
        changed, kept = Sample(np.ascontiguousarray(found["image"]), xywh, sample.class_index[index]), []
        if not sample.masks:
            return changed
        masks = [np.asarray(found["masks"][i], dtype=bool) for i in index.tolist()]
        for row, mask in enumerate(masks):
            seen = mask_box(mask)
            if seen is None:
                continue
            x, y, width, height = seen
            if np.abs([x, y, x + width, y + height] - corners[row]).max() > MASK_ROUNDING:
                xywh[row] = seen
            kept.append(row)
        return Sample(changed.picture, xywh[kept], changed.class_index[kept], tuple(masks[row] for row in kept))


def changed_table(changes: Mapping[str, object]) -> Table:
    """Return `TABLE` with changes."""
    result = dict(TABLE)
    for name, keys in changes.items():
        if name not in TABLE:
            raise ConfigError(f"unknown key augmentation.{name}; {_hint(name, list(TABLE))}")
        if not isinstance(keys, Mapping):
            raise ConfigError(f"augmentation.{name} = {keys!r}: expected a table, such as {{ probability = 0.0 }}")
        result[name] = _changed(name, result[name], keys)
    return result


def _changed(name: str, line: Change, keys: Mapping[str, Any]) -> Change:
    options, probability = dict(line.options), line.probability
    for key, value in keys.items():
        where = f"augmentation.{name}.{key}"
        if key == "probability":
            if not are_numbers([value]) or not 0.0 <= value <= 1.0:
                raise ConfigError(f"{where} = {value!r}: expected a number from 0 to 1")
            probability = float(value)
        elif key not in options:
            raise ConfigError(f"unknown key {where}; {_hint(key, ['probability', *options])}")
        elif isinstance(options[key], tuple):
            pair = value if isinstance(value, list | tuple) else [value, value]
            if len(pair) != 2 or not are_numbers(pair) or pair[0] > pair[1]:
                raise ConfigError(f"{where} = {value!r}: expected a range, such as {list(_pair(options[key]))}")
            options[key] = (pair[0], pair[1])
        elif not are_numbers([value]) or value < 0:
            raise ConfigError(f"{where} = {value!r}: expected a number from 0 on")
        else:
            options[key] = value
    return Change(probability, options, line.group)


def _hint(name: str, known: Sequence[str]) -> str:
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]}?" if near else f"known here: {', '.join(sorted(known))}"


def _pair(value: Option) -> tuple[Number, Number]:
    return value if isinstance(value, tuple) else (-value, value)


def _whole(pair: tuple[Number, Number]) -> tuple[int, int]:
    return round(pair[0]), round(pair[1])


def _line(name: str, table: Table, height: int) -> Any:
    """Albumentations' transform of a line, with its group if it has one."""
    group = {key: change for key, change in table.items() if change.group == name}
    if not group:
        return _transform(name, table[name], height)
    if not any(change.probability for change in group.values()):  # weights of which Albumentations makes no sense
        return A.NoOp()
    return A.OneOf([_transform(*change, height) for change in group.items()], p=table[name].probability)


def _transform(name: str, line: Change, height: int) -> Any:
    p, o = line.probability, {key: _pair(value) for key, value in line.options.items()}
    outside = {"fill": 0, "border_mode": cv2.BORDER_CONSTANT, "rotate_method": "ellipse"}
    match name:
        case "horizontal_flip":
            return A.HorizontalFlip(p=p)
        case "vertical_flip":
            return A.VerticalFlip(p=p)
        case "shift_scale_rotate":
            shift = {"x": o["shift"], "y": o["shift"]}
            return A.Affine(
                translate_percent=shift, scale=o["scale"], keep_ratio=True, rotate=o["rotate_deg"], **outside, p=p
            )
        case "shear":
            return A.Affine(shear=o["shear_deg"], **outside, p=p)
        case "brightness_contrast":
            limits = {f"{key}_limit": o[key] for key in ("brightness", "contrast")}
            return A.RandomBrightnessContrast(**limits, p=p)
        case "gamma":
            return A.RandomGamma(gamma_limit=tuple(100 * n for n in o["gamma"]), p=p)
        case "clahe":
            return A.CLAHE(clip_limit=o["clip_limit"], tile_grid_size=(round(o["tiles"][1]),) * 2, p=p)
        case "hue_saturation_value":
            shorts = {"hue": "hue", "sat": "saturation", "val": "value"}
            shifts = {f"{short}_shift_limit": o[key] for short, key in shorts.items()}
            return A.HueSaturationValue(**shifts, p=p)
        case "color_jitter":
            factors = {key: tuple(1 + n for n in o[key]) for key in ("brightness", "contrast", "saturation")}
            return A.ColorJitter(**factors, hue=o["hue"], p=p)
        case "channel_shuffle":
            return A.ChannelShuffle(p=p)
        case "gaussian_blur":
            return A.GaussianBlur(blur_limit=_whole(o["kernel"]), p=p)
        case "motion_blur":
            return A.MotionBlur(blur_limit=_whole(o["kernel"]), p=p)
        case "median_blur":
            return A.MedianBlur(blur_limit=_whole(o["kernel"]), p=p)
        case "gaussian_noise":
            return A.GaussNoise(std_range=o["std"], p=p)
        case "compression":
            return A.ImageCompression(quality_range=_whole(o["quality"]), p=p)
        case "downscale":
            smooth = {"downscale": cv2.INTER_AREA, "upscale": cv2.INTER_LINEAR}
            return A.Downscale(scale_range=o["scale"], interpolation_pair=smooth, p=p)
        case "shadow":
            return A.RandomShadow(
                shadow_roi=(0, 0.3, 1, 1), num_shadows_limit=_whole(o["count"]),
                shadow_intensity_range=o["darkness"], p=p,
            )  # fmt: skip
        case "flare":
            radius = max(2, round(float(o["radius"][1]) * height))
            return A.RandomSunFlare(num_flare_circles_range=_whole(o["count"]), src_radius=radius, p=p)
    raise ValueError(f"table: expected the name of a change, got {name!r}")
