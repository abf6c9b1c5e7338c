"""Clearance of vehicles from obstacles: stacks of oriented boxes against triangles."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from hulldown.geometry.instances import InstancedScene
from hulldown.geometry.overlap import ROOM, SceneTouch
from hulldown.geometry.portable import sin_cos


def _skyward(n: int) -> Float[np.ndarray, "n 3"]:
    """Straight up first, then directions spread evenly over the upper half of the sphere, from the top down.

    References
    ----------
    Vogel, A better way to construct the sunflower head, Mathematical Biosciences 44, 1979: the golden angle.
    """
    i = np.arange(n)
    z = 1.0 - i / (n - 0.5)
    sin, cos = sin_cos(i * (math.pi * (3.0 - math.sqrt(5.0))))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * cos, flat * sin, z], axis=1)


SKYWARD = _skyward(48)
OPEN = 4  # free rays needed if the first is blocked; below a wide sheet, two level ones are free


class Obstacles:
    """A scenery's obstacles, for clearance tests. Immutable.

    Parameters
    ----------
    scene
        Everything but ground and vehicles.
    solid
        (k,) which instances count; by default all. Grass gives way.
    """

    def __init__(self, scene: InstancedScene, *, solid: Bool[np.ndarray, " k"] | None = None) -> None:
        self._scene, self._touch = scene, SceneTouch(scene, solid)

    def touched(
        self, half: Float[np.ndarray, "n 3"], world_from_box: Float[np.ndarray, "n 4 4"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether each box touches or is inside an obstacle; see `SceneTouch.touched`."""
        return self._touch.touched(half, world_from_box)

    def open_above(self, point: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether light reaches each point: the ray upwards, or `OPEN` others, meet no obstacle within `ROOM` meters.

        Parameters
        ----------
        point
            (n, 3) world. No ray leaves a closed house, a boulder, or a hall.
        """
        is_open = np.zeros(len(point), dtype=bool)
        free = np.zeros(len(point), dtype=int)
        for begin, end in pairwise((0, 1, 13, len(SKYWARD))):
            left = np.flatnonzero(~is_open)
            origins = np.repeat(point[left], end - begin, axis=0)
            directions = np.tile(SKYWARD[begin:end], (len(left), 1))
            blocked = self._scene.occluded(origins, directions, max_distance=ROOM)
            free[left] += (~blocked).reshape(len(left), end - begin).sum(axis=1)
            is_open |= free >= (1 if begin == 0 else OPEN)
        return is_open
