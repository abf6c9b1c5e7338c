"""Coverage of photographs by images in the features of an encoder.

References
----------
Naeem et al., Reliable Fidelity and Diversity Metrics for Generative Models, ICML 2020.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

NEIGHBORS = 5  # the paper's k
SPLITS = 20  # random halves of the photographs
FEWEST = 4 * NEIGHBORS  # photographs: half of them must have more than NEIGHBORS neighbors


@dataclass(frozen=True, slots=True)
class Coverage:
    """Density and coverage of images next to photographs, and of photographs next to each other."""

    # share of the photographs that have an image among them: nearer than their fifth nearest photograph
    coverage: float
    density: float  # density of images around photographs; 1 for samples of the same distribution
    # coverage_floor, density_floor: both for one half of the photographs in place of the images and the other as
    # photographs: mean of 20 splits
    coverage_floor: float
    density_floor: float

    def sentence(self) -> str:
        """Coverage in words."""
        return (
            f"Whole images cover {self.coverage:.0%} of the photographs (half of the photographs cover "
            f"{self.coverage_floor:.0%} of the others); density {self.density:.2f} ({self.density_floor:.2f})."
        )


def coverage_of(images: Float[np.ndarray, "n d"], photographs: Float[np.ndarray, "m d"]) -> Coverage:
    """Compare the features of images with those of photographs.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> photographs = rng.standard_normal((40, 8))
    >>> coverage_of(photographs[:20], photographs).coverage > 0.9
    True
    >>> coverage_of(photographs + 9.0, photographs).coverage
    0.0
    """
    among = cdist(photographs, photographs)
    rng = np.random.default_rng(0)
    floors = []
    for _ in range(SPLITS):
        first, second = np.array_split(rng.permutation(len(photographs)), 2)
        floors.append(_coverage_and_density(among[np.ix_(first, second)], among[np.ix_(first, first)]))
    return Coverage(*_coverage_and_density(cdist(photographs, images), among), *np.mean(floors, axis=0).tolist())


def _coverage_and_density(to_images: Float[np.ndarray, "m n"], among: Float[np.ndarray, "m m"]) -> tuple[float, float]:
    """Coverage and density from distances between photographs and images, and among the photographs."""
    radius = np.partition(among, NEIGHBORS, axis=1)[:, NEIGHBORS]  # the nearest is the photograph itself
    inside = to_images < radius[:, None]
    return float(inside.any(axis=1).mean()), float(inside.sum() / (NEIGHBORS * inside.shape[1]))
