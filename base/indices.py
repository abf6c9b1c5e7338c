"""Arrays of indices: elements of groups, batches, pairs with equal keys, and even samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Int


def group_and_rank(counts: Int[np.ndarray, " g"]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Group of each element and its number in the group, for consecutive groups of `counts` elements.

    >>> [column.tolist() for column in group_and_rank(np.array([2, 0, 3]))]
    [[0, 0, 2, 2, 2], [0, 1, 0, 1, 2]]
    """
    group = np.repeat(np.arange(len(counts)), counts)
    return group, np.arange(len(group)) - np.repeat(np.cumsum(counts) - counts, counts)


def index_batches(n: int, size: int) -> Iterator[Int[np.ndarray, " k"]]:
    """Yield 0, 1, ..., n - 1, at most `size` at a time; without any, one empty batch."""
    for start in range(0, max(n, 1), size):
        yield np.arange(start, min(start + size, n))


def matching_pairs(keys: Int[np.ndarray, " k"], wanted: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """Return all pairs (i, j) with `keys[i] == wanted[j]`, where `wanted` ascends; ordered by i, then by j."""
    first, last = np.searchsorted(wanted, keys, "left"), np.searchsorted(wanted, keys, "right")
    i, number = group_and_rank(last - first)
    return i, first[i] + number


def rank_batches(group: Int[np.ndarray, " k"], *, first: int = 1, growth: int = 2) -> Iterator[Int[np.ndarray, " m"]]:
    """Yield the indices of the first few of each group, then the next few, in ever larger batches.

    >>> [batch.tolist() for batch in rank_batches(np.array([3, 3, 3, 8, 8]))]
    [[0, 3], [1, 4], [2]]
    """
    index = np.arange(len(group))
    rank = index - np.maximum.accumulate(np.where(np.diff(group, prepend=-1) > 0, index, 0))
    done, end = 0, first
    while done <= rank.max(initial=-1):
        yield np.flatnonzero((rank >= done) & (rank < end))
        done, end = end, growth * end


def even_sample(n: int, most: int) -> Int[np.ndarray, " k"]:
    """Return indices of at most `most` of `n` things, ascending, spread evenly from the first to the last.

    >>> even_sample(10, 4)
    array([0, 3, 6, 9])
    """
    return np.unique(np.linspace(0, n - 1, min(most, n)).round().astype(int))
