"""The config's `[weather]`: shares and ranges of each kind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, create_model, model_validator

from hulldown.camera.weather.extinction import GHOST
from hulldown.camera.weather.kinds import KINDS
from hulldown.planning.config.section import Pair, Section, Share, ranged


def _keys_of_kinds() -> dict[str, object]:
    """Return the shares of all kinds, then their ranges, then their covers, each with its type and its field."""
    keys: dict[str, object] = {name: (Share, Field(0.0, description=kind.share)) for name, kind in KINDS.items()}
    ranges = [key for kind in KINDS.values() for key in (kind.visibility, kind.rate) if key]
    for key in (*ranges, *(key for kind in KINDS.values() for key in kind.covers)):
        keys[key.name] = (Annotated[Pair, ranged(*key.allowed)], Field(key.default, description=key.meaning))
    return keys


if TYPE_CHECKING:
    _KeysOfKinds = Section
else:
    _KeysOfKinds = create_model("_KeysOfKinds", __base__=Section, **_keys_of_kinds())


class WeatherSection(_KeysOfKinds):
    """Shares of images with each kind of weather, and its ranges; the other images are clear."""

    wind_m_s: Annotated[Pair, ranged(0.0, 60.0)] = (0.0, 8.0)
    """wind in rain, snow, and dust, from any direction, m/s"""
    exposure_s: float = Field(default=0.004, gt=0, le=10)
    """shutter time, seconds: the length of streaks"""
    min_contrast: Share = GHOST
    """contrast that a target must keep after haze; 0 allows ghosts"""

    @model_validator(mode="after")
    def _shares_of_one_whole(self) -> WeatherSection:
        total = math.fsum(getattr(self, name) for name in KINDS)
        if total > 1.0 + 1e-9:
            raise ValueError(f"{', '.join(KINDS)} are {total:g} together; expected shares of at most 1 in all")
        return self
