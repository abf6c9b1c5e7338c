"""Run a detector on pictures and write COCO results; an interrupted call can be continued."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Annotated, TypedDict

import numpy as np
import orjson
from cyclopts import Parameter
from PIL import Image

from hulldown.annotate.drawing import Overlay, picture_with_labels
from hulldown.base.arguments import AnyPath, Count, Overlap, make_option_parser
from hulldown.base.errors import HulldownError
from hulldown.base.files import atomic_writer, open_file_to_append, open_regular_file, replace_file
from hulldown.base.outputs import OutputError, OutputFolder, OutputLock, require_replaceable_file
from hulldown.base.outside import file_sha256, parse_json
from hulldown.base.terminal import progress_bar
from hulldown.training.detectors.detector import Detector, find_weights, usable_torch_device, weights_digest
from hulldown.training.evaluation.average_precision import AP_NAMES, coco_summary
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.predictions import (
    INFO_SUFFIX,
    NewCategory,
    PredictionInfo,
    Predictions,
    predictions_from_results,
)
from hulldown.training.input_pictures import Pictures, find_pictures
from hulldown.training.inputs.extra import require_training_extra
from hulldown.training.run_folder import starting_weights

UNFINISHED_SUFFIX = ".unfinished"  # a file next to the results, with a line for each finished image
INFO_MARK, RESULTS_MARK = b'{"detector":', b"["
BATCH_PICTURES = 8
PIXEL_DECIMALS = 3
START_RIVALS = "start"  # as rivals, the weights that a run started from
DEFAULT_SCORE_THRESHOLD = 0.5  # for counted and drawn detections


def parse_tile_size(text: str) -> tuple[int, int]:
    """Parse "WxH" as width and height."""
    width, height = map(int, text.lower().split("x"))
    if min(width, height) < 32:
        raise ValueError(text)
    return width, height


TILE_PARSER = make_option_parser("WxH of at least 32, such as 640x480", parse_tile_size, metavar="WxH")


class Result(TypedDict):
    """A COCO result: a detection in an image; `bbox` is xywh in pixels."""

    image_id: int
    category_id: int
    bbox: list[float]
    score: float


ImageResults = list[Result]  # of an image


@dataclass(frozen=True, slots=True)
class Predicted:
    """What `predict_detections` wrote."""

    images: int  # images, detections: number of images and detections in the results
    detections: int
    already: int  # number of images that were done before
    unknown: tuple[str, ...]  # classes of the detector that the dataset lacks; they get new ids
    counts: Mapping[str, int]  # class -> detections with a score of at least the threshold


def load_detector(path: Path | str, device: str = "auto") -> Detector:
    """Return the detector of a run folder, or of weights: a file of RF-DETR, or a folder of transformers."""
    require_training_extra()
    path = find_weights(Path(path))
    chosen = usable_torch_device(device)
    if path.is_dir():
        from hulldown.training.detectors.transformers_detector import load_transformers_detector

        return load_transformers_detector(path, device=chosen)
    from hulldown.training.detectors.detr import load_detr_detector

    return load_detr_detector(path, device=chosen)


def _load_contested_detector(detector: Detector, weights: Path, device: str) -> Detector:
    from hulldown.training.detectors.rivals import ContestedDetector
    from hulldown.training.detectors.transformers_detector import load_transformers_detector

    at_hub = not weights.exists() and len(weights.parts) == 2
    return ContestedDetector(
        detector,
        load_transformers_detector(weights, device=usable_torch_device(device)) if at_hub else load_detector(weights, device),
    )


def predict_detections(
    run: AnyPath,
    pictures: Sequence[AnyPath] | AnyPath,
    output: AnyPath,
    *,
    device: str = "auto",
    batch: Count = BATCH_PICTURES,
    tile: Annotated[tuple[int, int] | None, TILE_PARSER] = None,
    rivals: AnyPath | None = None,
    drawn: Annotated[AnyPath | None, Parameter(name="--draw")] = None,
    threshold: Overlap = DEFAULT_SCORE_THRESHOLD,
    progress: Callable[[int, int], None] | None = None,
) -> Predicted:
    """Detect in pictures, a video, or a dataset.

    Reads a detector and pictures; writes COCO results, with a list of the pictures. The same call continues one that
    was stopped.

    Parameters
    ----------
    run
        Folder of a finished training, or weights: a file of RF-DETR, or a folder of transformers.
    pictures
        A dataset, whose labels aren't used; a video; or pictures, folders, and patterns such as 'photographs/*.jpg'.
    output
        The .json file of results. OUTPUT.info.json lists all images, also those without detections; without a dataset
        also their names and the categories.
    device
        A device of PyTorch; auto is a GPU if there is one.
    batch
        Images, or tiles, that go through the network at once.
    tile
        Detect in overlapping tiles of this width and height in pixels, those of the training pictures: for large
        pictures.
    rivals
        Weights pretrained on COCO, or "start": those that the run's training started from. Where they find a car, bus,
        or motorcycle that isn't one of the detector's classes, scores fall.
    drawn
        A folder for copies of the pictures, or of the video, with detections.
    threshold
        Least score of drawn and counted detections. The results have all.
    progress
        Called with (done, all) after each batch; None: a bar in a terminal or notebook.

    Raises
    ------
    HulldownError
        If the detector can't be loaded, has none of the dataset's classes, or a picture can't be read. Results
        until then are kept, and the same call continues.

    Examples
    --------
    >>> predict("run", "photographs", "predictions.json").images  # doctest: +SKIP
    120
    """
    require_training_extra()
    output = Path(output)
    info_file, unfinished = (output.with_name(output.name + suffix) for suffix in (INFO_SUFFIX, UNFINISHED_SUFFIX))
    named = [pictures] if isinstance(pictures, str | os.PathLike) else list(pictures)
    inputs = [Path(run), *map(Path, named)]
    ours = info_file.exists() or unfinished.exists()  # results have no place for a mark of their own
    require_replaceable_file(info_file, "a list of pictures", INFO_MARK, inputs=inputs)
    require_replaceable_file(output, "detections", RESULTS_MARK if ours else b"", inputs=inputs)
    found = find_pictures(named)
    detector = load_detector(Path(run), device)
    ids, unknown = _category_ids_and_unknown(detector.classes, found)
    rival_weights = None if rivals is None else starting_weights(Path(run)) if str(rivals) == START_RIVALS else Path(rivals)
    key = _results_key(Path(run), found, detector.classes, tile, rival_weights)
    if rival_weights is not None:
        detector = _load_contested_detector(detector, rival_weights, device)
    if tile is not None:
        from hulldown.training.detectors.tiled import TiledDetector

        detector = TiledDetector(detector, tile, batch=batch)
    with ExitStack() as stack:
        stack.enter_context(OutputLock.acquire_for_file(output, "file of detections"))
        if drawn is not None:
            if Path(drawn).resolve() == found.folder.resolve():
                raise OutputError("has the pictures", path=Path(drawn), remedy="name an empty folder by --draw")
            stack.enter_context(OutputFolder(Path(drawn), "drawings", inputs=inputs))
        done = _resume_unfinished_results(unfinished, key, content := _content_hasher(found))
        already = len(done)
        left = [k for k, image in enumerate(found.images) if image.id not in done]
        with progress_bar("predicting", progress) as advance, open_file_to_append(unfinished) as file:
            for some in _detect_in_batches(detector, found, ids, left, batch):
                file.write(_result_lines(some, content))
                file.flush()
                done |= some
                advance(len(done), len(found.images))
        results = [one for image in found.images for one in done[image.id]]
        names = dict(zip(ids, detector.classes, strict=True))
        new = [NewCategory(id=i, name=name) for i, name in names.items() if name not in found.category_ids]
        info = PredictionInfo(detector=str(run), images=[image.id for image in found.images], categories=new)
        if not found.category_ids:
            info["pictures"] = [image.record for image in found.images]
        info_file.unlink(missing_ok=True)  # it's about earlier results
        for path, value in ((output, results), (info_file, info)):
            replace_file(path, orjson.dumps(value) + b"\n")
        if drawn is not None:
            _write_drawn_pictures(found, done, names, Path(drawn), threshold)
        unfinished.unlink()
    counts = Counter(names[one["category_id"]] for one in results if one["score"] >= threshold)
    return Predicted(len(found.images), len(results), already, unknown, dict(counts))


def validation_aps(detector: Detector, labels: Labels) -> dict[str, float]:
    """Return a detector's AP, AP50, and AP75 over all classes, as by `evaluate`; 0 if undefined."""
    summary = coco_summary(labels, detect_in_labeled_pictures(detector, labels))
    return {key: float(np.nan_to_num(summary[key])) for key in AP_NAMES}


def detect_in_labeled_pictures(detector: Detector, labels: Labels) -> Predictions:
    """Return the detections in a dataset's pictures."""
    pictures = Pictures.from_labels(labels)
    ids, _ = _category_ids_and_unknown(detector.classes, pictures)
    batches = _detect_in_batches(detector, pictures, ids, range(len(labels.images)), BATCH_PICTURES)
    results = [one for batch in batches for found in batch.values() for one in found]
    return predictions_from_results(results, labels, path=labels.path, name="validation")


def _detect_in_batches(
    detector: Detector, pictures: Pictures, ids: Sequence[int], indices: Sequence[int], batch: int
) -> Iterator[dict[int, ImageResults]]:
    pixels = pictures.read(indices)
    for start in range(0, len(indices), batch):
        images = [pictures.images[k].id for k in indices[start : start + batch]]
        done: dict[int, ImageResults] = {}
        for image, found in zip(images, detector.detect(list(islice(pixels, batch))), strict=True):
            columns = found.class_index.tolist(), found.xywh.round(PIXEL_DECIMALS).tolist(), found.score.tolist()
            done[image] = [
                {"image_id": image, "category_id": ids[label], "bbox": box, "score": score}
                for label, box, score in zip(*columns, strict=True)
            ]
        yield done


def _category_ids_and_unknown(classes: Sequence[str], pictures: Pictures) -> tuple[list[int], tuple[str, ...]]:
    """Return by name the dataset's id of each of the detector's classes, and new, higher ids for missing ones."""
    by_name = pictures.category_ids
    if not by_name:
        return list(range(1, len(classes) + 1)), ()
    unknown = tuple(name for name in classes if name not in by_name)
    if len(unknown) == len(classes):
        raise HulldownError(
            f"has none of the detector's classes: it has {', '.join(by_name)}; the detector knows {', '.join(classes)}",
            path=pictures.path,
            remedy="rename the categories of the dataset, to the letter",
        )
    following = max(by_name.values()) + 1
    new = {name: following + k for k, name in enumerate(unknown)}
    return [by_name[name] if name in by_name else new[name] for name in classes], unknown


def _write_drawn_pictures(
    pictures: Pictures, found: Mapping[int, ImageResults], names: Mapping[int, str], folder: Path, threshold: float
) -> None:
    def labeled() -> Iterator[tuple[str, Image.Image]]:
        for image, pixels in zip(pictures.images, pictures.read(range(len(pictures.images))), strict=True):
            boxes = [(np.array(one["bbox"]), one["category_id"], one["score"]) for one in found[image.id]]
            shown = [Overlay(box, k, f"{names[k]} {score:.2f}") for box, k, score in boxes if score >= threshold]
            yield image.file_name, picture_with_labels(Image.fromarray(pixels), shown)

    if (video := pictures.video) is not None:
        from supervision import VideoInfo, VideoSink

        target = folder / pictures.path.with_suffix(".mp4").name
        target.unlink(missing_ok=True)  # writing would follow a link
        with VideoSink(str(target), VideoInfo(video.width, video.height, video.fps, video.frames)) as sink:
            for _, picture in labeled():
                sink.write_frame(np.asarray(picture)[..., ::-1])
        return
    for name, picture in labeled():
        target = folder / (name if name.lower().endswith((".jpg", ".jpeg", ".png")) else f"{name}.png")
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_writer(target) as file:
            picture.save(file, format="PNG" if target.suffix.lower() == ".png" else "JPEG", quality=90)


def _results_key(
    run: Path, pictures: Pictures, classes: Sequence[str], tile: tuple[int, int] | None, rivals: Path | None
) -> str:
    digest = hashlib.sha256(weights_digest(run).encode())
    images = [[image.id, image.file_name, *image.size] for image in pictures.images]
    digest.update(orjson.dumps([list(classes), images, sorted(pictures.category_ids.items()), tile]))
    if rivals is not None:
        digest.update((weights_digest(rivals) if rivals.exists() else str(rivals)).encode())
    return digest.hexdigest()


def _content_hasher(pictures: Pictures) -> Callable[[int], str | None]:
    """Return a function from an image's id to the hash of its file; None if it can't be read."""
    files = {image.id: pictures.folder / image.file_name for image in pictures.images}

    @cache
    def file_digest(path: Path) -> str | None:
        try:
            return file_sha256(path)
        except OSError:  # found when it's read
            return None

    return lambda image: file_digest(pictures.path if pictures.video else files[image])


def _resume_unfinished_results(path: Path, key: str, content: Callable[[int], str | None]) -> dict[int, ImageResults]:
    """Return an interrupted call's results with this key by image, without truncated lines and changed images."""
    done: dict[int, ImageResults] = {}
    with suppress(FileNotFoundError, ValueError, KeyError), open_regular_file(path) as before:
        for line in before if parse_json(before.readline(), object) == key else ():
            image, digest, found = parse_json(line, tuple[int, str | None, ImageResults])
            if digest == content(image):
                done[image] = found
    replace_file(path, orjson.dumps(key) + b"\n" + _result_lines(done, content))
    return done


def _result_lines(found: Mapping[int, ImageResults], content: Callable[[int], str | None]) -> bytes:
    return b"".join(orjson.dumps([image, content(image), results]) + b"\n" for image, results in found.items())
