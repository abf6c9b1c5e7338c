"""The config's `[ground]` and `[placement]`: where vehicles stand."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hulldown.planning.config.section import AtLeastZero, Lengths, Section, ranged


class GroundSection(Section):
    """What replaces missing ground (paper, section 2.1.5)."""

    fallback_z: float = 0.0
    """height of the plane that replaces missing ground, meters"""


class PlacementSection(Section):
    """Where vehicles are placed (paper, section 2.1.5)."""

    margin: float = Field(default=0.8, gt=0, le=1)
    """middle share of the scenery's extent in which targets are placed"""
    max_slope_deg: float = Field(default=30.0, ge=0, lt=90)
    """steepest ground under the vehicle's origin and the whole vehicle"""
    rule: Literal["averaged", "support"] = "support"
    """how the resting plane is found ("averaged": the paper)"""
    max_gap: AtLeastZero = 1.0
    """meters of air under wheels and tracks, at most"""
    max_penetration: AtLeastZero = 0.3
    """meters of ground above the underside, at most"""
    fording_depth: AtLeastZero = 0.0
    """meters of water above the underside, at most"""
    obstacle_clearance: AtLeastZero = 0.5
    """meters between vehicles and obstacles, at least"""
    indoors: bool = Field(default=False, exclude_if=(False).__eq__)
    """also places that no light of the sky reaches: halls and caves"""
    vehicle_clearance: AtLeastZero = 2.0
    """meters between vehicles, at least"""
    vehicles_per_image: Annotated[tuple[int, int], ranged(1.0, 64.0, int)] = (1, 1)
    """the target and companions; budgets count targets only"""
    companion_distance: Lengths = (8.0, 40.0)
    """meters from the target to a companion"""
    distractors_per_image: Annotated[tuple[int, int], ranged(0.0, 64.0, int)] = (0, 3)
    """distractors in an image, if the scenery has any"""
    distractor_distance: Lengths = (0.0, 40.0)
    """meters from the target to a distractor, uniform by area"""
    articulate: bool = True
    """turn turrets and raise guns"""
    max_tries: int = Field(default=10_000, ge=1, le=1_000_000)
    """places tried for a position"""
