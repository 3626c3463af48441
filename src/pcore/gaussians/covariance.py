"""Shapes of Gaussians: quaternions, and the covariances that they and scales stand for."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.rotation import rotations


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
