"""Gaussians carried by local maps on the CPU by numba: shapes, and where their colours are seen."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

_ROUNDS = 12
_CONVERGED = 1e-10
_FLATTEST = 1e-12


def carried_shapes(
    covariances: Tensor, local_maps: Tensor, directions: Tensor
) -> tuple[Tensor, Tensor]:
    """Covariances J S J^T, and directions Q^T d with the orthogonal factor Q of J = Q P.

    Args:
        covariances: (N, 3, 3) S at rest, float32 on the CPU.
        local_maps: (N, 3, 3) J, float64 on the CPU.
        directions: (N, 3) d in which they are seen now, float32.

    Returns:
        (N, 3, 3) and (N, 3) float32. Where J is singular the direction is d.
    """
    shapes, seen = torch.empty_like(covariances), torch.empty_like(directions)
    _carry(*(one.numpy() for one in (covariances, local_maps, directions, shapes, seen)))
    return shapes, seen


@numba.njit(cache=True, nogil=True)
def _carry(
    covariances: np.ndarray,
    local_maps: np.ndarray,
    directions: np.ndarray,
    shapes: np.ndarray,
    seen: np.ndarray,
) -> None:
    half, turn, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(local_maps)):
        local = local_maps[n]
        for i in range(3):
            for j in range(3):
                half[i, j] = 0.0
                for k in range(3):
                    half[i, j] += local[i, k] * covariances[n, k, j]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += half[i, k] * local[j, k]
                shapes[n, i, j] = total
        _polar(local, turn, inverse)
        for j in range(3):
            total = 0.0
            for i in range(3):
                total += turn[i, j] * directions[n, i]
            seen[n, j] = total


@numba.njit(cache=True, nogil=True)
def _polar(local: np.ndarray, turn: np.ndarray, inverse: np.ndarray) -> None:
    """Orthogonal factor of a matrix, by Newton's iteration X <- (X + X^-T) / 2 (Higham 1986)."""
    turn[:] = local
    for _ in range(_ROUNDS):
        determinant = _cofactors(turn, inverse)
        size = 0.0
        for i in range(3):
            for j in range(3):
                size += turn[i, j] * turn[i, j]
        if not abs(determinant) > _FLATTEST * size**1.5:
            for i in range(3):
                for j in range(3):
                    turn[i, j] = 1.0 if i == j else 0.0
            return
        # Scaled so that the determinant is 1, which makes the first rounds as fast as the last.
        scale = abs(determinant) ** (-1.0 / 3.0)
        change = 0.0
        for i in range(3):
            for j in range(3):
                old = turn[i, j]
                new = 0.5 * (scale * old + inverse[i, j] / (determinant * scale))
                turn[i, j] = new
                change += (new - old) ** 2
        if change < _CONVERGED:
            return


@numba.njit(cache=True, nogil=True)
def _cofactors(m: np.ndarray, out: np.ndarray) -> Any:
    """Cofactors, the transposed inverse times the determinant, which is returned."""
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            out[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    return m[0, 0] * out[0, 0] + m[0, 1] * out[0, 1] + m[0, 2] * out[0, 2]
