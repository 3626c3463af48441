"""Gaussians carried by local maps on the CPU by numba: shapes, and where their colours are seen."""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from pcore.geometry.matrix_tuples import nine, polar_factors, times_transposed


def carried_shapes(
    covariances: Tensor, local_maps: Tensor, directions: Tensor
) -> tuple[Tensor, Tensor]:
    """Covariances J S J^T, and directions Q^T d with the orthogonal factor Q of J = Q P.

    Args:
        covariances: (N, 3, 3) S at rest, symmetric, float32 on the CPU.
        local_maps: (N, 3, 3) J, float64 on the CPU.
        directions: (N, 3) d in which they are seen now, float32.

    Returns:
        (N, 3, 3) and (N, 3) float32. Where J is singular the direction is d.
    """
    shapes, seen = torch.empty_like(covariances), torch.empty_like(directions)
    flat = (covariances.reshape(-1, 9), local_maps.reshape(-1, 9), directions)
    _carry(*(one.numpy() for one in (*flat, shapes.view(-1, 9), seen)))
    return shapes, seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _carry(
    covariances: np.ndarray,
    local_maps: np.ndarray,
    directions: np.ndarray,
    shapes: np.ndarray,
    seen: np.ndarray,
) -> None:
    turns = polar_factors(local_maps)
    for n in range(len(local_maps)):
        local = nine(local_maps[n])
        moved = times_transposed(times_transposed(local, nine(covariances[n])), local)
        for k in range(9):
            shapes[n, k] = moved[k]
        x, y, z = directions[n]
        for k in range(3):
            seen[n, k] = turns[n, k] * x + turns[n, k + 3] * y + turns[n, k + 6] * z
