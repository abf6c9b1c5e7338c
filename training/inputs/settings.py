"""Settings of a training run, from TOML and the model's defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import make_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo

from hulldown.base.errors import ConfigError
from hulldown.base.outside import convert_parsed_value, parse_json, parse_yaml, read_text
from hulldown.base.toml_files import read_toml, validate_model

ModelName = Literal["small", "nano", "rf-small", "medium", "large"]

KNOWN_AUGMENTATIONS = ("table1", "mild", "aerial")
OWN_AUGMENTATIONS = Path(__file__).parent / "augmentations"
_NAME_A_FILE = f"name an Albumentations file (docs/training.md), or {', '.join(KNOWN_AUGMENTATIONS)}"
# Set here because RF-DETR's default of batches per step changed from 4 to 1 between versions.
_RF_DETR = {"batch": 4, "accumulate": 4, "learning_rate": 1e-4, "schedule": "step", "augmentation": "table1"}
_MODEL_DEFAULTS: Mapping[str, Mapping[str, object]] = {
    "small": {
        "resolution": 320,
        "batch": 8,
        "accumulate": 1,
        "learning_rate": 1e-4,
        "schedule": "cosine",
        "augmentation": "mild",
    },
    "nano": {"resolution": 384, **_RF_DETR},
    "rf-small": {"resolution": 512, **_RF_DETR},
    "medium": {"resolution": 576, **_RF_DETR},
    "large": {"resolution": 704, **_RF_DETR},
}


class Settings(BaseModel):
    """The settings that determine a run's weights besides the data; missing ones have the model's defaults."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    model: ModelName = Field("medium", description="small: D-FINE nano, for a CPU; nano to large are RF-DETR's")
    budget: int = Field(25_000, ge=1, description="pictures drawn, with replacement")
    seed: int = Field(0, ge=0, lt=2**63, description="of draws, augmentation and weights")
    resolution: int = Field(ge=32, le=4096, multiple_of=32, description="pixels of the input's sides")
    weights: str | None = Field(None, description="where to start, or none; default: the model's own")
    batch: int = Field(ge=1, description="pictures that go through the network at once")
    accumulate: int = Field(ge=1, description="batches in a step: their gradients are added")
    learning_rate: float = Field(gt=0.0, le=1.0, description="at its highest")
    weight_decay: float = Field(1e-4, ge=0.0, le=100.0)
    schedule: Literal["step", "cosine"] = Field(description="step: a tenth of the rate at the end")
    warmup: float = Field(0.02, ge=0.0, lt=1.0, description="share of the steps in which the rate rises from 0")
    drop: float = Field(0.8, gt=0.0, le=1.0, description="share of the steps after which it is a tenth")
    shares: dict[str, float] = Field({}, description="source -> its part of the draws")
    augmentation: dict[str, object] = Field(description="the contents of an Albumentations file")
    masks: bool | None = Field(None, description="boxes of turned pictures follow masks; default: if all have one")
    multi_scale: bool = Field(False, description="RF-DETR's own change of the input's size from batch to batch")
    queries: int | None = Field(None, ge=1, description="objects that can be found in a picture")
    groups: int | None = Field(None, ge=1, description="groups of queries that RF-DETR trains side by side")
    keep: Literal["end", "best"] = Field("end", description="weights of the end, or those of the best validation AP50")
    logger: Literal["tensorboard", "wandb", "mlflow"] | None = Field(None, description="also log there")

    @model_validator(mode="before")
    @classmethod
    def _fill_model_defaults(cls, data: object) -> object:
        if not isinstance(data, dict):
            return data
        defaults = _MODEL_DEFAULTS.get(str(data.get("model")), _MODEL_DEFAULTS["medium"])
        return settings_with_augmentation({**defaults, **data})

    @property
    def effective_batch(self) -> int:
        """Number of pictures per step."""
        return self.batch * self.accumulate

    @property
    def steps(self) -> int:
        """Number of the run's steps; the last may have fewer pictures."""
        return math.ceil(self.budget / self.effective_batch)


_OPTION_NAMES = ("model", "budget", "seed", "resolution", "weights", "keep", "logger")


def _setting_option_type(field: FieldInfo) -> object:
    shown = str(field.default) if isinstance(field.default, str | int) else False
    kind: Any = field.annotation
    return Annotated[kind | None, Parameter(help=field.description, show_default=shown)]


# Changes of settings, as options of a command; None: unchanged.
SettingOptions = Parameter(name="*")(
    make_dataclass(
        "SettingOptions",
        [(name, _setting_option_type(Settings.model_fields[name]), None) for name in _OPTION_NAMES],
        namespace={"__module__": __name__},
    )
)


def settings_with_augmentation(data: Mapping[str, object], folder: Path = Path()) -> dict[str, object]:
    """Return settings with the contents of the file that ``augmentation`` names, by a path from a folder."""
    named = data.get("augmentation")
    if isinstance(named, Mapping) and "transform" not in named:
        raise ConfigError("augmentation: lines of a table and presets are gone", remedy=_NAME_A_FILE)
    if not isinstance(named, str):
        return dict(data)
    path = OWN_AUGMENTATIONS / f"{named}.yaml" if named in KNOWN_AUGMENTATIONS else folder / named
    refuse = partial(ConfigError, path=path, remedy=_NAME_A_FILE)
    text = read_text(path, refuse)
    try:
        document = convert_parsed_value(
            parse_json(text.encode(), object) if path.suffix == ".json" else parse_yaml(text), dict[str, object]
        )
    except ValueError as error:
        raise refuse(f"isn't an Albumentations file ({error})") from None
    if "transform" not in document:
        raise refuse("isn't an Albumentations file: it has no transform")
    return {**data, "augmentation": document}


def load_settings(path: Path | None, changes: Mapping[str, object]) -> Settings:
    """Load settings from a TOML file, if given, with changes to its fields; a change of None changes nothing."""
    data = {} if path is None else settings_with_augmentation(read_toml(path), path.parent)
    data.update({key: value for key, value in changes.items() if value is not None})
    return validate_model(Settings, data, path)


def learning_rate_factor(step: int, settings: Settings, steps: int) -> float:
    """Return the learning rate of a step, from 0 on, as a share of the highest; the run has `steps` steps."""
    rise = math.ceil(settings.warmup * steps)
    if step < rise:
        return (step + 1) / (rise + 1)
    if settings.schedule == "cosine":
        return 0.5 * (1.0 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))
    return 1.0 if step < settings.drop * steps else 0.1
