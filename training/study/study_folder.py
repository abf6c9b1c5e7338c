"""A study's folder: study.json, subsets of the photographs, and a folder for each run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
import orjson
from pydantic import BaseModel, ConfigDict

from hulldown.base.errors import ConfigError, DatasetError
from hulldown.base.files import replace_file
from hulldown.base.outside import read_json
from hulldown.base.terminal import progress_bar
from hulldown.base.toml_files import validate_model
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.training.inputs.settings import Settings
from hulldown.training.inputs.sources import (
    CheckedPictures,
    LabeledPictures,
    describe_shared_pictures,
    hash_source_pictures,
    read_classes_and_sources,
    should_follow_masks,
)
from hulldown.training.run_folder import RunFolder
from hulldown.training.study.arms import ARM_KINDS
from hulldown.training.study.config import StudyConfig
from hulldown.training.subset import subset_name, write_subsets

STUDY_NAME, RUNS_NAME, SUBSETS_NAME = "study.json", "runs", "subsets"
MIN_PHOTOGRAPH_SHARE = 0.2  # of the draws; with fewer, photographs may be too rare
MAX_LISTED_PAIRS = 10  # of pictures, in an error


class StudyData(BaseModel):
    """A dataset of a study, as it was at the start."""

    model_config = ConfigDict(frozen=True)

    folder: str
    images: int
    boxes: dict[str, int]
    sha256: str


class Study(BaseModel):
    """The contents of study.json: the config, with masks decided, and the datasets."""

    model_config = ConfigDict(frozen=True)

    format: int = 2
    config: StudyConfig
    classes: tuple[str, ...]
    datasets: dict[str, StudyData]

    @property
    def judged_dataset_names(self) -> tuple[str, ...]:
        """The datasets to predict on."""
        return tuple(which for which in ("test", "valid") if which in self.datasets)


@dataclass(frozen=True, slots=True)
class StudyRun:
    """A run of a study."""

    arm: str
    base: str
    fraction: float | None  # share of the photographs; None without any
    seed: int
    settings: Settings

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        share = "" if self.fraction is None else f"-{subset_name(self.fraction)}"
        return f"{self.arm}{share}-seed{self.seed}"

    def data(self, study: Study, folder: Path) -> dict[str, Path]:
        """Return the folders of its sources by name; `folder` is the study's."""
        folders = {name: Path(study.datasets[name].folder) for name in ARM_KINDS[self.base].sources}
        if self.fraction is not None:
            folders["real"] = subset_folder(folder, self.seed, self.fraction)
        return folders


def subset_folder(folder: Path, seed: int, fraction: float) -> Path:
    """Return the folder of a share of the photographs."""
    return folder / SUBSETS_NAME / f"seed{seed}-{subset_name(fraction)}" / subset_name(fraction)


def planned_study_runs(config: StudyConfig) -> list[StudyRun]:
    """Return all runs, seed by seed, so that a study that is stopped early has complete seeds."""
    arms = [(arm, "real" in ARM_KINDS[arm.base].sources) for arm in config.named_arms]
    of_seed = [
        *((arm, fraction) for fraction in config.fractions for arm, photographed in arms if photographed),
        *((arm, None) for arm, photographed in arms if not photographed),
    ]
    common = config.train.model_dump()
    return [
        StudyRun(
            arm.name, arm.base, fraction, seed,
            Settings.model_validate({
                **common, **arm.train, "seed": seed, "budget": common["budget"], "masks": common["masks"],
                "shares": dict(ARM_KINDS[arm.base].shares),
            }),
        )
        for seed in config.seeds
        for arm, fraction in of_seed
    ]  # fmt: skip


def is_run_finished(folder: Path, study: Study, run: StudyRun) -> bool:
    """Return whether a run has all that the report needs."""
    path = folder / RUNS_NAME / run.name
    return (
        all((path / f"{which}.json").exists() for which in study.judged_dataset_names)
        and RunFolder(path).finished() is not None
    )


def prepare_study(config: StudyConfig, folder: Path) -> Study:
    """Write study.json and the subsets after reading every picture; refuse data that differ from before."""
    folders = {"real": config.real, "synthetic": config.synthetic, "test": config.test}
    if config.valid is not None:
        folders["valid"] = config.valid
    classes, found = read_classes_and_sources(folders)
    sources = {source.name: source for source in found}
    boxes = {name: np.bincount(source.class_index, minlength=len(classes)).tolist() for name, source in sources.items()}
    for name, counts in boxes.items():
        if lacking := [repr(label) for label, count in zip(classes, counts, strict=True) if not count]:
            raise DatasetError(
                f"{name} has no box of the class {', '.join(lacking)}", path=sources[name].folder,
                remedy="add pictures of it, or leave the class out of every dataset",
            )  # fmt: skip
    with progress_bar("checking pictures") as advance:
        checked = hash_source_pictures(found, progress=advance)
    _refuse_shared_pictures(found, checked)
    masks = should_follow_masks(config.train.masks, [sources["real"], sources["synthetic"]])  # one rule for all arms
    study = Study(
        config=config.model_copy(update={"train": config.train.model_copy(update={"masks": masks})}),
        classes=classes,
        datasets={
            name: StudyData(folder=str(folders[name].resolve()), images=len(source), sha256=checked[name].sha256,
                            boxes=dict(zip(classes, boxes[name], strict=True)))
            for name, source in sources.items()
        },
    )  # fmt: skip
    if (folder / STUDY_NAME).exists():
        _refuse_changed_study(read_study(folder), study, folder)
    for seed in config.seeds:
        for fraction in config.fractions:
            subset = subset_folder(folder, seed, fraction)
            if not subset.exists():
                write_subsets(config.real, subset.parent, fractions=[fraction], seed=seed, stratified=config.stratified)
    replace_file(folder / STUDY_NAME, orjson.dumps(study.model_dump(mode="json"), option=orjson.OPT_INDENT_2) + b"\n")
    return study


def read_study(folder: Path) -> Study:
    """Read study.json of a study's folder."""
    path = folder / STUDY_NAME
    refuse = partial(ConfigError, path=path, remedy="name a folder of `hulldown study run`")
    return validate_model(Study, read_json(path, dict[str, object], refuse, what="a study"), path)


def study_warnings(study: Study, folder: Path) -> list[str]:
    """Return warnings about renders that outnumber photographs, and about shares without a box of some class."""
    config, warnings = study.config, []
    arms = [arm.base for arm in config.named_arms]
    lowest = min(config.fractions) * study.datasets["real"].images
    drowned = lowest < MIN_PHOTOGRAPH_SHARE * (lowest + study.datasets["synthetic"].images)
    if drowned and "mixed" in arms and "balanced" not in arms:
        part = 1.0 - MIN_PHOTOGRAPH_SHARE
        warnings.append(f"mixed: renders have over {part:.0%} of some draws; add the arm balanced to compare")
    for seed in config.seeds:
        for fraction in config.fractions:
            images = read_usable_dataset(subset_folder(folder, seed, fraction)).images
            shown = {label.category for image in images for label in image.labels}
            if lacking := [name for name in study.classes if name not in shown]:
                warnings.append(
                    f"seed {seed}: its {len(images)} photographs at {100 * fraction:g} % show no {', '.join(lacking)}; "
                    "stratified = true may help"
                )
    return warnings


def _refuse_changed_study(before: Study, now: Study, folder: Path) -> None:
    changed = [name for name, data in now.datasets.items() if before.datasets.get(name, data).sha256 != data.sha256]
    if before.config.stratified != now.config.stratified:
        changed.append("stratified")
    if changed:
        problem = f"the study in this folder has another {' and another '.join(changed)}"
        raise ConfigError(problem, path=folder, remedy="name a new folder")


def _refuse_shared_pictures(sources: Sequence[LabeledPictures], checked: Mapping[str, CheckedPictures]) -> None:
    alike = [
        pair
        for first, second in combinations(sources, 2)
        if {first.name, second.name} & {"test", "valid"}
        for pair in describe_shared_pictures(first, second, checked)
    ]
    if alike:
        more = f", and {len(alike) - MAX_LISTED_PAIRS} more" if len(alike) > MAX_LISTED_PAIRS else ""
        raise DatasetError(
            f"{', '.join(alike[:MAX_LISTED_PAIRS])}{more}: pictures for testing were also for training",
            remedy="take each out of one of the two",
        )
