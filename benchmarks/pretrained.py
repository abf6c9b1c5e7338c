"""`python -m hulldown.benchmarks.pretrained`: what renders are worth to a detector pretrained on COCO.

Trains YOLOX-nano on photographs, on photographs and renders, and on renders alone, and prints AP50 on other
photographs, with 95 % intervals over photographs and seeds. A run of 1,600 draws takes 70 CPU seconds.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hulldown.benchmarks.tables import table
from hulldown.benchmarks.yolox import COCO_NAMES, INPUT_SIZE_PX, Yolox, YoloxDetector, train_yolox
from hulldown.training.detectors.detector import Detector
from hulldown.training.detectors.rivals import ContestedDetector
from hulldown.training.detectors.transformers_detector import VEHICLE_LIKE_CLASS
from hulldown.training.evaluation.evaluate import Evaluation, Threshold
from hulldown.training.evaluation.labels import Labels, read_labels
from hulldown.training.inputs.data import DrawnExamples, make_draws
from hulldown.training.inputs.settings import settings_with_augmentation
from hulldown.training.inputs.sources import read_classes_and_sources
from hulldown.training.predict import detect_in_labeled_pictures
from hulldown.training.subset import subset_name, write_subsets

COLUMNS = ("photographs", "alone", "with renders", "difference", "alone, rivals", "with renders, rivals", "difference")


def draw_examples(folders: Mapping[str, Path], classes: Sequence[str], budget: int, seed: int) -> DrawnExamples:
    """Return draws from datasets, each picture equally likely."""
    _, sources = read_classes_and_sources(folders, classes=classes)
    draws = make_draws(list(map(len, sources)), budget, seed=seed)
    augmentation = settings_with_augmentation({"augmentation": "mild"})["augmentation"]
    return DrawnExamples(sources, draws, INPUT_SIZE_PX, augmentation, masks=False)


def resampled_ap50(detector: Detector, labels: Labels) -> np.ndarray:
    """Return AP50, followed by that in resamples of the photographs."""
    found = Evaluation(labels, detect_in_labeled_pictures(detector, labels), threshold=Threshold(0.5, "given"))
    return np.append(found.summary["ap50"], found.resampled_metrics()["ap50"])


def format_figures(figures: np.ndarray) -> str:
    """Return the mean of rows as by `resampled_ap50` and its interval over photographs and rows, which are seeds."""
    seeds, resamples = len(figures), figures.shape[1] - 1
    picked = np.random.default_rng(0).integers(0, seeds, (resamples, seeds))
    low, high = np.quantile(figures[picked, np.arange(1, resamples + 1)[:, None]].mean(1), (0.025, 0.975))
    return f"{figures[:, 0].mean():.3f} ({low:.3f} to {high:.3f})"


def main() -> None:
    """Train, test, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.pretrained", description=__doc__)
    parser.add_argument("--weights", type=Path, required=True, help="yolox_nano.onnx")
    parser.add_argument("--photographs", type=Path, required=True, help="a dataset to train on")
    parser.add_argument("--synthetic", type=Path, nargs="+", required=True, help="datasets of renders")
    parser.add_argument("--test", type=Path, required=True, help="a dataset of other photographs")
    parser.add_argument("--counts", type=int, nargs="*", default=[0, 6, 12, 30, 120], help="of photographs to train on")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--draws", type=int, default=1600)
    given = parser.parse_args()
    renders = {f"renders {k}": one for k, one in enumerate(given.synthetic)}
    classes, (photographs, *_) = read_classes_and_sources({"photographs": given.photographs, **renders})
    labels, truck = read_labels(given.test), COCO_NAMES.index(VEHICLE_LIKE_CLASS)
    rows = [COCO_NAMES.index(name) if name in COCO_NAMES else truck for name in classes]
    untrained = YoloxDetector(Yolox(given.weights, range(len(COCO_NAMES))), COCO_NAMES)
    shares = {count: count / len(photographs) for count in given.counts if count}

    def figures(network: Yolox) -> np.ndarray:
        detector = YoloxDetector(network, classes)
        return np.stack([resampled_ap50(one, labels) for one in (detector, ContestedDetector(detector, untrained))])

    def trained(count: int, synthetic: Mapping[str, Path], subsets: Path) -> np.ndarray:
        found = []
        for seed in given.seeds:
            few = {"photographs": subsets / str(seed) / subset_name(shares[count])} if count else {}
            examples = draw_examples({**few, **synthetic}, classes, given.draws, seed)
            found.append(figures(train_yolox(given.weights, examples, rows)))
        return np.stack(found, axis=1)

    lines = []
    with TemporaryDirectory() as scratch:
        subsets = Path(scratch)
        for seed in given.seeds if shares else ():
            write_subsets(given.photographs, subsets / str(seed), fractions=list(shares.values()), seed=seed)
        for count in given.counts:
            alone = trained(count, {}, subsets) if count else figures(Yolox(given.weights, rows))[:, None]
            both = trained(count, renders, subsets)
            columns = chain.from_iterable((a, b, b - a) for a, b in zip(alone, both, strict=True))
            lines.append([str(count), *map(format_figures, columns)])
    print(table(COLUMNS, lines))


if __name__ == "__main__":
    main()
