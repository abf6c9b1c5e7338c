"""The verbs from datasets to an evaluated detector: subset, augment, train, predict, export_model, evaluate."""

from __future__ import annotations

import argparse
from pathlib import Path

from hulldown.base.files import make_room
from hulldown.base.terminal import say, warn
from hulldown.verbs.arguments import (
    Subparsers,
    add_verb,
    at_least_one,
    fraction,
    fractions,
    named_folder,
    overlap,
    picture_name,
    tile_size,
)
from hulldown.verbs.output import show_result


def _subset(arguments: argparse.Namespace) -> None:
    from hulldown.training.subset import write_subsets

    counts = write_subsets(
        arguments.dataset, arguments.output, fractions=arguments.fractions, seed=arguments.seed,
        stratified=arguments.stratified,
    )  # fmt: skip
    show_result(arguments, counts)
    say(f"wrote {arguments.output}: " + ", ".join(f"{n} images in {name}" for name, n in counts.items()))


def _augment(arguments: argparse.Namespace) -> None:
    from hulldown.training.inputs.extra import require_extra

    require_extra()
    from hulldown.training.sheet import augmentation_sheet

    make_room(arguments.output)
    sheet = augmentation_sheet(
        arguments.dataset, rows=arguments.rows, seed=arguments.seed, augmentation=arguments.augmentation
    )
    sheet.save(arguments.output)
    say(f"wrote {arguments.output}")


def _train(arguments: argparse.Namespace) -> None:
    from hulldown.training.inputs.extra import require_extra
    from hulldown.training.inputs.settings import FLAGS, load_settings

    settings = load_settings(arguments.config, {name: getattr(arguments, name) for name in FLAGS})
    require_extra()
    from hulldown.training.train import train

    run = train(
        dict(arguments.data), arguments.output, settings=settings, valid=arguments.valid,
        workers=arguments.workers, device=arguments.device, say=say,
    )  # fmt: skip
    show_result(arguments, run)
    if found := run.figures.valid:
        say(f"on {arguments.valid}: AP {found['ap']:.3f}, AP50 {found['ap50']:.3f}")
    say(f"wrote {arguments.output}; next: hulldown predict {arguments.output} DATASET -o predictions.json")


def _predict(arguments: argparse.Namespace) -> None:
    from hulldown.training.predict import predict

    done = predict(
        arguments.detector, arguments.pictures, arguments.output, drawn=arguments.draw,
        threshold=arguments.threshold, device=arguments.device, batch=arguments.batch,
        tile=arguments.tile,
    )  # fmt: skip
    pictures = arguments.pictures[0]
    if done.unknown:
        warn(f"{pictures} has no class {', '.join(done.unknown)}: detections of it count as false positives")
    show_result(arguments, done)
    counts = ", ".join(f"{n} {name}" for name, n in done.counts.items()) or "nothing"
    say(f"found with a score of at least {arguments.threshold:g}: {counts}")
    if arguments.draw:
        say(f"look at {arguments.draw}")
    again = f", {done.already} of them done before" if done.already else ""
    say(f"wrote {arguments.output}: {done.detections} detections in {done.images} images{again}")


def _export_model(arguments: argparse.Namespace) -> None:
    from hulldown.training.inputs.extra import require_extra

    require_extra()
    from hulldown.training.onnx_model import export_model

    about = export_model(arguments.detector, arguments.output)
    show_result(arguments, about)
    say(f"wrote {arguments.output}; {about['input']}; {about['output']}")


def _evaluate(arguments: argparse.Namespace) -> None:
    from hulldown.training.evaluation.detector_report import DetectorReports
    from hulldown.training.evaluation.evaluation_report import evaluate

    found = evaluate(
        arguments.dataset, arguments.predictions, arguments.output, threshold=arguments.threshold, iou=arguments.iou,
        validation=arguments.validation or (),
    )  # fmt: skip
    show_result(arguments, found)
    reports = found.runs if isinstance(found, DetectorReports) else {found.predictions: found}
    for name, one in reports.items():
        figures = (f"{key} {_figure(getattr(one.overall, key))}" for key in ("precision", "recall", "f1", "ap50"))
        say(f"{name}: {', '.join(figures)}")
    say(f"look at {arguments.output / 'report.html'}")


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"


def add(verbs: Subparsers) -> None:
    """Add these verbs to the command."""
    sub = add_verb(
        verbs, "subset", _subset, "make nested subsets of a dataset",
        "Reads a dataset; writes OUT/100, OUT/50 and so on, each within the larger ones, pictures as hard links.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT", required=True, help="a new or an empty folder")
    sub.add_argument(
        "--fractions", type=fractions, default=(1.0, 0.5, 0.25, 0.1, 0.05), metavar="A,B,...",
        help="shares of the images (default: 1,0.5,0.25,0.1,0.05)",
    )  # fmt: skip
    sub.add_argument("--seed", type=int, default=0, help="seed of the selection (default: 0)")
    sub.add_argument("--stratified", action="store_true", help="keep the proportion of classes in each")

    sub = add_verb(
        verbs, "augment", _augment, "show augmented pictures of a dataset",
        "Reads a dataset; writes a sheet: in each row a picture as it is and eight times augmented, with its boxes.",
        json=False,
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=picture_name, metavar="PNG", required=True)
    sub.add_argument("--seed", type=int, default=0, help="seed of the augmentations (default: 0)")
    sub.add_argument("--rows", type=at_least_one, default=6, help="number of pictures, an even selection (default: 6)")
    sub.add_argument(
        "--augmentation", default="table1", metavar="FILE",
        help="an Albumentations file, or table1 (default), mild, or aerial",
    )  # fmt: skip

    sub = add_verb(
        verbs, "train", _train, "train a detector under a fixed budget",
        "Reads datasets; writes RUN with weights, metrics, and config. Other settings are the config's, "
        "or the model's defaults. The same command continues a stopped run.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument(
        "--data", type=named_folder, action="append", required=True, metavar="NAME=DIR",
        help="a dataset to train on, such as real=photographs; may be repeated",
    )  # fmt: skip
    sub.add_argument("-o", "--output", type=Path, metavar="RUN", required=True, help="the run's folder")
    sub.add_argument("--valid", type=Path, metavar="DIR", help="a dataset to measure the result on")
    sub.add_argument("--config", type=Path, metavar="TOML", help="config; docs/training.md has its keys")
    sub.add_argument("--model", help="small, for a CPU; or nano, rf-small, medium, large of RF-DETR (default: medium)")
    sub.add_argument("--budget", type=at_least_one, help="pictures drawn, with replacement (default: 25000)")
    sub.add_argument("--seed", type=int, help="seed of draws, augmentation, and weights (default: 0)")
    sub.add_argument("--resolution", type=at_least_one, help="input size in pixels (default: the model's)")
    sub.add_argument(
        "--weights",
        metavar="WEIGHTS",
        help="where to start: a file of RF-DETR; a folder, or name at the Hugging Face hub, of small; a run; or none "
        "(default: the model's pretrained ones)",
    )
    sub.add_argument(
        "--keep", choices=("end", "best"), help="weights of the end (default), or of the best --valid AP50"
    )
    sub.add_argument("--freeze", choices=("none", "encoder"), help="encoder or backbone isn't trained (default: none)")
    sub.add_argument("--logger", choices=("tensorboard", "wandb", "mlflow"), help="also log there")
    sub.add_argument("--device", default="auto", choices=("auto", "cpu", "gpu"), help="default: auto, GPUs if any")
    sub.add_argument("--workers", type=int, help="processes that augment pictures (default: one per core but one)")

    sub = add_verb(
        verbs, "predict", _predict, "detect in pictures, a video, or a dataset",
        "Reads a run or weights, and pictures; writes COCO results. The same command continues after a stop.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("detector", type=Path, metavar="RUN", help="folder of a finished training, or weights")
    sub.add_argument(
        "pictures", nargs="+", metavar="PICTURES",
        help="a dataset, a video, or pictures, folders, and patterns such as 'photographs/*.jpg'",
    )  # fmt: skip
    sub.add_argument("-o", "--output", type=Path, metavar="PREDICTIONS", required=True, help="a .json file")
    sub.add_argument("--device", default="auto", help="a device of PyTorch (default: auto, a GPU if there is one)")
    sub.add_argument("--batch", type=at_least_one, default=8, help="images at once (default: 8)")
    sub.add_argument(
        "--tile", type=tile_size, metavar="WxH",
        help="detect in overlapping tiles of this size in pixels, that of the training pictures: for large pictures",
    )  # fmt: skip
    sub.add_argument("--draw", type=Path, metavar="DIR", help="also write the pictures with their detections")
    sub.add_argument(
        "--threshold", type=overlap, default=0.5, metavar="T",
        help="least score of drawn and counted detections (default: 0.5); the results have all",
    )  # fmt: skip

    sub = add_verb(
        verbs, "export_model", _export_model, "write a detector as ONNX",
        "Reads a run or weights; writes an ONNX file, whose metadata name classes, input, and output.",
    )  # fmt: skip
    sub.add_argument("detector", type=Path, metavar="RUN", help="folder of a finished training, or weights")
    sub.add_argument("-o", "--output", type=Path, metavar="MODEL", required=True, help="an .onnx file")

    sub = add_verb(
        verbs, "evaluate", _evaluate, "evaluate detections, with intervals",
        "Reads a dataset and COCO results of any detector; writes report.html and report.json. Several files of "
        "results are compared with the first.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET", help="a folder, or a COCO file next to its pictures")
    sub.add_argument("predictions", type=Path, nargs="+", metavar="PREDICTIONS", help="a file of COCO results")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder of the report")
    choice = sub.add_mutually_exclusive_group()
    choice.add_argument(
        "--threshold", type=fraction, default=0.5, metavar="T", help="confidence threshold (default: 0.5)"
    )
    choice.add_argument(
        "--validation", type=Path, nargs="+", metavar="FILE",
        help="another dataset and each detector's detections in it, to choose the threshold with the best F1",
    )  # fmt: skip
    sub.add_argument("--iou", type=overlap, default=0.5, metavar="T", help="least IoU of a match (default: 0.5)")
