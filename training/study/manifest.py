"""All runs of a study with everything that determines them, fixed before the first run: study.json."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
import orjson
from jaxtyping import Int
from pydantic import BaseModel, ConfigDict, Field

from hulldown.base.errors import ConfigError, DatasetError
from hulldown.base.files import replace_file
from hulldown.base.outside import read_json
from hulldown.base.terminal import reporting
from hulldown.base.toml_files import validated
from hulldown.dataset.records import read_usable
from hulldown.training.detectors.detector import weights_digest
from hulldown.training.inputs.draws import Draws
from hulldown.training.inputs.settings import Settings
from hulldown.training.inputs.sources import (
    CheckedPictures,
    LabeledPictures,
    check_pictures,
    follow_masks,
    read_sources,
    shared_pictures,
)
from hulldown.training.study.arms import ARM_KINDS, Arm, arm_draws
from hulldown.training.study.config import NamedArm, StudyConfig
from hulldown.training.subset import nested_subsets, subset_name

MANIFEST_NAME, RUNS_NAME, LOGS_NAME = "study.json", "runs", "logs"
KEY_DIGITS = 10
MIN_PHOTOGRAPH_SHARE = 0.2  # share of the draws below which photographs may be too rare
MOST_LISTED = 10  # pairs of pictures that an error names


class StudyData(BaseModel):
    """A dataset of a study, with its state at the start."""

    model_config = ConfigDict(frozen=True)

    folder: str
    images: int
    boxes: dict[str, int]
    sha256: str


class PlannedRun(BaseModel):
    """A run with everything that determines it.

    `folder` ends in the hash of the rest, so another config or other data get another folder.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    folder: str
    arm: str
    base: Arm
    fraction: float | None
    seed: int
    photographs: int  # number of its photographs
    chosen: tuple[int, ...] = ()  # indices of these in the real dataset, by name
    sources: tuple[str, ...]
    drawn: dict[str, int]  # draws from each source
    settings: Settings


class Manifest(BaseModel):
    """The contents of study.json, and what is known before it's written."""

    model_config = ConfigDict(frozen=True)

    format: int = 1
    config: StudyConfig
    classes: tuple[str, ...]
    datasets: dict[str, StudyData]
    runs: tuple[PlannedRun, ...]
    warnings: tuple[str, ...] = Field(default=(), exclude=True)  # to show before the study runs

    def run(self, name: str) -> PlannedRun:
        """Return the run with a name."""
        return next(run for run in self.runs if run.name == name)

    def draws(self, run: PlannedRun) -> Draws:
        """Return the draws of a run."""
        synthetic, budget = self.datasets["synthetic"].images, self.config.train.budget
        return arm_draws(run.base, np.array(run.chosen, dtype=np.int64), synthetic, budget=budget, seed=run.seed)


def study_runs(config: StudyConfig) -> list[tuple[NamedArm, float | None, int]]:
    """Arm, share of the photographs, and seed of all runs, seed by seed, so that one stopped early has complete seeds.

    The share is None for arms without photographs.
    """
    arms = [(arm, "real" in ARM_KINDS[arm.base].sources) for arm in config.named_arms]
    of_seed: list[tuple[NamedArm, float | None]] = [
        *((arm, fraction) for fraction in config.fractions for arm, photographed in arms if photographed),
        *((arm, None) for arm, photographed in arms if not photographed),
    ]
    return [(arm, fraction, seed) for seed in config.seeds for arm, fraction in of_seed]


def settle(config: StudyConfig) -> Manifest:
    """Fix everything that determines the runs of a study; every picture is read."""
    folders = {"real": config.real, "synthetic": config.synthetic, "test": config.test}
    if config.valid is not None:
        folders["valid"] = config.valid
    classes, found = read_sources(folders)
    sources = {source.name: source for source in found}
    _check_classes(sources, classes)
    with reporting("checking pictures") as advance:
        checked = check_pictures(found, progress=advance)
    _check_apart(sources, checked)
    datasets = {
        name: StudyData(folder=str(folders[name].resolve()), images=len(source), boxes=_boxes(source, classes),
                      sha256=checked[name].sha256)
        for name, source in sources.items()
    }  # fmt: skip
    masks = follow_masks(config.train.masks, [sources["real"], sources["synthetic"]])  # one rule for all arms
    shares = _shares(config, sources["real"])
    runs, warnings, drowned = [], _equal_shares(shares), False
    for arm, fraction, seed in study_runs(config):
        photographs = shares[seed, fraction] if fraction is not None else np.zeros(0, dtype=np.int64)
        synthetic, budget, used = len(sources["synthetic"]), config.train.budget, ARM_KINDS[arm.base].sources
        own_draws = arm_draws(arm.base, photographs, synthetic, budget=budget, seed=seed)
        ruled = {"seed": seed, "masks": masks}
        settings = Settings.model_validate({**config.train.model_dump(), **arm.train, **ruled})
        data = {name: datasets[name].sha256 for name in used}
        share = "" if fraction is None else f"-{subset_name(fraction)}"
        name = f"{arm.name}{share}-seed{seed}"
        counts = np.bincount(own_draws.source, minlength=len(used)).tolist()
        run = PlannedRun(
            name=name, folder=f"{name}-{_key(settings, data, own_draws.digest)}", arm=arm.name, base=arm.base,
            fraction=fraction, seed=seed, photographs=len(photographs), chosen=tuple(photographs.tolist()),
            sources=used, drawn=dict(zip(used, counts, strict=True)), settings=settings,
        )  # fmt: skip
        runs.append(run)
        if not run.drawn.get("real", 1):
            warnings.append(f"{run.name} draws no photograph: raise budget, or leave the arm {run.arm} out")
        drowned |= run.base == "mixed" and 0 < run.drawn["real"] < MIN_PHOTOGRAPH_SHARE * budget
        if run.arm == "real":
            warnings += _missing(run, sources["real"], photographs, classes)
    if drowned and "balanced" not in [arm.base for arm in config.named_arms]:
        warnings.append(
            f"mixed: renders have over {1 - MIN_PHOTOGRAPH_SHARE:.0%} of some draws; add the arm balanced to compare"
        )
    return Manifest(config=config, classes=classes, datasets=datasets, runs=tuple(runs), warnings=tuple(warnings))


def write_manifest(manifest: Manifest, folder: Path) -> None:
    """Write study.json."""
    folder.mkdir(parents=True, exist_ok=True)
    content = orjson.dumps(manifest.model_dump(mode="json"), option=orjson.OPT_INDENT_2)
    replace_file(folder / MANIFEST_NAME, content + b"\n")


def read_manifest(folder: Path) -> Manifest:
    """Read study.json of a study's folder."""
    path = folder / MANIFEST_NAME
    refuse = partial(ConfigError, path=path, remedy="name a folder of `hulldown study run`")
    return validated(Manifest, read_json(path, dict[str, object], refuse, what="the manifest of a study"), path)


def predictions_paths(study: Path, manifest: Manifest, run: PlannedRun) -> dict[str, Path]:
    """Return a run's files of detections in the test pictures and, if there are any, in the validation pictures.

    Their names are specific to these pictures.
    """
    return {
        which: study / RUNS_NAME / run.folder / f"{which}-{manifest.datasets[which].sha256[:10]}.json"
        for which in ("test", "valid")
        if which in manifest.datasets
    }


def _key(settings: Settings, digests: Mapping[str, str], draws: str) -> str:
    """Return a hash of everything that determines a run."""
    named = Path(settings.weights or "none")
    weights = weights_digest(named) if named.exists() else None
    made_of = {
        "settings": settings.model_dump(mode="json", exclude={"weights", "logger"}),
        "weights": weights or settings.weights,
        "data": digests,
        "draws": draws,
    }
    return hashlib.sha256(orjson.dumps(made_of, option=orjson.OPT_SORT_KEYS)).hexdigest()[:KEY_DIGITS]


def _shares(config: StudyConfig, real: LabeledPictures) -> dict[tuple[int, float], Int[np.ndarray, " k"]]:
    """Return the photographs of each seed and fraction, as indices into the source."""
    images = read_usable(Path(config.real)).images
    index = {name: i for i, name in enumerate(real.file_names)}
    number = {image.id: index[image.file_name] for image in images}
    shares = {}
    for seed in config.seeds:
        subsets = nested_subsets(images, config.fractions, seed=seed, stratified=config.stratified)
        for fraction, ids in zip(config.fractions, subsets, strict=True):
            shares[seed, fraction] = np.array(sorted(number[i] for i in ids), dtype=np.int64)
    return shares


def _equal_shares(shares: Mapping[tuple[int, float], Int[np.ndarray, " k"]]) -> list[str]:
    """Warn of shares of a seed with the same photographs, for which one training would be enough."""
    return [
        f"seed {seed}: {100 * first:g} % and {100 * second:g} % are the same {len(one)} photographs; leave one out"
        for ((seed, first), one), ((other_seed, second), other) in combinations(shares.items(), 2)
        if seed == other_seed and np.array_equal(one, other)
    ]


def _boxes(source: LabeledPictures, classes: Sequence[str]) -> dict[str, int]:
    return dict(zip(classes, np.bincount(source.class_index, minlength=len(classes)).tolist(), strict=True))


def _check_classes(sources: Mapping[str, LabeledPictures], classes: Sequence[str]) -> None:
    """Refuse datasets without a box of some class, since runs would have different tasks."""
    for name, source in sources.items():
        lacking = [label for label, boxes in _boxes(source, classes).items() if not boxes]
        if lacking:
            raise DatasetError(
                f"{name} has no box of the class {', '.join(map(repr, lacking))}", path=source.folder,
                remedy="add pictures of it, or leave the class out of every dataset",
            )  # fmt: skip


def _missing(
    run: PlannedRun, real: LabeledPictures, photographs: Int[np.ndarray, " k"], classes: Sequence[str]
) -> list[str]:
    of_box = np.repeat(np.arange(len(real)), np.diff(real.starts))
    there = np.bincount(real.class_index[np.isin(of_box, photographs)], minlength=len(classes))
    if not (lacking := [name for name, boxes in zip(classes, there, strict=True) if not boxes]):
        return []
    return [f"{run.name}: its {len(photographs)} photographs show no {', '.join(lacking)}; stratified = true may help"]


def _check_apart(sources: Mapping[str, LabeledPictures], checked: Mapping[str, CheckedPictures]) -> None:
    """Refuse pictures that are in two of training, validation, and test."""
    alike = [
        pair
        for first, second in combinations(sources.values(), 2)
        if {first.name, second.name} & {"test", "valid"}
        for pair in shared_pictures(first, second, checked)
    ]
    if alike:
        more = f", and {len(alike) - MOST_LISTED} more" if len(alike) > MOST_LISTED else ""
        raise DatasetError(
            f"{', '.join(alike[:MOST_LISTED])}{more}: pictures for testing were also for training",
            remedy="take each out of one of the two",
        )
