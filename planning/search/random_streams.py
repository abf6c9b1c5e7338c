"""Counter-based random numbers: number j of try a of item i is a function of (seed, i, a, j).

Numbers don't depend on those drawn before, so the result doesn't depend on batches.

Steele, Lea, Flood, Fast splittable pseudorandom number generators, OOPSLA 2014: SplitMix64, whose mixing function and
increment are used. Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011, for the idea.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int, UInt64
from numpy.typing import ArrayLike

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # odd, 2**64 divided by the golden ratio
_TO_UNIT = 2.0**-53


class Purpose(IntEnum):
    """What random numbers are for; streams of different purposes are independent."""

    SCENERY = 1
    PLACE = 2
    ARTICULATION = 3
    COMPANION = 4
    CAMERA = 5
    LIGHT = 6
    SAMPLE_SEED = 7
    FRAMING = 8
    COMPANY = 9
    DISTRACTOR = 10
    DISTRACTORS = 11
    BACKGROUND = 12
    PAINT = 20
    EXPOSURE = 21
    WEATHER = 22
    LIKE = 26
    DIRECTION = 27
    SEQUENCE = 31


class RandomStreams:
    """The random numbers of a plan, by purpose, item, and attempt."""

    __slots__ = ("_key",)

    def __init__(self, seed: int) -> None:
        self._key = np.random.SeedSequence(seed).generate_state(1, np.uint64)

    def uniform(
        self, purpose: ArrayLike, item: ArrayLike, attempt: ArrayLike, *, count: int
    ) -> Float[np.ndarray, "*n {count}"]:
        """Return `count` numbers for each item, uniform in [0, 1), multiples of 2**-53."""
        return _bits_to_unit_interval(self.random_bits(purpose, item, attempt, count=count))

    def random_bits(
        self, purpose: ArrayLike, item: ArrayLike, attempt: ArrayLike, *, count: int
    ) -> UInt64[np.ndarray, "*n {count}"]:
        """Return `count` numbers of 64 random bits for each item."""
        return _random_bits_from_states(self.first_states(purpose, item, attempt), count)

    def first_states(self, purpose: ArrayLike, item: ArrayLike, attempt: ArrayLike) -> UInt64[np.ndarray, "*n"]:
        """Return the first states of the streams of these items and attempts."""
        purposes, items, attempts = np.broadcast_arrays(
            np.asarray(purpose, dtype=np.uint64),
            np.atleast_1d(np.asarray(item, dtype=np.uint64)),
            np.asarray(attempt, dtype=np.uint64),
        )
        state = _mix_bits(self._key + purposes * _GOLDEN)
        state = _mix_bits(state + items * _GOLDEN)
        return _mix_bits(state + attempts * _GOLDEN)


class RowStreams:
    """A generator for functions that draw n rows at a time; row i is from the stream of item i."""

    def __init__(self, draws: RandomStreams, purpose: Purpose, item: ArrayLike, attempt: ArrayLike) -> None:
        self._states = draws.first_states(purpose, item, attempt)
        self._drawn = 0

    def random(self, size: int | tuple[int, ...]) -> Float[np.ndarray, "n ..."]:
        """Numbers uniform in [0, 1), multiples of 2**-53; `size` is n or (n, ...)."""
        shape = (size,) if isinstance(size, (int, np.integer)) else tuple(size)
        if not shape or shape[0] != len(self._states):
            raise ValueError(f"size: expected {len(self._states)} rows, got size {size!r}")
        count = math.prod(shape[1:])
        values = _bits_to_unit_interval(_random_bits_from_states(self._states, count, first=self._drawn))
        self._drawn += count
        return values.reshape(shape)

    def uniform(self, low: float, high: float, size: int | tuple[int, ...]) -> Float[np.ndarray, "n ..."]:
        """Numbers uniform in [low, high]; `size` is n or (n, ...)."""
        return scale_uniform(low, high, self.random(size))


def scale_uniform(low: ArrayLike, high: ArrayLike, uniform: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return numbers in [low, high] in proportion to `uniform` in [0, 1), clipped against rounding."""
    lowest, highest = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return np.clip(lowest + np.asarray(uniform) * (highest - lowest), lowest, highest)


def choose_weighted_indices(weights: ArrayLike, uniform: ArrayLike) -> Int[np.ndarray, "*n"]:
    """Return n indices by weights, (k,) or a row for each with one above 0, from numbers in [0, 1)."""
    table = np.asarray(weights, dtype=np.float64)
    running = np.cumsum(table, axis=-1)
    if np.size(uniform) and not (running[..., -1] > 0.0).all():
        raise ValueError("weights: expected one above 0 in each row")
    # Rounding may reach the end; clip to the last index with a weight.
    last = table.shape[-1] - 1 - (table[..., ::-1] > 0.0).argmax(axis=-1)
    wanted = np.asarray(uniform) * running[..., -1]
    if table.ndim == 1:
        return np.minimum(np.searchsorted(running, wanted, side="right"), last)
    return np.minimum((running <= wanted[:, None]).sum(axis=1), last)


def _random_bits_from_states(
    states: UInt64[np.ndarray, "*n"], count: int, *, first: int = 0
) -> UInt64[np.ndarray, "*n {count}"]:
    return _mix_bits(states[..., None] + np.arange(first + 1, first + count + 1, dtype=np.uint64) * _GOLDEN)


def _bits_to_unit_interval(bits: UInt64[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    return (bits >> np.uint64(11)) * _TO_UNIT


def _mix_bits(z: UInt64[np.ndarray, "..."]) -> UInt64[np.ndarray, "..."]:
    """SplitMix64's finalizer (Stafford's variant 13): every input bit changes every output bit with probability 1/2."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
