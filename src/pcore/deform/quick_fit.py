"""Local maps from where points went, by one least squares: for what moves while somebody looks."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_RIDGE = 0.03
_LONGEST = 2.5
_STEPS = 12
_TINY = 1e-30
_CONVERGED = 1e-4


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quick_fit(
    before: FloatArray, after: FloatArray, beside: NDArray[np.int32], singular: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Linear maps (N, 3, 3) around points, and which (N,) are similarities instead.

    As `pcore.deform.jacobian.fitted_maps`, which says what is fitted and why, but neighbours that
    went elsewhere lose their say once, by how much farther away they are than most points around
    are from the nearest one, and what is left of their pull is scaled down as a whole.

    Args:
        before: (N, 3).
        after: (N, 3) where they went.
        beside: (N, K) neighbours of each before, not itself.
        singular: share of a rigid motion's determinant that a map keeps at least.
    """
    count = len(before)
    linear, bad = np.empty((count, 3, 3)), np.zeros(count, dtype=np.bool_)
    # Written into again for every point: to make small arrays takes longer than to fill them.
    spread, cross, turn, other = (
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )
    ascending = np.empty(beside.shape[1] + 1)
    change = _changes(before, after, beside)
    for i in range(count):
        scale = _moments(before, after, beside[i], i, change, ascending, spread, cross)
        _rotation(cross, turn, other)
        ridge = _RIDGE * (spread[0, 0] + spread[1, 1] + spread[2, 2]) + _TINY
        for a in range(3):
            spread[a, a] += ridge
            for b in range(3):
                turn[a, b] *= scale
                cross[a, b] += ridge * turn[a, b]
        found = linear[i]
        size = _solve(cross, spread, other, found, _LONGEST * scale)
        bad[i] = not _determinant(found) > singular * size**3
        if bad[i]:
            found[:] = turn
    return linear, bad


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _solve(
    cross: FloatArray, spread: FloatArray, other: FloatArray, found: FloatArray, most: float
) -> float:
    """Write cross spread^-1, scaled down to the root mean square length `most`; return that."""
    _cofactors(spread, other)
    inverse, size = 1.0 / _determinant(spread), 0.0
    for a in range(3):
        for b in range(3):
            total = cross[a, 0] * other[0, b] + cross[a, 1] * other[1, b]
            found[a, b] = inverse * (total + cross[a, 2] * other[2, b])
            size += found[a, b] * found[a, b]
    size = math.sqrt(size / 3.0)
    if size > most:
        found *= most / size
        size = most
    return size


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _changes(before: FloatArray, after: FloatArray, beside: NDArray[np.int32]) -> FloatArray:
    """By what factor the distance of each point from its nearest neighbour elsewhere changed."""
    change = np.ones(len(before))
    for i in range(len(before)):
        for k in beside[i]:
            length = _squared_distance(before, k, i)
            if length > _TINY:
                change[i] = math.sqrt(_squared_distance(after, k, i) / length)
                break
    return change


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moments(
    before: FloatArray,
    after: FloatArray,
    beside: NDArray[np.int32],
    i: int,
    change: FloatArray,
    ascending: FloatArray,
    spread: FloatArray,
    cross: FloatArray,
) -> float:
    """Write weighted sums of offset offset^T and image offset^T; return how lengths changed."""
    spread[:], cross[:] = 0.0, 0.0
    ascending[0] = change[i]
    for count, k in enumerate(beside):
        _insert(ascending, count + 1, change, k)
    scale = max(ascending[len(ascending) // 2], _TINY)
    for k in beside:
        length = _squared_distance(before, k, i)
        if length > _TINY:
            away = math.sqrt(_squared_distance(after, k, i) / length) / scale - 1.0
            weight = 1.0 / (math.sqrt(length) * (1.0 + away * away) ** 2)
            for b in range(3):
                part = weight * (before[k, b] - before[i, b])
                for a in range(3):
                    spread[a, b] += part * (before[k, a] - before[i, a])
                    cross[a, b] += part * (after[k, a] - after[i, a])
    return scale


@numba.njit(cache=True, nogil=True)
def _squared_distance(places: FloatArray, k: int, i: int) -> float:
    x, y, z = places[k, 0] - places[i, 0], places[k, 1] - places[i, 1], places[k, 2] - places[i, 2]
    return x * x + y * y + z * z


@numba.njit(cache=True, nogil=True)
def _insert(ascending: FloatArray, count: int, values: FloatArray, k: int) -> None:
    """Put one more of some values among the first in their order."""
    place, value = count, values[k]
    while place > 0 and ascending[place - 1] > value:
        ascending[place] = ascending[place - 1]
        place -= 1
    ascending[place] = value


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rotation(matrix: FloatArray, turn: FloatArray, other: FloatArray) -> None:
    """Write the rotation nearest to a matrix, by Newton's iteration for the polar factor (Higham).

    Neighbours on a surface leave one direction out. The cofactors have the same singular vectors
    and fill it in, turned so that nothing is mirrored. The identity where nothing is to be found.
    """
    _cofactors(matrix, other)
    norm = math.sqrt(_squares(matrix))
    share = math.sqrt(2.0) / max(norm, _TINY)
    for a in range(3):
        for b in range(3):
            turn[a, b] = matrix[a, b] + share * other[a, b]
    for _ in range(_STEPS):
        determinant = _determinant(turn)
        if not determinant > _TINY * norm**3:
            for a in range(3):
                for b in range(3):
                    turn[a, b] = 1.0 if a == b else 0.0
            return
        _cofactors(turn, other)
        gain = math.sqrt(math.sqrt(_squares(other) / _squares(turn)) / determinant)
        here, there, moved = 0.5 * gain, 0.5 / (gain * determinant), 0.0
        for a in range(3):
            for b in range(3):
                further = here * turn[a, b] + there * other[a, b]
                moved = max(moved, abs(further - turn[a, b]))
                turn[a, b] = further
        if moved < _CONVERGED:
            return


@numba.njit(cache=True, nogil=True)
def _squares(matrix: FloatArray) -> float:
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += matrix[a, b] * matrix[a, b]
    return total


@numba.njit(cache=True, nogil=True)
def _cofactors(matrix: FloatArray, result: FloatArray) -> None:
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            result[a, d] = matrix[b, e] * matrix[c, f] - matrix[b, f] * matrix[c, e]


@numba.njit(cache=True, nogil=True)
def _determinant(matrix: FloatArray) -> float:
    return (
        matrix[0, 0] * (matrix[1, 1] * matrix[2, 2] - matrix[1, 2] * matrix[2, 1])
        - matrix[0, 1] * (matrix[1, 0] * matrix[2, 2] - matrix[1, 2] * matrix[2, 0])
        + matrix[0, 2] * (matrix[1, 0] * matrix[2, 1] - matrix[1, 1] * matrix[2, 0])
    )
