"""Gaussians for tests."""

import torch
from torch.nn.functional import normalize

from pcore.gaussians.gaussians import Gaussians


def some_gaussians(
    count: int, *, degree: int = 3, seed: int = 0, dtype: torch.dtype = torch.float32
) -> Gaussians:
    """Random ones in the unit ball, a tenth of a unit large, some of them needles."""
    source = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=source, dtype=torch.float64)

    return Gaussians(
        means=0.4 * normal(count, 3),
        quats=normalize(normal(count, 4), dim=1),
        scales=torch.exp(normal(count, 3) - 3),
        opacities=torch.rand(count, generator=source, dtype=torch.float64),
        sh=0.3 * normal(count, (degree + 1) ** 2, 3),
    ).to(dtype=dtype)
