"""Untrained detectors as weights files."""

import torch

from hulldown.training.detectors import detr
from hulldown.training.detectors.center_points import CenterNetwork
from hulldown.training.detectors.small import save_small, small_size
from hulldown.training.inputs.extra import quiet
from hulldown.training.inputs.settings import load_settings

CLASSES = ("truck", "tank")
SIZE = small_size(64)
RUN = {  # run.json as the first version wrote it
    "status": "finished",
    "model": "small",
    "resolution": [64, 48],
    "classes": list(CLASSES),
    "budget": 24,
    "seed": 0,
    "effective_batch": 4,
    "batch": 4,
    "accumulate": 1,
    "steps": 6,
    "sources": {
        "real": {"folder": "/real", "images": 8, "drawn": 24, "draws_per_image": {"mean": 3.0, "least": 1, "most": 5}}
    },
    "device": "cpu",
    "python": "3.11.9",
    "versions": {"torch": "2.6.0"},
    "figures": {"final_loss": 0.5, "seconds": 1.0, "seconds_per_step": 0.2, "peak_memory_mb": None},
}


def small_weights():
    network = CenterNetwork(2)
    with torch.no_grad():  # an untrained network has low scores
        network.heat.bias.fill_(1.0)
    return save_small(network, CLASSES, SIZE)


def nano_module(settings, classes, folder):
    with quiet():
        configs = detr.detr_configs(settings, classes, 1, weights=None, device=torch.device("cpu"), folder=folder)
        return detr.RFDETRModelModule(*configs)


def nano_weights(folder):
    settings = load_settings(None, {"model": "nano", "resolution": 64, "weights": "none", "queries": 20, "groups": 1})
    module = nano_module(settings, CLASSES, folder)
    return detr.save_detr(module, CLASSES, module.model)
