"""Untrained detectors as weights."""

import tempfile
from functools import cache
from pathlib import Path

import torch
from transformers import AutoModelForObjectDetection, DFineConfig, HGNetV2Config, RTDetrImageProcessor

from hulldown.training.detectors import detr
from hulldown.training.detectors.transformers_detector import save_transformers_weights
from hulldown.training.inputs.extra import silence_libraries
from hulldown.training.inputs.settings import load_settings

CLASSES = ("truck", "tank")
RUN = {  # run.json as the first version wrote it
    "status": "finished",
    "model": "small",
    "resolution": [64, 64],
    "classes": list(CLASSES),
    "budget": 24,
    "seed": 0,
    "effective_batch": 4,
    "batch": 4,
    "accumulate": 1,
    "steps": 6,
    "sources": {"real": {"folder": "/real", "images": 8, "drawn": 24}},
    "device": "cpu",
    "python": "3.11.9",
    "versions": {"torch": "2.6.0"},
    "figures": {"final_loss": 0.5, "seconds": 1.0, "seconds_per_step": 0.2, "peak_memory_mb": None},
}


def tiny_network(classes=CLASSES):
    """A D-FINE of 90,000 random parameters, normalized so that its outputs depend on pictures."""
    backbone = HGNetV2Config(
        stem_channels=[3, 8, 8], stage_in_channels=[8, 16, 32, 32], stage_mid_channels=[8, 8, 16, 16],
        stage_out_channels=[16, 32, 32, 64], stage_num_blocks=[1, 1, 1, 1], stage_numb_of_layers=[1, 1, 1, 1],
        embedding_size=8, hidden_sizes=[16, 32, 32, 64], depths=[1, 1, 1, 1], use_learnable_affine_block=True,
        out_indices=[3, 4],
    )  # fmt: skip
    config = DFineConfig(
        backbone_config=backbone, encoder_in_channels=[32, 64], feat_strides=[16, 32], encoder_hidden_dim=32,
        encode_proj_layers=[1], encoder_ffn_dim=32, hidden_expansion=0.34, depth_mult=0.34, d_model=32,
        decoder_in_channels=[32, 32], num_feature_levels=2, decoder_layers=2, decoder_n_points=[2, 2],
        decoder_ffn_dim=32, encoder_attention_heads=2, decoder_attention_heads=2, num_queries=20, num_denoising=10,
        freeze_backbone_batch_norms=False, id2label=dict(enumerate(classes)),
        label2id={name: i for i, name in enumerate(classes)},
    )  # fmt: skip
    network = AutoModelForObjectDetection.from_config(config).train()
    norms = [module for module in network.modules() if isinstance(module, torch.nn.BatchNorm2d)]
    for norm in norms:
        norm.momentum = 1.0
    with torch.no_grad():
        network(pixel_values=torch.rand(4, 3, 64, 64))
    for norm in norms:
        norm.momentum = 0.1
    return network


def write_small_weights(folder, classes=CLASSES):
    """Write the folder of weights of a tiny network."""
    save_transformers_weights(tiny_network(classes), RTDetrImageProcessor(size={"height": 64, "width": 64}), folder)
    return folder


@cache
def tiny_folder():
    """A temporary folder, which lasts as long as this process."""
    return tempfile.TemporaryDirectory()


@cache
def tiny_weights() -> str:
    """A folder of weights to train from."""
    torch.manual_seed(0)
    return str(write_small_weights(Path(tiny_folder().name) / "weights"))


def nano_module(settings, classes, folder):
    with silence_libraries():
        configs = detr.detr_configs(settings, classes, weights=None, device=torch.device("cpu"), folder=folder)
        return detr.RFDETRModelModule(*configs)


def nano_weights(folder):
    settings = load_settings(None, {"model": "nano", "resolution": 64, "weights": "none", "queries": 20, "groups": 1})
    module = nano_module(settings, CLASSES, folder)
    return detr.detr_checkpoint_contents(module, CLASSES, module.model)
