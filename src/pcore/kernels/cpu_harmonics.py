"""Colours by spherical harmonics on the CPU by numba, with gradients.

What is computed is said in `gaussians.spherical_harmonics`. Numbers are float64 between the arrays.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.cpu_projection_loops import CHUNK
from pcore.kernels.numba_bridge import as_array


def colors(sh: Tensor, directions: Tensor, factors: np.ndarray) -> Tensor:
    """max(0, 0.5 + sum_k Y_k sh_k); differentiable.

    Args:
        sh: (N, K, 3) coefficients; float32 or float64, as the directions.
        directions: (C, N, 3).
        factors: (degree + 1, degree + 1) what Q_l^m (x + iy)^m is multiplied by.

    Returns:
        (C, N, 3).
    """
    return _Colors.apply(sh, directions, factors)


class _Colors(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, sh: Tensor, directions: Tensor, factors: np.ndarray) -> Tensor:
        use_torch_threads()
        found = torch.empty_like(directions, memory_format=torch.contiguous_format)
        _forward(as_array(sh), as_array(directions), factors, found.numpy())
        ctx.save_for_backward(sh, directions, found)
        ctx.factors = factors
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        sh, directions, found = ctx.saved_tensors
        to_sh = torch.empty_like(sh, memory_format=torch.contiguous_format)
        to_directions = torch.empty_like(directions, memory_format=torch.contiguous_format)
        _backward(
            as_array(sh),
            as_array(directions),
            ctx.factors,
            found.numpy(),
            as_array(gradients[0]),
            (to_sh.numpy(), to_directions.numpy()),
        )
        return to_sh, to_directions, None


@numba.njit(cache=True, error_model="numpy")
def _basis(
    direction: np.ndarray, factors: np.ndarray, work: np.ndarray, values: np.ndarray
) -> None:
    """Harmonics (row 0) and their derivatives by x, y and z (rows 1 to 3).

    Args:
        direction: (3,).
        factors: (L + 1, L + 1).
        work: (L + 3, L + 3) is overwritten.
        values: (4, K) receives them.
    """
    degree = len(factors) - 1
    x, y, z = float(direction[0]), float(direction[1]), float(direction[2])
    # Q_l^m by the recurrence in l; its derivative is Q_l^(m + 1), which is 0 beyond l.
    work[:] = 0.0
    odd = 1.0
    for m in range(degree + 1):
        work[m, m] = odd
        odd *= 2 * m + 1
        for l in range(m + 1, degree + 1):  # noqa: E741
            upper = (2 * l - 1) * z * work[l - 1, m]
            if l > m + 1:
                upper -= (l + m - 1) * work[l - 2, m]
            work[l, m] = upper / (l - m)
    cosine, sine, last_cosine, last_sine = 1.0, 0.0, 0.0, 0.0
    for m in range(degree + 1):
        for l in range(m, degree + 1):  # noqa: E741
            part, steeper = factors[l, m] * work[l, m], factors[l, m] * work[l, m + 1]
            k = l * l + l
            values[0, k + m] = part * cosine
            values[1, k + m] = part * m * last_cosine
            values[2, k + m] = -part * m * last_sine
            values[3, k + m] = steeper * cosine
            if m > 0:
                values[0, k - m] = part * sine
                values[1, k - m] = part * m * last_sine
                values[2, k - m] = part * m * last_cosine
                values[3, k - m] = steeper * sine
        last_cosine, last_sine = cosine, sine
        cosine, sine = x * last_cosine - y * last_sine, x * last_sine + y * last_cosine


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _forward(
    sh: np.ndarray, directions: np.ndarray, factors: np.ndarray, found: np.ndarray
) -> None:
    count, numbers = sh.shape[:2]
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        work = np.empty((len(factors) + 2, len(factors) + 2))
        values = np.empty((4, numbers))
        for n in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            for c in range(len(directions)):
                _basis(directions[c, n], factors, work, values)
                red, green, blue = 0.5, 0.5, 0.5
                for k in range(numbers):
                    red += values[0, k] * sh[n, k, 0]
                    green += values[0, k] * sh[n, k, 1]
                    blue += values[0, k] * sh[n, k, 2]
                found[c, n, 0], found[c, n, 1] = max(red, 0.0), max(green, 0.0)
                found[c, n, 2] = max(blue, 0.0)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _backward(
    sh: np.ndarray,
    directions: np.ndarray,
    factors: np.ndarray,
    found: np.ndarray,
    to_found: np.ndarray,
    results: tuple[np.ndarray, np.ndarray],
) -> None:
    to_sh, to_directions = results
    count, numbers = sh.shape[:2]
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        work = np.empty((len(factors) + 2, len(factors) + 2))
        values, sums, slopes = np.empty((4, numbers)), np.empty((numbers, 3)), np.empty(3)
        for n in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            sums[:] = 0.0
            for c in range(len(directions)):
                _basis(directions[c, n], factors, work, values)
                # What was raised to 0 moves by nothing.
                for d in range(3):
                    slopes[d] = to_found[c, n, d] if found[c, n, d] > 0 else 0.0
                red, green, blue = slopes[0], slopes[1], slopes[2]
                dx, dy, dz = 0.0, 0.0, 0.0
                for k in range(numbers):
                    value = values[0, k]
                    sums[k, 0] += red * value
                    sums[k, 1] += green * value
                    sums[k, 2] += blue * value
                    weight = red * sh[n, k, 0] + green * sh[n, k, 1] + blue * sh[n, k, 2]
                    dx += weight * values[1, k]
                    dy += weight * values[2, k]
                    dz += weight * values[3, k]
                to_directions[c, n, 0], to_directions[c, n, 1] = dx, dy
                to_directions[c, n, 2] = dz
            for k in range(numbers):
                for d in range(3):
                    to_sh[n, k, d] = sums[k, d]
