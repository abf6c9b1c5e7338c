"""A trained detector as an ONNX file, for programs without PyTorch."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.arguments import AnyPath
from hulldown.base.errors import HulldownError
from hulldown.base.files import replace_file
from hulldown.base.outputs import require_replaceable_file
from hulldown.training.detectors.detector import find_weights
from hulldown.training.inputs.extra import require_training_extra, silence_libraries
from hulldown.training.predict import load_detector

if TYPE_CHECKING:
    from hulldown.training.detectors.transformers_detector import TransformersDetector

INPUT_DESCRIPTION = "input: (1, 3, h, w) RGB, 0 to 1"
NORMALIZED_INPUT = f"{INPUT_DESCRIPTION}, less ImageNet's mean, over its standard deviation"
PRODUCER_FIELD = b"\x12\x08hulldown"  # ONNX's name of the producer, among the first fields
OUTPUT_DESCRIPTION = "dets: (1, k, 4) center and size as shares of the picture; labels: (1, k, classes or classes + 1) logits"


def export_model(run: AnyPath, output: AnyPath) -> dict[str, object]:
    """Write a detector as ONNX.

    Reads a run or weights; writes an ONNX file, whose metadata name classes, input, and output. RF-DETR has its own
    exporter, a detector of transformers PyTorch's.

    Parameters
    ----------
    run
        Folder of a finished training, or weights: a file of RF-DETR, or a folder of transformers.
    output
        The .onnx file.

    Returns
    -------
    Its metadata.

    Examples
    --------
    >>> export_model("run", "model.onnx")["classes"]  # doctest: +SKIP
    ['tank', 'truck']
    """
    require_training_extra()
    import onnx

    from hulldown.training.detectors.transformers_detector import TransformersDetector

    output = Path(output)
    if output.suffix.lower() != ".onnx":
        raise HulldownError("doesn't end in .onnx", path=output, remedy="name it model.onnx, for example")
    require_replaceable_file(output, "a network", PRODUCER_FIELD)
    weights = find_weights(Path(run))
    detector = load_detector(weights, "cpu")
    if isinstance(detector, TransformersDetector):
        content, normalized = _transformers_onnx_bytes(detector), bool(detector.processor.do_normalize)
    else:
        content, normalized = _detr_onnx_bytes(weights), True
    model = onnx.load_from_string(content)
    model.producer_name = "hulldown"
    about: dict[str, object] = {
        "classes": list(detector.classes),
        "input": NORMALIZED_INPUT if normalized else INPUT_DESCRIPTION,
        "output": OUTPUT_DESCRIPTION,
    }
    onnx.helper.set_model_props(
        model, {key: value if isinstance(value, str) else json.dumps(value) for key, value in about.items()}
    )
    replace_file(output, model.SerializeToString())
    return about


def _transformers_onnx_bytes(detector: TransformersDetector) -> bytes:
    import torch

    width, height = detector.size

    class Found(torch.nn.Module):
        """The network with RF-DETR's outputs."""

        def __init__(self) -> None:
            super().__init__()
            self.network = detector.network

        def forward(self, pictures: torch.Tensor) -> tuple[torch.Tensor, ...]:
            found = self.network(pixel_values=pictures)
            return found.pred_boxes, found.logits

    content = io.BytesIO()
    with silence_libraries(), torch.no_grad():
        torch.onnx.export(
            Found(), (torch.zeros(1, 3, height, width),), content, dynamo=False,  # its successor needs onnxscript
            input_names=["input"], output_names=["dets", "labels"],
        )  # fmt: skip
    return content.getvalue()


def _detr_onnx_bytes(weights: Path) -> bytes:
    with tempfile.TemporaryDirectory() as folder, silence_libraries():
        from rfdetr import RFDETR

        RFDETR.from_checkpoint(str(weights), device="cpu").export(output_dir=folder, verbose=False)
        return next(Path(folder).glob("*.onnx")).read_bytes()
