"""Short lists of the nearest, sorted by keys of distance and place."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

PLACE = np.int64(0xFFFFFFFF)
"""The part of a key that is the place."""


@numba.njit(cache=True)
def key_of(bits: Any, place: Any) -> Any:
    """Squared distance, whose bits are ordered as integers, and behind it the place in a list.

    So equal distances come in the order of the list. Without its sign, NaN is last.
    """
    return ((np.int64(bits) & 0x7FFFFFFF) << 32) | place


@numba.njit(cache=True)
def sift(best: np.ndarray, slot: int, key: Any) -> None:
    """Move keys up until `key` has its place in the sorted list, at `slot` or before."""
    while slot > 0 and best[slot - 1] > key:
        best[slot] = best[slot - 1]
        slot -= 1
    best[slot] = key
