"""Plan, render, and annotate synthetic detection datasets of vehicles on terrain.

A script needs only the names below; docs/python.md shows their use. Each is imported on first
use, so that `import hulldown` is fast.

Examples
--------
>>> import hulldown as hd
>>> hills = hd.Mesh([[0.0, 0, 0], [40, 0, 8], [40, 40, 8], [0, 40, 0]], [[0, 1, 2], [0, 2, 3]])
>>> hd.Terrain(hills).top_hits([[20.0, 10.0]]).z.tolist()
[4.0]
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# An alias such as `join_datasets as join_datasets` makes a name public for type checkers.
if TYPE_CHECKING:
    from hulldown.base.errors import HulldownError as HulldownError
    from hulldown.dataset.exports.export import export_dataset as export_dataset
    from hulldown.dataset.join import join_datasets as join_datasets
    from hulldown.dataset.table import Dataset as Dataset
    from hulldown.geometry.meshes import Mesh as Mesh
    from hulldown.placement.settle import settle as settle
    from hulldown.placement.terrain import Terrain as Terrain
    from hulldown.plan.config.schema import Config as Config
    from hulldown.plan.plan_file import read_plan as read_plan
    from hulldown.planning.write import plan_dataset as plan_dataset
    from hulldown.render.export_scene import export_scene as export_scene
    from hulldown.render.supervisor import render_plan as render_plan
    from hulldown.render.verify import verify_dataset as verify_dataset
    from hulldown.training.evaluation.evaluation_report import evaluate_detections as evaluate_detections
    from hulldown.training.predict import predict_detections as predict_detections
    from hulldown.training.train import train_detector as train_detector

_HOMES = {
    "Config": "plan.config.schema",
    "Dataset": "dataset.table",
    "HulldownError": "base.errors",
    "Mesh": "geometry.meshes",
    "Terrain": "placement.terrain",
    "evaluate_detections": "training.evaluation.evaluation_report",
    "export_dataset": "dataset.exports.export",
    "export_scene": "render.export_scene",
    "join_datasets": "dataset.join",
    "plan_dataset": "planning.write",
    "predict_detections": "training.predict",
    "read_plan": "plan.plan_file",
    "render_plan": "render.supervisor",
    "settle": "placement.settle",
    "train_detector": "training.train",
    "verify_dataset": "render.verify",
}
__all__ = sorted(_HOMES)
_RENAMED = {
    "evaluate": "evaluate_detections",
    "export": "export_dataset",
    "join": "join_datasets",
    "plan": "plan_dataset",
    "predict": "predict_detections",
    "render": "render_plan",
    "train": "train_detector",
    "verify": "verify_dataset",
}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        raise AttributeError(f"hulldown.{name} is hulldown.{_RENAMED[name]} now")
    if name not in _HOMES:
        raise AttributeError(f"module 'hulldown' has no attribute {name!r}")
    value = getattr(import_module(f"hulldown.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
