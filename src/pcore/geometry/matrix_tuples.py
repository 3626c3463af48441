"""3 x 3 matrices as nine numbers, row by row, for compiled loops that keep them in registers.

Arrays of nine would be written to memory and read back between any two steps of a loop over
points, which takes as long as the steps themselves.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Nine = tuple[float, float, float, float, float, float, float, float, float]

UNIT: Nine = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_TINY = 1e-300
_FLATTEST = 1e-12
_ROUNDS = 12
_BLOCK = 64


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cofactors(m: Nine) -> Nine:
    """The transposed inverse times the determinant."""
    a, b, c, d, e, f, g, h, i = m
    first = e * i - f * h, f * g - d * i, d * h - e * g
    second = c * h - b * i, a * i - c * g, b * g - a * h
    return *first, *second, b * f - c * e, c * d - a * f, a * e - b * d


@numba.njit(cache=True, nogil=True, error_model="numpy")
def determinant(m: Nine, other: Nine) -> float:
    """By its cofactors."""
    return m[0] * other[0] + m[1] * other[1] + m[2] * other[2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nine(row: NDArray[np.float64]) -> Nine:
    """The numbers (9,) of an array."""
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def inner(m: Nine, o: Nine) -> float:
    """Sum of the products of entries."""
    first = m[0] * o[0] + m[1] * o[1] + m[2] * o[2]
    second = m[3] * o[3] + m[4] * o[4] + m[5] * o[5]
    return first + second + (m[6] * o[6] + m[7] * o[7] + m[8] * o[8])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mixed(s: float, m: Nine, t: float, o: Nine) -> Nine:
    """Return s m + t o."""
    first = s * m[0] + t * o[0], s * m[1] + t * o[1], s * m[2] + t * o[2]
    second = s * m[3] + t * o[3], s * m[4] + t * o[4], s * m[5] + t * o[5]
    return *first, *second, s * m[6] + t * o[6], s * m[7] + t * o[7], s * m[8] + t * o[8]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def times_transposed(m: Nine, o: Nine) -> Nine:
    """Return m o^T."""
    x = m[0] * o[0] + m[1] * o[1] + m[2] * o[2], m[0] * o[3] + m[1] * o[4] + m[2] * o[5]
    y = m[3] * o[0] + m[4] * o[1] + m[5] * o[2], m[3] * o[3] + m[4] * o[4] + m[5] * o[5]
    z = m[6] * o[0] + m[7] * o[1] + m[8] * o[2], m[6] * o[3] + m[7] * o[4] + m[8] * o[5]
    u = m[0] * o[6] + m[1] * o[7] + m[2] * o[8]
    v = m[3] * o[6] + m[4] * o[7] + m[5] * o[8]
    return *x, u, *y, v, *z, m[6] * o[6] + m[7] * o[7] + m[8] * o[8]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def polar_factors(matrices: NDArray[np.float64], converged: float = 1e-5) -> NDArray[np.float64]:
    """Orthogonal factors (N, 9) of matrices, row by row; the identity of those that are singular.

    By Newton's iteration X <- (X + X^-T) / 2 (Higham 1986), until the sum of the squared changes of
    64 matrices is below `converged`; the next round would change half of that.
    """
    found, block = np.empty((len(matrices), 9)), np.empty(9 * _BLOCK)
    for start in range(0, len(matrices), _BLOCK):
        count = min(_BLOCK, len(matrices) - start)
        for p in range(_BLOCK):
            for k in range(9):
                block[_BLOCK * k + p] = matrices[start + p, k] if p < count else UNIT[k]
        for _ in range(_ROUNDS):
            if _newton_step(block) < converged:
                break
        for p in range(count):
            for k in range(9):
                found[start + p, k] = block[_BLOCK * k + p]
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})
def _newton_step(block: NDArray[np.float64]) -> float:
    """Change matrices by one step towards their orthogonal factors; returns how much, squared.

    Entry k of matrix p is number 64 k + p, so that the machine takes several matrices at once. The
    step is scaled so that the first rounds are as fast as the last.
    """
    total = 0.0
    for p in range(_BLOCK):
        a, b, c = block[p], block[_BLOCK + p], block[2 * _BLOCK + p]
        d, e, f = block[3 * _BLOCK + p], block[4 * _BLOCK + p], block[5 * _BLOCK + p]
        g, h, i = block[6 * _BLOCK + p], block[7 * _BLOCK + p], block[8 * _BLOCK + p]
        old = (a, b, c, d, e, f, g, h, i)
        other = cofactors(old)
        volume, squares = a * other[0] + b * other[1] + c * other[2], inner(old, old)
        sound = abs(volume) > _FLATTEST * squares * math.sqrt(squares) + _TINY
        gain = math.sqrt(math.sqrt(inner(other, other) / squares) / abs(volume))
        here = 0.5 * gain if sound else 0.0
        there = 0.5 / (gain * volume) if sound else 0.0
        new = mixed(1.0, mixed(here, old, there, other), 0.0 if sound else 1.0, UNIT)
        way = mixed(1.0, new, -1.0, old)
        total += inner(way, way)
        block[p], block[_BLOCK + p], block[2 * _BLOCK + p] = new[0], new[1], new[2]
        block[3 * _BLOCK + p], block[4 * _BLOCK + p], block[5 * _BLOCK + p] = new[3], new[4], new[5]
        block[6 * _BLOCK + p], block[7 * _BLOCK + p], block[8 * _BLOCK + p] = new[6], new[7], new[8]
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def products(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products (N, 3, 3) of matrices (N, 3, 3), summed from the first column on."""
    found = np.empty((len(left), 3, 3))
    for n in range(len(left)):
        for i in range(3):
            for j in range(3):
                total = left[n, i, 0] * right[n, 0, j] + left[n, i, 1] * right[n, 1, j]
                found[n, i, j] = total + left[n, i, 2] * right[n, 2, j]
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def uprightnesses(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Determinants (N,) of matrices (N, 3, 3) over those of scalings of the same Frobenius norm."""
    found, rows = np.empty(len(matrices)), matrices.reshape(-1, 9)
    for n in range(len(rows)):
        m = nine(rows[n])
        size = math.sqrt(inner(m, m) / 3.0)
        scale = size * size * size
        found[n] = determinant(m, cofactors(m)) / scale if scale > _TINY else 0.0
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def extents(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Singular values (N, 3) of matrices (N, 3, 3), largest first, to 1e-8 of each.

    The product of the first two is the largest one of the cofactors, that of all the determinant.
    A factorisation, which finds vectors as well, takes ten times as long.
    """
    found, rows = np.empty((len(matrices), 3)), matrices.reshape(-1, 9)
    for n in range(len(rows)):
        m = nine(rows[n])
        other = cofactors(m)
        one, two, three = _longest(m), _longest(other), abs(determinant(m, other))
        found[n, 0] = one
        found[n, 1] = two / one if one > 0.0 else 0.0
        found[n, 2] = three / two if two > 0.0 else 0.0
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _longest(m: Nine) -> float:
    """Largest singular value: a root of the characteristic polynomial of m^T m (Smith 1961)."""
    square = times_transposed(m, m)
    mean = (square[0] + square[4] + square[8]) / 3.0
    rest = mixed(1.0, square, -mean, UNIT)
    width = math.sqrt(inner(rest, rest) / 6.0)
    scaled = mixed(1.0 / width if width > 0.0 else 0.0, rest, 0.0, rest)
    share = min(max(0.5 * determinant(scaled, cofactors(scaled)), -1.0), 1.0)
    return math.sqrt(mean + 2.0 * width * math.cos(math.acos(share) / 3.0))
