"""Local maps from where points went, by one least squares: for what moves while somebody looks."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from pcore.geometry.matrix_tuples import (
    UNIT,
    Nine,
    cofactors,
    determinant,
    inner,
    mixed,
    nine,
    polar_factors,
    times_transposed,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

_RIDGE = 0.03
_LONGEST = 2.5
_TINY = 1e-30
_BLOCK = 64


@numba.njit(cache=True, nogil=True, error_model="numpy")
def offsets_to(places: FloatArray, beside: IntArray) -> NDArray[np.float32]:
    """What `quick_fit` asks of places (N, 3) at rest and the numbers (N, K) of their neighbours.

    Returns:
        (N, K, 4): where each neighbour is from its place, and 1 over how far; 0 in the same place.
    """
    found = np.zeros((*beside.shape, 4), dtype=np.float32)
    for i in range(len(beside)):
        for k, other in enumerate(beside[i]):
            length = 0.0
            for a in range(3):
                way = places[other, a] - places[i, a]
                found[i, k, a] = way
                length += way * way
            found[i, k, 3] = 1.0 / math.sqrt(length) if length > _TINY else 0.0
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quick_fit(
    after: FloatArray, beside: IntArray, offsets: NDArray[np.float32], singular: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Linear maps (N, 9) around points, row by row, and which (N,) are similarities instead.

    As `pcore.deform.jacobian.fitted_maps`, which says what is fitted and why, but neighbours that
    went elsewhere lose their say once, by how much farther away they are than most points around
    are from the nearest one, and what is left of their pull is scaled down as a whole.

    Args:
        after: (N, 3) where they went.
        beside: (N, K) neighbours of each before, not itself, the nearest first.
        offsets: (N, K, 4) of them, see `offsets_to`.
        singular: share of a rigid motion's determinant that a map keeps at least.
    """
    count = len(after)
    linear, bad = np.empty((count, 9)), np.zeros(count, dtype=np.bool_)
    scales, rows = _scales(after, beside, offsets), np.empty((3, _BLOCK, 9))
    spreads, crosses, upright = rows[0], rows[1], rows[2]
    for start in range(0, count, _BLOCK):
        size = min(_BLOCK, count - start)
        for p in range(size):
            i = start + p
            spread, cross = _moments(after, beside[i], offsets[i], i, 1.0 / scales[i])
            _put(spreads, p, spread)
            _put(crosses, p, cross)
            _put(upright, p, _upright(cross))
        turns = polar_factors(upright[:size])
        for p in range(size):
            i, turn = start + p, nine(turns[p])
            found = _pulled(nine(spreads[p]), nine(crosses[p]), turn, scales[i])
            length = math.sqrt(inner(found, found) / 3.0)
            bad[i] = not determinant(found, cofactors(found)) > singular * length * length * length
            _put(linear, i, mixed(scales[i], turn, 0.0, turn) if bad[i] else found)
    return linear, bad


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _changes(after: FloatArray, beside: IntArray, offsets: NDArray[np.float32]) -> FloatArray:
    """By what factor the distance of each point from its nearest neighbour elsewhere changed."""
    change = np.ones(len(after))
    for i in range(len(after)):
        for k, other in enumerate(beside[i]):
            if offsets[i, k, 3] > 0:
                x, y, z = after[other, 0], after[other, 1], after[other, 2]
                x, y, z = x - after[i, 0], y - after[i, 1], z - after[i, 2]
                change[i] = math.sqrt(x * x + y * y + z * z) * offsets[i, k, 3]
                break
    return change


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _scales(after: FloatArray, beside: IntArray, offsets: NDArray[np.float32]) -> FloatArray:
    """Medians (N,) of the changes of each point and its neighbours."""
    change = _changes(after, beside, offsets)
    scales, least = np.empty_like(change), np.empty((beside.shape[1] + 1) // 2 + 1)
    for i in range(len(after)):
        least[:] = np.inf
        least[0] = change[i]
        for other in beside[i]:
            value = change[other]
            # The lower half in its order, without a branch that cannot be foretold.
            for k in range(len(least)):
                kept = least[k]
                least[k], value = (kept, value) if kept < value else (value, kept)
        scales[i] = max(least[-1], _TINY)
    return scales


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moments(
    after: FloatArray, beside: IntArray, offsets: NDArray[np.float32], i: int, share: float
) -> tuple[Nine, Nine]:
    """Weighted sums of offset offset^T and image offset^T; `share` is 1 over how lengths change."""
    xx = xy = xz = yy = yz = zz = 0.0
    ax = ay = az = bx = by = bz = cx = cy = cz = 0.0
    for k, other in enumerate(beside):
        a, b, c = after[other, 0], after[other, 1], after[other, 2]
        a, b, c = a - after[i, 0], b - after[i, 1], c - after[i, 2]
        x, y, z = float(offsets[k, 0]), float(offsets[k, 1]), float(offsets[k, 2])
        near = float(offsets[k, 3])
        away = math.sqrt(a * a + b * b + c * c) * near * share - 1.0
        more = 1.0 + away * away
        weight = near / (more * more)
        u, v, w = weight * x, weight * y, weight * z
        xx, xy, xz = xx + u * x, xy + u * y, xz + u * z
        yy, yz, zz = yy + v * y, yz + v * z, zz + w * z
        ax, ay, az = ax + a * u, ay + a * v, az + a * w
        bx, by, bz = bx + b * u, by + b * v, bz + b * w
        cx, cy, cz = cx + c * u, cy + c * v, cz + c * w
    return (xx, xy, xz, xy, yy, yz, xz, yz, zz), (ax, ay, az, bx, by, bz, cx, cy, cz)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pulled(spread: Nine, cross: Nine, turn: Nine, scale: float) -> Nine:
    """The fit, pulled towards a similarity, and scaled down where it lengthens too much."""
    ridge = _RIDGE * (spread[0] + spread[4] + spread[8]) + _TINY
    firm = mixed(1.0, spread, ridge, UNIT)
    other = cofactors(firm)
    whole = times_transposed(mixed(1.0, cross, ridge * scale, turn), other)
    share = 1.0 / determinant(firm, other)
    size, most = share * math.sqrt(inner(whole, whole) / 3.0), _LONGEST * scale
    return mixed(share * min(1.0, most / size), whole, 0.0, whole)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _upright(matrix: Nine) -> Nine:
    """A matrix whose orthogonal factor is the rotation nearest to one.

    Neighbours on a surface leave one direction out. The cofactors have the same singular vectors
    and fill it in, turned so that nothing is mirrored. The identity where nothing is to be found.
    """
    other, size = cofactors(matrix), math.sqrt(inner(matrix, matrix))
    filled = mixed(1.0, matrix, math.sqrt(2.0) / max(size, _TINY), other)
    return filled if determinant(filled, cofactors(filled)) > 0 else UNIT


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _put(rows: FloatArray, i: int, values: Nine) -> None:
    for k in range(9):
        rows[i, k] = values[k]
