"""Real spherical harmonics: how the colour of a Gaussian depends on where it is seen from.

The basis is the one of 3D Gaussian Splatting and gsplat: orthonormal on the sphere, order
m = -l .. l within degree l, with the sign (-1)^m (Condon-Shortley) on both sines and cosines. In
the form used here, with unit direction (x, y, z),

    Y_lm = (-1)^m n_lm Q_l^|m|(z) * (sqrt2 Re (x + iy)^m | 1 | sqrt2 Im (x + iy)^|m|)

for m > 0, m = 0, m < 0, where Q_l^m = P_l^m / (1 - z^2)^(m/2) is a polynomial in z.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor

from pcore.kernels import cpu_harmonics

HIGHEST_DEGREE = 4

_BLOCK = 16384
"""Gaussians whose harmonics are turned at a time, so that memory stays bounded."""


def basis(degree: int, directions: Tensor) -> Tensor:
    """Values of all harmonics up to a degree.

    Args:
        degree: 0 to `HIGHEST_DEGREE`.
        directions: (..., 3) of unit length, from the camera to the Gaussian.

    Returns:
        (..., (degree + 1)^2), degree by degree, order m = -l .. l. Differentiable.
    """
    x, y, z = directions.unbind(dim=-1)
    one = torch.ones_like(z)
    cosines, sines = [one], [torch.zeros_like(z)]
    for _ in range(degree):
        cosine, sine = cosines[-1], sines[-1]
        cosines.append(x * cosine - y * sine)
        sines.append(x * sine + y * cosine)
    polynomials = _polynomials(degree, z, one)
    columns: list[Tensor] = []
    for l in range(degree + 1):  # noqa: E741
        for m in range(-l, l + 1):
            wave = sines[-m] if m < 0 else cosines[m]
            columns.append(factor(l, abs(m)) * polynomials[l, abs(m)] * wave)
    return torch.stack(columns, dim=-1)


def _polynomials(degree: int, z: Tensor, one: Tensor) -> dict[tuple[int, int], Tensor]:
    """Q_l^m(z) without the sign (-1)^m, by the recurrence of the Legendre functions in l."""
    result: dict[tuple[int, int], Tensor] = {}
    for m in range(degree + 1):
        result[m, m] = one * math.prod(range(1, 2 * m, 2))
        if m < degree:
            result[m + 1, m] = (2 * m + 1) * z * result[m, m]
        for l in range(m + 2, degree + 1):  # noqa: E741
            upper = (2 * l - 1) * z * result[l - 1, m] - (l + m - 1) * result[l - 2, m]
            result[l, m] = upper / (l - m)
    return result


@cache
def factor(l: int, m: int) -> float:  # noqa: E741
    """(-1)^m times n_lm, which makes the harmonics orthonormal, and sqrt2 where m is not 0."""
    squared = (2 * l + 1) / (4 * math.pi) * math.factorial(l - m) / math.factorial(l + m)
    return (-1) ** m * math.sqrt(squared * (2 if m else 1))


@cache
def _factors(degree: int) -> np.ndarray:
    """(degree + 1, degree + 1) factors by l and m."""
    orders = range(degree + 1)
    return np.array([[factor(max(row, m), m) * (m <= row) for m in orders] for row in orders])


def colors(sh: Tensor, directions: Tensor) -> Tensor:
    """Colours max(0, 0.5 + sum_k Y_k sh_k), red, green, blue; differentiable.

    Args:
        sh: (..., K, 3) coefficients, K = (degree + 1)^2.
        directions: (..., 3) of unit length, from the camera to the Gaussian.

    Returns:
        (..., 3) not negative; more than 1 is possible.
    """
    degree = math.isqrt(sh.shape[-2]) - 1
    if sh.device.type == "cpu" and sh.ndim == 3 and directions.shape[-2] == len(sh):
        looks = math.prod(directions.shape[:-2])  # Not -1, which no rows at all leave open.
        found = cpu_harmonics.colors(
            sh, directions.reshape(looks, *directions.shape[-2:]), _factors(degree)
        )
        return found.view(directions.shape)
    values = basis(degree, directions)
    # A product of matrices: the sum over k, and its gradients, in two thirds of the time.
    return (0.5 + (values.unsqueeze(-2) @ sh).squeeze(-2)).clamp_min(0.0)


def brightened(sh: Tensor, factors: Tensor) -> Tensor:
    """Coefficients of the colours times factors that are not negative, seen from everywhere.

    factor max(0, 0.5 + sum_k Y_k sh_k) = max(0, 0.5 + sum_k Y_k sh_k'): all coefficients are
    scaled, and degree 0 takes what the 0.5 lacks.

    Args:
        sh: (N, K, 3) coefficients.
        factors: (N,).

    Returns:
        (N, K, 3) in the type of `sh`.
    """
    scale = factors.to(sh)[:, None, None]
    first = sh[:, :1] * scale + 0.5 * (scale - 1) / factor(0, 0)
    return torch.cat([first, sh[:, 1:] * scale], dim=1)


def rotated(sh: Tensor, rotations: Tensor) -> Tensor:
    """Coefficients of the same colours after every Gaussian was turned.

    Degree l mixes within itself: sh_l' = D_l sh_l with D_l = pinv(Y_l(d)) Y_l(R^T d) for
    directions d that determine it. Orthogonal matrices that mirror are taken, too.

    Args:
        sh: (N, K, 3) coefficients.
        rotations: (N, 3, 3) orthogonal; what was seen along d is seen along R d.

    Returns:
        (N, K, 3) in the type of `sh`, computed in float64; differentiable.
    """
    degree = math.isqrt(sh.shape[1]) - 1
    if degree == 0:
        return sh
    pieces = [
        _rotated(part, turn.to(device=part.device), degree)
        for part, turn in zip(sh.split(_BLOCK), rotations.split(_BLOCK), strict=True)
    ]
    return torch.cat(pieces) if pieces else sh


def _rotated(sh: Tensor, rotations: Tensor, degree: int) -> Tensor:
    directions, inverses = (tensor.to(sh.device) for tensor in _samples(degree))
    wide = sh.double()
    # Row vectors: d^T R = (R^T d)^T.
    seen = basis(degree, directions @ rotations.double())
    parts = [wide[:, :1]]
    for l in range(1, degree + 1):  # noqa: E741
        band = slice(l * l, (l + 1) ** 2)
        parts.append(inverses[band] @ (seen[..., band] @ wide[:, band]))
    return torch.cat(parts, dim=1).to(sh.dtype)


@cache
def _samples(degree: int) -> tuple[Tensor, Tensor]:
    """Directions (M, 3) spread over the sphere; pinv(Y_l) (K, M), one row per harmonic."""
    count = 4 * degree + 5
    turns = torch.arange(count, dtype=torch.float64)
    height = 1 - (2 * turns + 1) / count
    ring = (1 - height.square()).sqrt()
    angle = turns * math.pi * (3 - math.sqrt(5))
    directions = torch.stack([ring * angle.cos(), ring * angle.sin(), height], dim=1)
    values = basis(degree, directions)
    inverses = [
        torch.linalg.pinv(values[:, l * l : (l + 1) ** 2])
        for l in range(degree + 1)  # noqa: E741
    ]
    return directions, torch.cat(inverses)
