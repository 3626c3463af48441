"""Shapes of Gaussians: quaternion and scales, and the covariance that they stand for."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.rotation import rotations

_SMALLEST = 1e-12
"""Share of the longest standard deviation that is kept of a direction with none at all."""


def quaternions(matrices: Tensor) -> Tensor:
    """Unit quaternions (..., 4) w, x, y, z with w >= 0 of rotation matrices (..., 3, 3).

    Of the four equal formulas the one is taken that divides by the largest number. Differentiable.
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in matrices.unbind(-2))
    candidates = torch.stack(
        [
            torch.stack([1 + a + e + i, h - f, c - g, d - b], dim=-1),
            torch.stack([h - f, 1 + a - e - i, d + b, c + g], dim=-1),
            torch.stack([c - g, d + b, 1 - a + e - i, h + f], dim=-1),
            torch.stack([d - b, c + g, h + f, 1 - a - e + i], dim=-1),
        ],
        dim=-2,
    )
    largest = candidates.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)
    chosen = torch.take_along_dim(candidates, largest[..., None, None], dim=-2).squeeze(-2)
    unit = torch.nn.functional.normalize(chosen, dim=-1)
    return torch.where(unit[..., :1] < 0, -unit, unit)


def covariances(quats: Tensor, scales: Tensor) -> Tensor:
    """Covariances (..., 3, 3), world units squared, of quats (..., 4) and scales (..., 3).

    Differentiable.
    """
    factors = rotations(quats) * scales.unsqueeze(-2)
    return factors @ factors.mT


def shapes_of(covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Quaternions (..., 4) and scales (..., 3), ascending, of covariances (..., 3, 3).

    The symmetric part counts. Scales are at least 1e-12 of the longest one. Differentiable where
    the three scales differ.
    """
    variances, axes = torch.linalg.eigh((covariance + covariance.mT) / 2)
    # The third axis is the one that makes a right-handed system.
    third = torch.linalg.cross(axes[..., 0], axes[..., 1])
    axes = torch.stack([axes[..., 0], axes[..., 1], third], dim=-1)
    least = variances[..., 2:].clamp_min(torch.finfo(variances.dtype).tiny) * _SMALLEST**2
    return quaternions(axes), variances.clamp_min(least).sqrt()
