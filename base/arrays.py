"""Checks of arrays and numbers that callers pass in."""

from __future__ import annotations

import sys
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

MAX_FLOAT = sys.float_info.max


def checked_array(
    value: ArrayLike, name: str, shape: tuple[int | str, ...], *, dtype: DTypeLike = np.float64, finite: bool = True
) -> np.ndarray:
    """Return `value` as a contiguous array of `dtype`, or raise a ValueError that names it."""
    expected = "(" + ", ".join(str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
    try:
        given = np.asarray(value)
        if np.issubdtype(dtype, np.integer) and given.size and not np.issubdtype(given.dtype, np.integer):
            raise TypeError
        if np.iscomplexobj(given) and not np.issubdtype(dtype, np.complexfloating):
            raise TypeError
        array = np.ascontiguousarray(given, dtype=dtype) if given.ndim else np.asarray(given, dtype=dtype)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected {np.dtype(dtype)} array of shape {expected}, got {value!r:.80}") from None
    if not _shape_matches(array.shape, shape):
        raise ValueError(f"{name}: expected shape {expected}, got {array.shape}")
    if finite and np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name}: expected finite numbers, got {array[first]} at index {first}")
    return array


def checked_positive_array(value: ArrayLike, name: str) -> np.ndarray:
    """Return `value` as finite positive numbers of any shape, or raise a ValueError that names it."""
    array = checked_array(value, name, ("...",))
    if (array <= 0.0).any():
        raise ValueError(f"{name}: expected positive numbers, got {float(array.min())}")
    return array


def are_finite_numbers(values: Iterable[object]) -> bool:
    """Return whether all values are finite numbers; true and false are not."""
    # NaN fails the comparison, and so do integers beyond the largest float.
    return all(isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= MAX_FLOAT for x in values)


def checked_whole_number(value: object, name: str) -> int:
    """Return `value` as an int, or raise a ValueError that names it."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ValueError(f"{name}: expected a whole number, got {value!r:.80}")
    return int(value)


def _shape_matches(actual: tuple[int, ...], expected: tuple[int | str, ...]) -> bool:
    if expected and expected[0] == "...":
        expected = expected[1:]
        actual = actual[len(actual) - len(expected) :] if len(actual) >= len(expected) else (-1,)
    if len(actual) != len(expected):
        return False
    named: dict[str, int] = {}
    return all(
        named.setdefault(want, have) == have if isinstance(want, str) else want == have
        for want, have in zip(expected, actual, strict=True)
    )
