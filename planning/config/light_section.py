"""The config's `[light]`: HDRIs, exposure, and white balance."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from hulldown.camera.response import COOLEST, FARTHEST_EV, WARMEST
from hulldown.geometry.arrays import are_numbers
from hulldown.planning.config.section import AtLeastZero, Pair, Patterns, Section, ranged


def _exposure(value: Any) -> str | float:
    """Check "auto" or a number of EV."""
    if value == "auto":
        return "auto"
    if are_numbers([value]) and abs(value) <= FARTHEST_EV:
        return float(value)
    raise ValueError(f"expected 'auto' or EV from {-FARTHEST_EV:g} to {FARTHEST_EV:g}")


Exposure = Annotated[Literal["auto"] | float, BeforeValidator(_exposure)]


class HdriChoice(Section):
    """A pattern of HDRI names, and how often these HDRIs are drawn."""

    name: str
    weight: AtLeastZero = 1.0


def _choice(value: object) -> object:
    if not isinstance(value, (str, dict, HdriChoice)):
        raise ValueError("expected a name or { name = ..., weight = ... }")
    return {"name": value} if isinstance(value, str) else value


class LightSection(Section):
    """HDRIs, their rotation, strength, and visible part, and the exposure of the camera."""

    hdris: Annotated[tuple[Annotated[HdriChoice, BeforeValidator(_choice)], ...], Field(strict=False)] = ()
    """patterns of HDRIs, or { name = "noon*", weight = 2.0 }; empty: all, equally often"""
    yaw_deg: Annotated[Pair, ranged(-360.0, 360.0)] = (0.0, 360.0)
    """turn of the HDRI, degrees"""
    strength: Annotated[Pair, ranged(0.0, 1e9)] = (0.7, 1.3)
    """factor on the HDRI's brightness; exposure = "auto" compensates for it"""
    backdrop: Literal["auto", "hdri", "sky"] = "auto"
    """what the camera sees of the HDRI: "hdri", all; "sky", above its horizon; "auto", "sky" if it shows land"""
    exposure: Exposure = "auto"
    """"auto": a gray card on open land comes out mid-gray; or EV for all images"""
    exposure_error_ev: Annotated[Pair, ranged(-10.0, 10.0)] = (-1.0, 1.0)
    """error of the exposure, EV"""
    white_balance_error_k: Annotated[Pair, ranged(COOLEST, WARMEST)] = (0.0, 0.0)
    """white balance minus 6500 K; more is warmer"""
    overcast: Patterns = ()
    """patterns of HDRIs for rain and snow; empty: as for other weather"""
