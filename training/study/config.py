"""The config of a study, from TOML."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from hulldown.base.arguments import AnyPath
from hulldown.base.errors import ConfigError, HulldownError
from hulldown.base.files import replace_file
from hulldown.base.outputs import require_replaceable_file
from hulldown.base.toml_files import read_toml, validate_model
from hulldown.training.inputs.settings import Settings, settings_with_augmentation
from hulldown.training.study.arms import ARM_KINDS, Arm
from hulldown.training.subset import DEFAULT_FRACTIONS

BUILT_IN_ARMS: tuple[Arm, ...] = ("real", "mixed", "balanced", "synthetic")  # the paper's, but for "balanced"
Share = Annotated[float, Field(gt=0.0, le=1.0)]


class NamedArm(BaseModel):
    """An arm with the draws of another arm and other settings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$", description="what reports call it")
    base: Arm = Field(description="the arm whose draws it has")
    train: dict[str, object] = Field(min_length=1, description="keys of [train] that differ")


class StudyConfig(BaseModel):
    """Datasets, arms, and training settings of a study."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    real: Path = Field(description="photographs to train on")
    synthetic: Path = Field(description="rendered images to train on")
    test: Path = Field(description="photographs to test on")
    valid: Path | None = Field(None, description="photographs to choose each detector's threshold on")
    arms: tuple[Arm | NamedArm, ...] = Field(
        BUILT_IN_ARMS,
        min_length=1,
        description='what is compared; { name = "strong", base = "mixed", train.augmentation = "table1" }',
    )
    fractions: tuple[Share, ...] = Field(DEFAULT_FRACTIONS, min_length=1, description="shares of the photographs")
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**32)], ...] = Field((0, 1, 2), min_length=1)
    stratified: bool = Field(False, description="whether each share keeps the proportion of classes")
    threshold: float | None = Field(
        None, ge=0.0, le=1.0, description="confidence of a detection; default: by valid, or as many as labels"
    )
    iou: float = Field(0.5, gt=0.0, le=1.0, description="overlap of a find")
    train: Settings = Field(default_factory=lambda: Settings.model_validate({}), description="as of `hulldown train --config`")

    @property
    def named_arms(self) -> tuple[NamedArm, ...]:
        """The arms; those without another name have that of their draws."""
        made = NamedArm.model_construct
        return tuple(made(name=arm, base=arm, train={}) if isinstance(arm, str) else arm for arm in self.arms)

    @model_validator(mode="after")
    def _refuse_repeated_values(self) -> StudyConfig:
        for key in ("arms", "fractions", "seeds"):
            values = [arm.name for arm in self.named_arms] if key == "arms" else getattr(self, key)
            if repeated := [value for value in values if values.count(value) > 1]:
                raise ValueError(f"{key}: {repeated[0]} is given twice")
        return self


def load_study_config(path: Path | str) -> StudyConfig:
    """Load a study's config from a TOML file; its paths are relative to the file's folder."""
    path = Path(path)
    data = read_toml(path)
    if isinstance(data.get("train"), dict):
        data["train"] = settings_with_augmentation(data["train"], path.parent)
    study = validate_model(StudyConfig, data, path)
    for key, instead in (("seed", "seeds"), ("shares", "arms")):
        if key in data.get("train", {}):
            raise ConfigError(f"train.{key}: the study sets this", path=path, remedy=f"set {instead} above [train]")
    arms: list[Arm | NamedArm] = []
    for arm in study.arms:
        if isinstance(arm, NamedArm):
            if ruled := [key for key in ("seed", "shares", "budget", "masks") if key in arm.train]:
                remedy = "one value is for all arms, so that they can be compared"
                raise ConfigError(f"arms: {arm.name} sets train.{ruled[0]}", path=path, remedy=remedy)
            if arm.name in ARM_KINDS:
                raise ConfigError(f"arms: {arm.name} is taken", path=path, remedy="choose another name")
            # Another model has other defaults, which the keys of [train] replace.
            asked = settings_with_augmentation(arm.train, path.parent)
            own = validate_model(Settings, {**data.get("train", {}), **asked}, path)
            differing = {key: value for key, value in own.model_dump().items() if value != getattr(study.train, key)}
            changes = asked | differing
            if "weights" in changes:
                changes["weights"] = _resolve_weights(path.parent, own.weights)
            arm = arm.model_copy(update={"train": changes})
        arms.append(arm)
    if study.valid is not None and "threshold" in data:
        raise ConfigError("threshold: with valid it is chosen there", path=path, remedy="leave one of the two out")
    datasets = ("real", "synthetic", "test", *(["valid"] if study.valid else []))
    folders = {key: path.parent / getattr(study, key) for key in datasets}
    for key, folder in folders.items():
        if not folder.is_dir():
            raise ConfigError(f"{key} = {str(getattr(study, key))!r}: no such folder", path=path)
    train = study.train.model_copy(update={"weights": _resolve_weights(path.parent, study.train.weights)})
    return study.model_copy(update={**folders, "train": train, "arms": tuple(arms)})


def _resolve_weights(folder: Path, weights: str | None) -> str | None:
    """Return `Settings.weights`; files and folders in it are relative to a folder."""
    return str(folder / weights) if weights is not None and (folder / weights).exists() else weights


def write_study_config(
    output: AnyPath, *, real: AnyPath, synthetic: AnyPath, test: AnyPath, valid: AnyPath | None = None
) -> Path:
    """Write a study's config.

    Writes a comment on every key, and its default.

    Parameters
    ----------
    output
        The config, such as study.toml; its folders are relative to it.
    real
        Photographs to train on.
    synthetic
        Rendered images to train on.
    test
        Photographs to test on.
    valid
        Photographs to choose confidence thresholds on.
    """
    path = Path(output)
    require_replaceable_file(path, "a study")
    given = {"real": real, "synthetic": synthetic, "test": test, "valid": valid}
    folders = {key: Path(folder) for key, folder in given.items() if folder is not None}
    for folder in folders.values():
        if not folder.is_dir():
            raise HulldownError("no such folder", path=folder, remedy="name the folder of a COCO dataset")
    # JSON and TOML write these values in the same way.
    named = {key: json.dumps(_relative_path_text(path.parent, folder), ensure_ascii=False) for key, folder in folders.items()}
    if valid:
        named |= {"valid": f"valid = {named['valid']}"}
    else:
        named |= {"valid": '# valid = "photographs/valid"'}
    replace_file(path, _CONFIG_TEXT.format(**named).encode())
    return path


def _relative_path_text(start: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(folder.resolve(), start.resolve())).as_posix()
    except ValueError:  # another drive
        return folder.resolve().as_posix()


_CONFIG_TEXT = """\
# hulldown study. Paths are relative to this file's folder, and each is the folder of a COCO dataset.

real = {real}            # photographs to train on
synthetic = {synthetic}  # rendered images to train on
test = {test}            # photographs that every detector is judged by; none of them may be in real
{valid}  # photographs that choose each detector's threshold of confidence, by the best F1
# threshold = 0.5  # detections of at least this confidence count; default: valid's, or as many as the test has labels
iou = 0.5        # overlap from which a detection has found a label

# "real": photographs alone. "mixed": with all synthetic images, every image as likely as any other. "synthetic": these
# alone. "balanced": half of the draws real.
arms = ["real", "mixed", "balanced", "synthetic"]
fractions = [1.0, 0.5, 0.25, 0.1, 0.05]  # shares of the photographs, each within the larger ones
seeds = [0, 1, 2]   # each is one training of every arm, on other photographs at shares below 1
stratified = false  # whether each share keeps the proportion of classes

[train]  # every run; all keys of `hulldown train --config` but seed and shares
model = "medium"  # "small" for a CPU; "nano", "rf-small", "medium", "large" of RF-DETR
budget = 25000    # pictures drawn, with replacement
"""
