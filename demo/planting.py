"""What grows and lies on both demo sceneries: plants strewn by share, stones of every size, patches of grass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from hulldown.demo import earth, scatter, vegetation
from hulldown.demo.land import Land
from hulldown.demo.materials import Color
from hulldown.demo.relief import Height
from hulldown.demo.scatter import Share


@dataclass(frozen=True, eq=False, slots=True)
class Planting:
    """A scenery whose ground is finished: `top` is its height, `rng` says where things stand on it."""

    land: Land
    top: Height
    rng: np.random.Generator

    def strew(
        self,
        home: str,
        kinds: Sequence[Any],
        n: int,
        share: Share,
        *,
        gap: float,
        scale: tuple[float, float],
        sink: float,
        tilt: float = 0.05,
        lying: bool = False,
    ) -> None:
        """Up to n copies of these meshes or curves in the collection `home`, at least `gap` meters apart."""
        spots = scatter.spots(self.land.half, n, share, gap=gap, rng=self.rng)
        scatter.copies(
            self.land.collection(home),
            kinds,
            spots,
            self.top,
            scale=scale,
            sink=sink,
            rng=self.rng,
            tilt=tilt,
            lying=lying,
        )

    def stones(self, name: str, material: Any, flats: Sequence[float], n: int, share: Share) -> list[Any]:
        """Stones of these shapes and n places, and ten boulders between which a vehicle is small; their meshes."""
        kinds = [vegetation.boulder(f"{name}_{k}", material, flat=flat, rng=self.rng) for k, flat in enumerate(flats)]
        self.strew("Rocks", kinds, n, share, gap=4.0, scale=(0.2, 1.35), sink=0.1, tilt=0.3)
        few = scatter.spots(0.8 * self.land.half, 10, share, gap=30.0, rng=self.rng)
        scatter.copies(
            self.land.collection("Rocks"),
            kinds,
            few,
            self.top,
            scale=(1.5, 2.5),
            sink=0.4,
            rng=self.rng,
            tilt=0.2,
            modifier=scatter.subdivided,
        )
        return kinds

    def grass(
        self, name: str, tones: tuple[Color, Color], heights: Sequence[float], n: int, share: Share, *, clumps: int
    ) -> None:
        """Patches of grass some meters wide that lie on the ground, `clumps` in each."""
        blades = earth.leaves(f"{name}_Blades", tones)
        patches = [
            vegetation.tussock(
                f"{name}_{k}", blades, height=height, blades=22 * clumps, clumps=clumps, radius=4.5, rng=self.rng
            )
            for k, height in enumerate(heights)
        ]
        self.strew("Grass", patches, n, share, gap=4.0, scale=(0.75, 1.3), sink=0.02, lying=True)

    def outskirts(self, name: str, plants: Sequence[Any], n: int, share: Share, *, reach: float, group: int) -> None:
        """Groups of plants on the surroundings, `reach` meters from the middle and farther than the ground's edge."""
        spots = scatter.spots(reach, n, share, gap=12.0, inside=self.land.half + 10, rng=self.rng)
        scatter.groups(self.land.scene, name, plants, spots, self.land.outland, members=group, radius=7.5, rng=self.rng)

    def undergrowth(
        self, ground: Any, name: str, data: Any, *, size: float, density: float, scale: tuple[float, float]
    ) -> None:
        """Copies of one mesh that geometry nodes put on one ground mesh where it is level."""
        plant = bpy.data.objects.new(name, data)
        plant.scale = (size, size, size)
        scatter.by_nodes(ground, [plant], density=density, seed=int(self.rng.integers(1000)), scale=scale)
