"""Average precision of a detector on a dataset during training: a figure for the report that decides nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hulldown.dataset.picture_files import read_pixels
from hulldown.training.detectors.detector import Detector
from hulldown.training.evaluation.average_precision import AVERAGES, average_precision
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.predictions import Predictions
from hulldown.training.sources import Source

BATCH = 8


def validation_figures(
    detector: Detector, source: Source, *, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, float]:
    """`AVERAGES` of a detector over all classes; 0 where nothing is defined.

    Parameters
    ----------
    detector
        Its classes are the source's.
    source
        Pictures with labels.
    progress
        Told (pictures done, all).
    """
    found = []
    for start in range(0, len(source), BATCH):
        indices = range(start, min(start + BATCH, len(source)))
        pictures = [
            read_pixels(source.folder / source.file_names[i], (int(source.sizes[i, 0]), int(source.sizes[i, 1])))
            for i in indices
        ]
        found += detector.detect(pictures)
        progress(indices.stop, len(source))
    ids = np.arange(1, len(detector.classes) + 1)
    labels = Labels(
        path=source.folder,
        folder=source.folder,
        image_id=np.arange(len(source)),
        class_id=ids,
        class_names=detector.classes,
        image=np.repeat(np.arange(len(source)), np.diff(source.starts)),
        label=source.label,
        xywh=source.xywh,
        area=source.xywh[:, 2] * source.xywh[:, 3],
        crowd=np.zeros(len(source.label), dtype=bool),
        images=[{}] * len(source),
        annotations=[{}] * len(source.label),
    )
    predictions = Predictions(
        name="validation",
        class_id=ids,
        class_names=detector.classes,
        image=np.repeat(np.arange(len(source)), [len(one.score) for one in found]),
        label=np.concatenate([one.label for one in found]),
        xywh=np.concatenate([one.xywh for one in found]),
        score=np.concatenate([one.score for one in found]),
    )
    summary = average_precision(labels, predictions).summary
    return {key: float(np.nan_to_num(summary[key])) for key in AVERAGES}
