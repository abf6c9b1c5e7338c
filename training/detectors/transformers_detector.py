"""Detectors of transformers: D-FINE nano, and any other checkpoint for object detection.

The library has networks, matching, losses, and decoding of boxes; weights are folders as its `save_pretrained` writes
them.

Peng, Li, Wu, Zhang, Sun, Wu, D-FINE: redefine regression task in DETRs as fine-grained distribution refinement,
ICLR 2025. Its code and weights: Apache-2.0.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from huggingface_hub.errors import StrictDataclassError
from jaxtyping import Float, UInt8
from safetensors import SafetensorError
from torch import Tensor
from torchvision.ops import box_convert
from torchvision.transforms.functional import normalize
from transformers import (
    AutoConfig,
    AutoImageProcessor,
    AutoModelForObjectDetection,
    DFineConfig,
    HGNetV2Config,
    RTDetrImageProcessor,
)
from transformers.utils import logging

from hulldown.base.errors import HulldownError
from hulldown.base.files import open_regular_file
from hulldown.base.outputs import DONE_NAME, OutputFolder
from hulldown.training.detectors.detector import (
    DAMAGE_ERRORS,
    TRANSFORMERS_FILES,
    Detections,
    find_weights,
    first_error_line,
    refuse_nonfinite_weights,
)
from hulldown.training.inputs.data import pictures_at_network_size
from hulldown.training.inputs.extra import silence_libraries
from hulldown.training.inputs.settings import Settings

D_FINE_NANO = "ustc-community/dfine-nano-coco"  # at the Hugging Face hub
VEHICLE_LIKE_CLASS = "truck"  # of COCO
MIN_SCORE = 0.01
UNUSABLE_ERRORS = (*DAMAGE_ERRORS, SafetensorError, StrictDataclassError)
_REMEDY = f"name a run, a folder with {', '.join(TRANSFORMERS_FILES)}, a detector at the Hugging Face hub, or none"

logging.disable_progress_bar()


def d_fine_nano_config(**keys: Any) -> DFineConfig:
    """Return the architecture of D-FINE nano."""
    last_stages: dict[str, Any] = {"out_indices": [3, 4]}
    backbone = HGNetV2Config(
        stem_channels=[3, 16, 16], stage_in_channels=[16, 64, 256, 512], stage_mid_channels=[16, 32, 64, 128],
        stage_out_channels=[64, 256, 512, 1024], stage_num_blocks=[1, 1, 2, 1], stage_numb_of_layers=[3, 3, 3, 3],
        embedding_size=32, hidden_sizes=[64, 256, 512, 1024], depths=[1, 1, 2, 1], use_learnable_affine_block=True,
        **last_stages,
    )  # fmt: skip
    return DFineConfig(
        backbone_config=backbone, encoder_in_channels=[512, 1024], feat_strides=[16, 32], encoder_hidden_dim=128,
        encode_proj_layers=[1], encoder_ffn_dim=512, hidden_expansion=0.34, depth_mult=0.5,
        decoder_in_channels=[128, 128], d_model=128, num_feature_levels=2, decoder_layers=3, decoder_n_points=[6, 6],
        decoder_ffn_dim=512, freeze_backbone_batch_norms=False, **keys,
    )  # fmt: skip


def starting_network_and_processor(settings: Settings, classes: Sequence[str]) -> tuple[Any, Any]:
    """Return a network to train, and its image processor."""
    names = {"id2label": dict(enumerate(classes)), "label2id": {name: i for i, name in enumerate(classes)}}
    size = {"height": settings.resolution, "width": settings.resolution}
    if settings.weights == "none":
        config = _set_config_queries(d_fine_nano_config(**names), settings)
        return AutoModelForObjectDetection.from_config(config), RTDetrImageProcessor(size=size)
    source = settings.weights or D_FINE_NANO
    if Path(source).is_dir():
        source = str(find_weights(Path(source)))
    elif source.count("/") != 1:  # names at the hub have one
        raise HulldownError("no such run, or folder of weights", path=source, remedy=_REMEDY)
    network, processor, lost = _load_network_and_processor(source, settings, **names)
    if lost:
        _copy_class_weights(network, _load_network_and_processor(source, None)[0], lost)
    processor.size = size
    return network, processor


def _copy_class_weights(network: Any, before: Any, lost: Sequence[str]) -> None:
    """Start each class's lost outputs from those of its name in another network, or of `VEHICLE_LIKE_CLASS` there."""
    place = {name: i for i, name in before.config.id2label.items()}
    if VEHICLE_LIKE_CLASS not in place:
        return
    rows = [place.get(name, place[VEHICLE_LIKE_CLASS]) for _, name in sorted(network.config.id2label.items())]
    new, old, classes = network.state_dict(), before.state_dict(), len(before.config.id2label)
    for key in lost:
        last = [*range(classes, len(old[key]))]  # some have one more row, for no class
        if len(new[key]) == len(rows) + len(last):
            new[key].copy_(old[key][rows + last])


def _set_config_queries(config: Any, settings: Settings) -> Any:
    """Return a config with as many queries as the settings ask for, but no more than the input has cells."""
    if settings.queries is not None:
        config.num_queries = settings.queries
    if (strides := getattr(config, "feat_strides", None)) is not None:
        config.num_queries = min(config.num_queries, sum((settings.resolution // stride) ** 2 for stride in strides))
    return config


def _load_network_and_processor(source: str, settings: Settings | None, **names: object) -> tuple[Any, Any, list[str]]:
    """Read network and image processor from a folder or the hub, without its code; also return lost weights' names."""
    try:
        for name in TRANSFORMERS_FILES if Path(source).exists() else ():
            open_regular_file(Path(source, name)).close()
        with silence_libraries():
            config = AutoConfig.from_pretrained(source, trust_remote_code=False, **names)
            processor = AutoImageProcessor.from_pretrained(source, trust_remote_code=False)
            network, found = AutoModelForObjectDetection.from_pretrained(
                source, config=config if settings is None else _set_config_queries(config, settings),
                ignore_mismatched_sizes=settings is not None, use_safetensors=True, output_loading_info=True,
                trust_remote_code=False,
            )  # fmt: skip
    except UNUSABLE_ERRORS as error:
        raise HulldownError(
            f"{source}: cannot be loaded as a detector of transformers ({first_error_line(error)})", remedy=_REMEDY
        ) from None
    refuse_nonfinite_weights(network, Path(source))
    return network, processor, sorted(key for key, *_ in found["mismatched_keys"])


def normalize_for_transformers(pictures: UInt8[Tensor, "n 3 h w"], processor: Any) -> Float[Tensor, "n 3 h w"]:
    """Return pictures in the form that a network takes."""
    scaled = pictures.float() * processor.rescale_factor
    return normalize(scaled, processor.image_mean, processor.image_std) if processor.do_normalize else scaled


class TransformersDetector:
    """A network of transformers as a detector; see `training.detectors.detector.Detector`."""

    def __init__(self, network: Any, processor: Any, device: torch.device) -> None:
        names = network.config.id2label
        self.classes = tuple(str(names[i]) for i in range(len(names)))
        self.network, self.processor = network.to(device).eval(), processor
        self.size, self._device = (int(processor.size["width"]), int(processor.size["height"])), device

    @torch.inference_mode()
    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures."""
        if not images:
            return []
        pictures = normalize_for_transformers(pictures_at_network_size(images, self.size).to(self._device), self.processor)
        sizes = [image.shape[:2] for image in images]
        found = self.processor.post_process_object_detection(
            self.network(pixel_values=pictures), threshold=MIN_SCORE, target_sizes=sizes
        )
        detections = []
        for one, (height, width) in zip(found, sizes, strict=True):
            rows = one["scores"].argsort(descending=True, stable=True)
            corners = one["boxes"][rows].cpu().double().clip(min=0.0)
            corners = corners.minimum(torch.tensor([width, height] * 2, dtype=torch.float64))
            scores, labels = (one[key][rows].cpu().numpy() for key in ("scores", "labels"))
            xywh = box_convert(corners, "xyxy", "xywh").numpy()
            detections.append(Detections(xywh, scores.astype(np.float64), labels.astype(np.int64)))
        return detections


def load_transformers_detector(path: Path, *, device: torch.device) -> TransformersDetector:
    """Load the detector of a folder of weights."""
    network, processor, _ = _load_network_and_processor(str(path), None)
    return TransformersDetector(network, processor, device)


def save_transformers_weights(network: Any, processor: Any, path: Path) -> None:
    """Write a folder of weights, which `transformers` opens too."""
    shutil.rmtree(path, ignore_errors=True)
    try:
        with OutputFolder(path, "weights", [DONE_NAME]) as output, output.stage_content() as folder:
            network.save_pretrained(folder)
            processor.save_pretrained(folder)
    except SafetensorError as error:  # of a full disk, for example
        raise HulldownError(f"cannot be written ({first_error_line(error)})", path=path) from None
