"""Evaluating detections: matching, figures, causes, intervals; pycocotools and faster-coco-eval in the same process."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from faster_coco_eval import COCO as FasterCOCO
from faster_coco_eval import COCOeval_faster
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from hulldown.benchmarks.tables import table
from hulldown.dataset.images import Image, Label
from hulldown.training.evaluation.average_precision import average_precision
from hulldown.training.evaluation.bootstrap import RESAMPLES, figure_intervals, resampled_sums
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import match, overlapping
from hulldown.training.evaluation.metrics import confusion, curves, denominators, figures, sums_by
from hulldown.training.evaluation.predictions import Predictions
from hulldown.training.evaluation.tide import errors

CLASSES, LABELS, DETECTIONS = 3, 3, 10  # of each image the last two
OURS = "everything but AP (hulldown)"
PYCOCOTOOLS = "pycocotools evaluate"
FASTER = "faster-coco-eval evaluate"
AFTER = "AP: faster-coco-eval, loading included"


def run(quick: bool) -> dict:
    """Measure."""
    sizes, rounds = ((500, 2_000), 2) if quick else ((1_000, 10_000, 100_000), 3)
    return {
        "labels": LABELS,
        "detections": DETECTIONS,
        "resamples": RESAMPLES,
        "sizes": {str(n): _at(n, rounds if n < 100_000 else 1) for n in sizes},
    }


def report(results: dict) -> str:
    """A Markdown section."""
    sizes = results["sizes"]
    every = [step for step in next(iter(sizes.values())) if step != "same"]
    steps = every[every.index(OURS) :]  # those before are parts of the sum
    rows = [(step, *(f"{size[step]:.3g}" for size in sizes.values())) for step in steps]
    for peer in (PYCOCOTOOLS, FASTER):
        rows.append((f"{OURS} over {peer}", *(f"{size[OURS] / size[peer]:.2f}" for size in sizes.values())))
    return "\n\n".join([
        "## Evaluation",
        f"Seconds for {results['labels']} labels and {results['detections']} detections an image in {CLASSES} classes. "
        "The peers' `evaluate` matches at ten IoUs in four ranges of area. hulldown's time includes causes and "
        f"intervals of {results['resamples']:,} resamples over images. "
        f"Counts at an IoU of 0.5 agree: {'yes' if all(size['same'] for size in sizes.values()) else 'NO'}.",
        table(["images", *(f"{int(n):,}" for n in sizes)], rows),
    ])  # fmt: skip


def plots(results: dict, folder: Path) -> list[Path]:
    """Seconds against images."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for step in (OURS, PYCOCOTOOLS, FASTER):
        axes.plot(
            [int(n) for n in results["sizes"]], [size[step] for size in results["sizes"].values()], "o-", label=step
        )
    axes.set(xscale="log", yscale="log", xlabel="images", ylabel="seconds")
    axes.legend()
    path = folder / "evaluation.png"
    figure.savefig(path, dpi=120)
    return [path]


def _at(images: int, rounds: int) -> dict:
    labels, predictions = _scene(images)
    true, found = _records(labels, predictions)
    loaded = [(eval_, *_loaded(coco, true, found)) for coco, eval_ in ((COCO, COCOeval), (FasterCOCO, COCOeval_faster))]
    spent: dict[str, list[float]] = {}

    def timed(step: str, work: Callable, *arguments: object) -> Any:
        started = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            done = work(*arguments)
        spent.setdefault(step, []).append(time.perf_counter() - started)
        return done

    same = True
    for _ in range(rounds):
        pairs = timed("overlaps", overlapping, labels, predictions)
        matching = timed("matching", match, labels, predictions, pairs)
        seen = matching.above(0.5)
        timed("curves, confusion", _drawn, seen)
        timed("causes", errors, matching)
        timed("intervals", _intervals, seen)
        first, _ = (timed(name, _evaluated, *peer) for name, peer in zip((PYCOCOTOOLS, FASTER), loaded, strict=True))
        # Every match at the first of ten IoUs, in the range of all areas.
        everywhere = [one for one in first.evalImgs if one and one["aRng"] == [0, 1e10]]
        same &= sum(int((one["dtMatches"][0] > 0).sum()) for one in everywhere) == int((matching.box >= 0).sum())
        timed(AFTER, average_precision, labels, predictions)
    seconds = {step: float(np.median(times)) for step, times in spent.items()}
    ours = ("overlaps", "matching", "curves, confusion", "causes", "intervals")
    return {
        **{step: seconds[step] for step in ours},
        OURS: sum(seconds[step] for step in ours),
        PYCOCOTOOLS: seconds[PYCOCOTOOLS],
        FASTER: seconds[FASTER],
        AFTER: seconds[AFTER],
        "same": bool(same),
    }


def _drawn(seen) -> None:
    curves(seen)
    confusion(seen)


def _intervals(seen) -> None:
    labels, predictions = seen.labels, seen.predictions
    sums = sums_by(seen, of_detection=predictions.class_index, of_label=labels.class_index, bins=CLASSES).sum(axis=1)
    figure_intervals(figures(sums.sum(axis=0)), figures(resampled_sums(sums)), denominators(sums))


def _scene(images: int) -> tuple[Labels, Predictions]:
    """Labels, and detections most of which lie near one."""
    rng = np.random.default_rng(0)
    g, d = images * LABELS, images * DETECTIONS
    xywh = np.concatenate([rng.uniform(0, 1500, (g, 2)), rng.uniform(10, 200, (g, 2))], axis=1)
    label = rng.integers(0, CLASSES, g)
    image = np.repeat(np.arange(images), DETECTIONS)
    near = image * LABELS + rng.integers(0, LABELS, d)
    found = xywh[near] + np.tile(xywh[near, 2:], 2) * rng.normal(0, 0.15, (d, 4))
    found[:, 2:] = np.abs(found[:, 2:]) + 1.0
    stray = rng.random(d) < 0.4
    found[stray, :2] = rng.uniform(0, 1500, (int(stray.sum()), 2))
    names = tuple("abc"[:CLASSES])
    ids = np.arange(1, CLASSES + 1)
    records = ({"id": i + 1, "file_name": f"{i}.png", "width": 1920, "height": 1080} for i in range(images))
    boxes = zip(np.repeat(np.arange(images), LABELS).tolist(), label.tolist(), xywh.tolist(), strict=True)
    true = [{"id": k + 1, "image_id": i + 1, "category_id": c + 1, "bbox": box} for k, (i, c, box) in enumerate(boxes)]
    labels = Labels(
        Path("d"), ids, names, np.repeat(np.arange(images), LABELS), label, xywh,
        xywh[:, 2] * xywh[:, 3], np.zeros(g, dtype=bool), [Image.of(record, ()) for record in records],
        [Label.of(record, dict(enumerate(names, start=1))) for record in true],
    )  # fmt: skip
    classes = np.where(rng.random(d) < 0.9, label[near], rng.integers(0, CLASSES, d))
    score = rng.random(d)
    order = np.lexsort((-score, classes, image))
    return labels, Predictions("found", names, image, classes[order], found[order], score[order])


def _records(labels: Labels, predictions: Predictions) -> tuple[dict, list[dict]]:
    """Return labels and detections in COCO's form, for the peers."""
    true = [
        {"id": k + 1, "image_id": i + 1, "category_id": c + 1, "bbox": box, "area": box[2] * box[3], "iscrowd": 0}
        for k, (i, c, box) in enumerate(
            zip(labels.image.tolist(), labels.class_index.tolist(), labels.xywh.tolist(), strict=True)
        )
    ]
    columns = (predictions.image, predictions.class_index, predictions.xywh, predictions.score)
    found = [
        {"image_id": i + 1, "category_id": c + 1, "bbox": box, "score": score}
        for i, c, box, score in zip(*(column.tolist() for column in columns), strict=True)
    ]
    categories = [{"id": int(i), "name": name} for i, name in zip(labels.class_id, labels.class_names, strict=True)]
    return {
        "info": {},
        "images": [image.record for image in labels.images],
        "categories": categories,
        "annotations": true,
    }, found


def _loaded(kind: type, true: dict, found: list[dict]) -> tuple[object, object]:
    with contextlib.redirect_stdout(io.StringIO()):
        coco = kind()
        coco.dataset = {**true, "annotations": [dict(one) for one in true["annotations"]]}
        coco.createIndex()
        return coco, coco.loadRes([dict(one) for one in found])


def _evaluated(kind: type, true: object, found: object) -> object:
    evaluation = kind(true, found, "bbox")
    evaluation.evaluate()
    return evaluation
