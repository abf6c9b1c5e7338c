"""Labels and detections for tests of evaluation: random, hard, and handwritten."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hulldown.dataset.images import LabeledImages
from hulldown.training.evaluation.labels import Labels, labels_from_images
from hulldown.training.evaluation.matching import match_detections
from hulldown.training.evaluation.metrics import metric_sums_by_bin
from hulldown.training.evaluation.predictions import Predictions, predictions_from_results

HERE = Path("dataset")


def dataset(boxes, *, images=1, classes=("tank", "truck")):
    """A COCO dictionary: `boxes` are (image, class, xywh) or also have a dictionary of more fields; numbered from 1."""
    return {
        "images": [{"id": i + 1, "file_name": f"images/{i + 1}.png", "width": 640, "height": 480} for i in range(images)],
        "categories": [{"id": i + 1, "name": name} for i, name in enumerate(classes)],
        "annotations": [
            {"id": k, "image_id": image, "category_id": label, "bbox": [float(n) for n in box], "iscrowd": 0} | dict(*more)
            for k, (image, label, box, *more) in enumerate(boxes, start=1)
        ],
    }


def results(found):
    """COCO results: `found` are (image, class, xywh, score)."""
    return [
        {"image_id": image, "category_id": label, "bbox": [float(n) for n in box], "score": float(score)}
        for image, label, box, score in found
    ]


def loaded(coco, found) -> tuple[Labels, Predictions]:
    labels = labels_from_images(LabeledImages.from_coco_dict(coco), path=HERE)
    return labels, predictions_from_results(found, labels, path=Path("predictions.json"), name="predictions")


def matched(coco, found):
    return match_detections(*loaded(coco, found))


def by_position(seen):
    """`metrics.SUM_METRICS` of each position."""
    all_of = {"of_detection": np.zeros(len(seen.box), dtype=int), "of_label": np.zeros(len(seen.detection), dtype=int)}
    return metric_sums_by_bin(seen, **all_of, bins=1)[:, 0]


def total(seen):
    """`metrics.SUM_METRICS` of all images and classes."""
    return by_position(seen).sum(axis=0)


def random_case(seed, *, images=12, classes=3, per_image=6, crowds=0.1, ties=True):
    """Boxes on a coarse grid, so that overlaps of exactly 0.5, equal overlaps, and equal scores are common."""
    rng = np.random.default_rng(seed)

    def box():
        return np.concatenate([rng.integers(0, 6, 2) * 10, rng.integers(1, 5, 2) * 10]).tolist()

    boxes = [
        (i + 1, int(rng.integers(classes)) + 1, box(), {"iscrowd": int(rng.random() < crowds)})
        for i in range(images)
        for _ in range(rng.integers(per_image + 1))
    ]
    found = []
    for i in range(images):
        for _ in range(rng.integers(2 * per_image + 1)):
            score = round(float(rng.random()), 1 if ties else 6)
            found.append((i + 1, int(rng.integers(classes)) + 1, box(), score))
    rng.shuffle(boxes)
    rng.shuffle(found)
    names = tuple("abcdefgh"[:classes])
    return dataset(boxes, images=images, classes=names), results(found)
