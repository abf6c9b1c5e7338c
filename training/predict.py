"""A detector's finds in every image of a dataset, as COCO results; what was interrupted goes on."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from jaxtyping import UInt8

from hulldown.dataset.picture_files import read_pixels
from hulldown.geometry.errors import HulldownError
from hulldown.geometry.files import make_room, open_in_place, replace_file
from hulldown.geometry.terminal import shown
from hulldown.training.detectors.detector import (
    WEIGHTS_NAME,
    Detections,
    Detector,
    DetectorError,
    chosen_device,
    read_run,
)
from hulldown.training.evaluation.average_precision import AVERAGES, average_precision
from hulldown.training.evaluation.labels import Labels, read_labels
from hulldown.training.evaluation.predictions import INFO_SUFFIX, predictions_of
from hulldown.training.extra import require_extra

UNFINISHED_SUFFIX = ".unfinished"  # beside the results: a line for each image that is done
READERS = 2
BATCH = 8
DIGITS = 3  # decimals of a pixel
Picture = UInt8[np.ndarray, "h w 3"]
Found = list[dict[str, Any]]  # COCO results of an image


@dataclass(frozen=True, slots=True)
class Predicted:
    """What a run of `predict` has done.

    Parameters
    ----------
    images, detections
        How many the results hold.
    already
        Of these images, how many were done before.
    unknown
        Classes of the detector that the dataset lacks; they have got ids of their own.
    """

    images: int
    detections: int
    already: int
    unknown: tuple[str, ...]


def load_detector(path: Path | str, device: str = "auto") -> Detector:
    """The detector of a run folder, or of an RF-DETR checkpoint.

    Parameters
    ----------
    path
        A folder that `hulldown train` has finished, or a checkpoint file of RF-DETR (.pth, .pt, .ckpt).
    device
        ``"auto"``: a GPU if there is one; or a name that PyTorch knows, such as ``"cpu"`` or ``"cuda:1"``.

    Raises
    ------
    DetectorError
        If it is neither, the run is not finished, or the device does not exist.
    """
    require_extra()
    path = Path(path)
    if not path.is_dir():
        from hulldown.training.detectors.detr import load_checkpoint

        return load_checkpoint(path, device=chosen_device(device))
    run = read_run(path)
    if run.get("status") != "finished":
        raise DetectorError(
            f"training is {run.get('status')}, not finished", path=path, remedy="run the same `hulldown train` again"
        )
    weights = path / WEIGHTS_NAME
    if run["model"] == "small":
        from hulldown.training.detectors.small import load_small

        return load_small(weights, device=chosen_device(device))
    from hulldown.training.detectors.detr import load_checkpoint

    return load_checkpoint(weights, device=chosen_device(device))


def predict(
    run: str | os.PathLike[str],
    dataset: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    device: str = "auto",
    batch: int = BATCH,
    progress: Callable[[int, int], None] | None = None,
) -> Predicted:
    """Look at every image of a dataset and write COCO results, and beside them which images were looked at.

    Parameters
    ----------
    run
        Folder of a finished training, or a checkpoint of RF-DETR.
    dataset
        See `training.evaluation.labels.read_labels`; its labels are not looked at.
    output
        The file of results. ``OUTPUT.info.json`` lists the images, so that those without detections are known too.
    device
        See `load_detector`.
    batch
        Images that go through the network at once.
    progress
        Told (done, all) after each batch; None for a bar on a terminal or in a notebook.

    Raises
    ------
    HulldownError
        If the detector cannot be loaded, knows none of the dataset's classes, or a picture cannot be read. What was
        done until then is kept, and the same call goes on from there.

    Examples
    --------
    >>> predict("run", "photographs", "predictions.json").images  # doctest: +SKIP
    120
    """
    require_extra()
    output = Path(output)
    make_room(output)
    labels = read_labels(Path(dataset))
    detector = load_detector(Path(run), device)
    ids, unknown = _category_ids(detector.classes, labels)
    key = _key(Path(run), labels, detector.classes)
    unfinished = output.with_name(output.name + UNFINISHED_SUFFIX)
    with shown("predicting", progress) as advance, _kept(unfinished, key) as (done, keep):
        already = len(done)
        left = [k for k, image in enumerate(labels.image_id.tolist()) if image not in done]
        for found in _detected(detector, labels, ids, left, batch):
            keep(found)
            advance(len(done), len(labels.images))
    results = [one for image in labels.image_id.tolist() for one in done[image]]
    info = {
        "detector": str(run),
        "images": labels.image_id.tolist(),
        "categories": [
            {"id": i, "name": name} for i, name in zip(ids, detector.classes, strict=True) if name in unknown
        ],
    }
    beside = output.with_name(output.name + INFO_SUFFIX)
    beside.unlink(missing_ok=True)  # of earlier results, which it must not outlive
    for path, value in ((output, results), (beside, info)):
        replace_file(path, orjson.dumps(value) + b"\n")
    unfinished.unlink()
    return Predicted(len(labels.images), len(results), already, unknown)


def validation_figures(
    detector: Detector, labels: Labels, *, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, float]:
    """AP, AP50 and AP75 of a detector over all classes, as `evaluate` has them; 0 where nothing is defined.

    Parameters
    ----------
    detector
        Its classes are the dataset's.
    labels
        What is to be found.
    progress
        Told (images done, all).
    """
    ids, _ = _category_ids(detector.classes, labels)
    done: dict[int, Found] = {}
    for found in _detected(detector, labels, ids, range(len(labels.images)), BATCH):
        done |= found
        progress(len(done), len(labels.images))
    results = [one for found in done.values() for one in found]
    predictions = predictions_of(results, labels, path=labels.path, name="validation")
    summary = average_precision(labels, predictions).summary
    return {key: float(np.nan_to_num(summary[key])) for key in AVERAGES}


def _detected(
    detector: Detector, labels: Labels, ids: Sequence[int], indices: Sequence[int], batch: int
) -> Iterator[dict[int, Found]]:
    """The results of some images by their ids, a batch at a time."""
    for chunk, pictures in _batches(labels, indices, batch):
        images = [int(labels.image_id[k]) for k in chunk]
        found = zip(images, detector.detect(pictures), strict=True)
        yield {image: _results(image, one, ids) for image, one in found}


def _results(image: int, found: Detections, ids: Sequence[int]) -> Found:
    columns = found.label.tolist(), found.xywh.round(DIGITS).tolist(), found.score.tolist()
    return [
        {"image_id": image, "category_id": ids[label], "bbox": box, "score": score}
        for label, box, score in zip(*columns, strict=True)
    ]


def _category_ids(classes: Sequence[str], labels: Labels) -> tuple[list[int], tuple[str, ...]]:
    """The dataset's id of each of the detector's classes, by name; new ones above all others for those it lacks."""
    by_name = dict(zip(labels.class_names, labels.class_id.tolist(), strict=True))
    unknown = tuple(name for name in classes if name not in by_name)
    if len(unknown) == len(classes):
        raise HulldownError(
            f"has none of the detector's classes: it has {', '.join(labels.class_names) or 'none'}; the detector knows "
            f"{', '.join(classes)}",
            path=labels.path,
            remedy="rename the categories of the dataset, to the letter",
        )
    following = max(by_name.values(), default=0) + 1
    new = {name: following + k for k, name in enumerate(unknown)}
    return [by_name[name] if name in by_name else new[name] for name in classes], unknown


def _key(run: Path, labels: Labels, classes: Sequence[str]) -> str:
    """What makes results these and no others: weights, classes, and which images are looked at."""
    digest = hashlib.sha256()
    with (run / WEIGHTS_NAME if run.is_dir() else run).open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    images = [[record["id"], record["file_name"], record["width"], record["height"]] for record in labels.images]
    digest.update(orjson.dumps([list(classes), images, labels.class_id.tolist(), labels.class_names]))
    return digest.hexdigest()


@contextmanager
def _kept(path: Path, key: str) -> Iterator[tuple[dict[int, Found], Callable[[dict[int, Found]], None]]]:
    """Yield what an interrupted call has found, by image, and what adds to it and to its file.

    Nothing was found before if the file is about something else. A last line that was cut off is lost.
    """
    done: dict[int, Found] = {}
    with suppress(FileNotFoundError, orjson.JSONDecodeError), path.open("rb") as before:
        for line in before if orjson.loads(before.readline()) == key else ():
            image, found = orjson.loads(line)
            done[image] = found

    def lines(some: Mapping[int, Found]) -> bytes:
        return b"".join(orjson.dumps(item) + b"\n" for item in some.items())

    replace_file(path, orjson.dumps(key) + b"\n" + lines(done))
    with open_in_place(path) as file:

        def keep(some: dict[int, Found]) -> None:
            file.write(lines(some))
            file.flush()
            done.update(some)

        yield done, keep


def _batches(labels: Labels, indices: Sequence[int], size: int) -> Iterator[tuple[list[int], list[Picture]]]:
    """Images and their pictures, the next batch read while the network works on this one."""

    def read(k: int) -> Picture:
        record = labels.images[k]
        return read_pixels(labels.folder / record["file_name"], (record["width"], record["height"]))

    chunks = [list(indices[start : start + size]) for start in range(0, len(indices), size)]
    with ThreadPoolExecutor(READERS) as pool:
        coming: list[Iterable[Picture]] = [pool.map(read, chunk) for chunk in chunks[:1]]
        for n, chunk in enumerate(chunks):
            coming += [pool.map(read, following) for following in chunks[n + 1 : n + 2]]
            yield chunk, list(coming.pop(0))
