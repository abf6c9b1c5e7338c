"""Evaluate files of detections, and write report.json, metrics.csv, report.html, and sheets."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import msgspec
import orjson
from cyclopts import Parameter
from msgspec.structs import asdict

from hulldown.base.arguments import AnyPath, Overlap, Share
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.base.files import replace_file
from hulldown.base.outputs import OutputFolder
from hulldown.base.terminal import progress_bar
from hulldown.training.evaluation.average_precision import AP_NAMES
from hulldown.training.evaluation.detector_report import DetectorReport, DetectorReports, comparison_for_report, detector_report
from hulldown.training.evaluation.evaluate import Evaluation, Threshold, best_threshold, compare_detectors
from hulldown.training.evaluation.evaluation_page import comparison_page, evaluation_page, write_error_sheets
from hulldown.training.evaluation.labels import Labels, read_labels
from hulldown.training.evaluation.metrics import COUNT_METRICS, DERIVED_METRICS
from hulldown.training.evaluation.predictions import Predictions, read_predictions

REPORT_COLUMNS = ("predictions", "scope", *COUNT_METRICS, *DERIVED_METRICS, *AP_NAMES, "threshold", "threshold_source", "iou")


def evaluate_detections(
    dataset: AnyPath,
    predictions: Sequence[AnyPath] | AnyPath,
    output: AnyPath,
    *,
    threshold: Share = 0.5,
    validation: Annotated[Sequence[AnyPath], Parameter(consume_multiple=True)] = (),
    iou: Overlap = 0.5,
    progress: Callable[[int, int], None] | None = None,
) -> DetectorReport | DetectorReports:
    """Evaluate detections, with intervals.

    Reads a dataset and COCO results of any detector; writes report.html and report.json. Several files of results are
    compared with the first.

    Parameters
    ----------
    dataset
        A folder, or a COCO file next to its pictures.
    predictions
        Files of COCO results; in Python also a single one.
    output
        Folder of report.html, report.json, metrics.csv, and sheets of misses and false positives, made if missing; for
        several files of detections, a folder for each too.
    threshold
        The confidence threshold.
    validation
        Another dataset and each detector's detections in it, to choose the threshold with the highest F1 there.
    iou
        Least IoU of a match.
    progress
        Called with (done, all) after each step; None: a bar in a terminal or notebook.

    Returns
    -------
    The contents of ``report.json``: `DetectorReports` for several files of detections.

    Raises
    ------
    DatasetError
        If a file can't be read or doesn't fit the dataset, or there is no threshold. Nothing is written then.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from hulldown.dataset.coco import CocoDataset
    >>> folder = Path(mkdtemp())
    >>> with CocoDataset.open(folder, categories=["truck"]) as dataset:
    ...     label = {"category": "truck", "bbox": [10, 10, 80, 40]}
    ...     _ = dataset.append({"file_name": "1.jpg", "width": 640, "height": 480}, [label])
    >>> result = {"image_id": 1, "category_id": 1, "bbox": [10, 10, 80, 40], "score": 0.9}
    >>> _ = (folder / "found.json").write_bytes(orjson.dumps([result]))
    >>> evaluate_detections(folder, folder / "found.json", mkdtemp()).overall.recall
    1.0
    """
    if not (isinstance(threshold, int | float) and 0 <= threshold <= 1):
        raise ValueError(f"threshold: expected a number from 0 to 1, got {threshold!r}")
    if not 0 < iou <= 1:
        raise ValueError(f"iou: expected a number above 0 and up to 1, got {iou!r}")
    output = Path(output)
    several = [predictions] if isinstance(predictions, str | os.PathLike) else predictions
    paths = [Path(path) for path in several]
    if validation and len(validation) != len(paths) + 1:
        raise HulldownError(
            f"--validation names {len(validation) - 1} files of detections where {len(paths)} are evaluated",
            remedy="name a dataset and then the detections of each detector in it",
        )
    with progress_bar("evaluating", progress) as advance, ExitStack() as stack:
        labels = read_labels(Path(dataset))
        read = [
            read_predictions(path, labels, name=name) for path, name in zip(paths, _unique_prediction_names(paths), strict=True)
        ]
        if validation:
            valid = read_labels(Path(validation[0]))
            others = [read_predictions(Path(path), valid, name=str(path)) for path in validation[1:]]
            thresholds = [_validation_threshold(valid, one, iou) for one in others]
        else:
            thresholds = [Threshold(float(threshold), "given")] * len(read)
        reports, evaluations = {}, []
        stack.enter_context(OutputFolder(output, "evaluation", inputs=[Path(dataset), *paths]))
        for k, (detections, at) in enumerate(zip(read, thresholds, strict=True), start=1):
            one = Evaluation(labels, detections, threshold=at, iou=iou)
            found = detector_report(one)
            evaluations.append(one)
            reports[detections.name] = found
            folder = output / detections.name if len(paths) > 1 else output
            folder.mkdir(exist_ok=True)
            _write_report_files(
                folder, {detections.name: found}, found, evaluation_page(one, found, write_error_sheets(folder, one))
            )
            advance(k, len(paths))
        if len(evaluations) == 1:
            return found
        compared = [compare_detectors(evaluations[0], other) for other in evaluations[1:]]
        written = DetectorReports(reports, [comparison_for_report(one) for one in compared])
        _write_report_files(output, reports, written, comparison_page(evaluations, reports, compared))
        return written


def _validation_threshold(labels: Labels, predictions: Predictions, iou: float) -> Threshold:
    best = best_threshold(labels, predictions, iou=iou)
    if best is None:
        remedy = "give one with --threshold"
        raise DatasetError("has nothing to choose a threshold from", path=predictions.name, remedy=remedy)
    return Threshold(best, "validation")


def _unique_prediction_names(paths: Sequence[Path]) -> list[str]:
    """Return names of files of detections: the file's, with its folder if needed to tell them apart, or numbers."""
    for names in (
        [path.stem for path in paths],
        [path.resolve().parent.name or path.stem for path in paths],
        [f"{path.resolve().parent.name}-{path.stem}" for path in paths],
    ):
        if max(Counter(name.casefold() for name in names).values()) == 1:
            return names
    return [f"{path.stem}-{k}" for k, path in enumerate(paths, start=1)]


def _write_report_files(
    folder: Path, reports: Mapping[str, DetectorReport], written: DetectorReport | DetectorReports, page: str
) -> None:
    replace_file(folder / "metrics.csv", detector_reports_csv(reports).encode())
    replace_file(folder / "report.json", orjson.dumps(msgspec.to_builtins(written), option=orjson.OPT_INDENT_2) + b"\n")
    replace_file(folder / "report.html", page.encode())


def detector_reports_csv(reports: Mapping[str, DetectorReport]) -> str:
    """Return CSV with a line for all classes (``overall``) and each (``per_class.NAME``), per file of detections."""
    text = io.StringIO()
    writer = csv.DictWriter(text, REPORT_COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for name, found in reports.items():
        rows = {"overall": found.overall} | {f"per_class.{key}": row for key, row in found.per_class.items()}
        writer.writerows({**asdict(row), "predictions": name, "scope": scope} for scope, row in rows.items())
    return text.getvalue()
