"""Find near duplicates: pictures saved again, resized, or in another format."""

from __future__ import annotations

from collections.abc import Sequence

import imagehash
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image

HASH_SIDE = 16  # of a hash: 256 bits
MAX_DIFFERING_BITS = 26  # differing bits of 256, see docs/dataset.md for what was measured
FLAT_DEVIATION_LEVELS = 2.0  # of 255: standard deviation of a picture that has nothing to compare


def picture_hash(pixels: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "256"] | None:
    """Return a picture's perceptual hash; None without contrast, where the hash is meaningless.

    Zauner, Implementation and benchmarking of perceptual image hash functions, 2010, section 3.2.1 (DCT hash).
    """
    gray = Image.fromarray(pixels).convert("L")
    if np.std(np.asarray(gray.reduce(max(1, min(gray.size) // 64)))) < FLAT_DEVIATION_LEVELS:
        return None
    return imagehash.phash(gray, hash_size=HASH_SIDE).hash.ravel()


def near_duplicates(
    first: Sequence[Bool[np.ndarray, "256"] | None], second: Sequence[Bool[np.ndarray, "256"] | None]
) -> Int[np.ndarray, "n 2"]:
    """Return index pairs of near duplicates, (n, 2)."""
    (rows, ones), (columns, others) = _hash_signs(first), _hash_signs(second)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for start in range(0, len(ones), 1024):  # blocks, so that a large dataset doesn't need a large matrix
        differing = (HASH_SIDE * HASH_SIDE - ones[start : start + 1024] @ others.T) / 2.0
        found.append(np.argwhere(differing <= MAX_DIFFERING_BITS) + np.array([start, 0]))
    pairs = np.concatenate(found)
    return np.stack([rows[pairs[:, 0]], columns[pairs[:, 1]]], axis=1)


def _hash_signs(
    hashes: Sequence[Bool[np.ndarray, "256"] | None],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 256"]]:
    """Return which pictures have a hash, and its bits as 1 and -1: their products count equal and differing bits."""
    there = {i: hashed for i, hashed in enumerate(hashes) if hashed is not None}
    bits = np.array(list(there.values()), dtype=np.float32).reshape(-1, HASH_SIDE * HASH_SIDE)
    return np.array(list(there), dtype=np.int64), 2.0 * bits - 1.0
