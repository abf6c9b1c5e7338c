"""Average precision of a detector on a dataset, by pycocotools: a figure for the report, which decides nothing."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from dataset.picture_files import read_pixels
from training.detector import Detector
from training.sources import Source

BATCH = 8


def average_precision(
    detector: Detector, source: Source, *, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, float]:
    """``ap`` (IoU 0.5 to 0.95), ``ap50`` and ``ap75`` over all classes, as COCO defines them.

    Parameters
    ----------
    detector
        Its classes are the source's.
    source
        Pictures with labels.
    progress
        Told (pictures done, all).
    """
    results = []
    for start in range(0, len(source), BATCH):
        indices = range(start, min(start + BATCH, len(source)))
        pictures = [
            read_pixels(source.folder / source.file_names[i], (int(source.sizes[i, 0]), int(source.sizes[i, 1])))
            for i in indices
        ]
        for i, found in zip(indices, detector.detect(pictures), strict=True):
            results += [
                {"image_id": i + 1, "category_id": int(label) + 1, "bbox": xywh.tolist(), "score": float(score)}
                for xywh, score, label in zip(found.xywh, found.score, found.label, strict=True)
            ]
        progress(indices.stop, len(source))
    if not results:
        return {"ap": 0.0, "ap50": 0.0, "ap75": 0.0}
    truth = COCO()
    owner = np.repeat(np.arange(len(source)), np.diff(source.starts))
    truth.dataset = {
        "info": {},
        "images": [{"id": i + 1} for i in range(len(source))],
        "categories": [{"id": i + 1, "name": name} for i, name in enumerate(detector.classes)],
        "annotations": [
            {
                "id": k + 1, "image_id": int(i) + 1, "category_id": int(label) + 1, "bbox": xywh.tolist(),
                "area": float(xywh[2] * xywh[3]), "iscrowd": 0,
            }
            for k, (i, label, xywh) in enumerate(zip(owner, source.label, source.xywh, strict=True))
        ],
    }  # fmt: skip
    with contextlib.redirect_stdout(io.StringIO()):  # it prints what it does
        truth.createIndex()
        evaluation = COCOeval(truth, truth.loadRes(results), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return {key: float(value) for key, value in zip(("ap", "ap50", "ap75"), evaluation.stats, strict=False)}
