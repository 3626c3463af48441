"""PAPR's formulas as they stand in the paper, dense: what ours is measured against.

Written from the paper, without any of our algebra or kernels: every ray looks at every point, with
tensors of rays x points x 3. The original makes them for all rays at once (28 GB for 160 x 160 rays
and 30,000 points); here they are made in chunks, of the size that was fastest on a CPU.
"""

from __future__ import annotations

import torch
from torch import Tensor

PAIRS = 2**18
"""Ray-point pairs of a chunk."""


def nearest_to_rays(
    origins: Tensor, directions: Tensor, points: Tensor, k: int, pairs: int = PAIRS
) -> Tensor:
    """Indices (R, k) of the points nearest to the lines of (R, 3) rays, nearest first."""
    rays = max(1, pairs // len(points))
    found = [
        _nearest(o, d, points, k)
        for o, d in zip(origins.split(rays), directions.split(rays), strict=True)
    ]
    return torch.cat(found)


def _nearest(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    to_point = points.unsqueeze(0) - origins.unsqueeze(1)
    along = (to_point * directions.unsqueeze(1)).sum(dim=-1, keepdim=True)
    off = to_point - along * directions.unsqueeze(1)
    return off.norm(dim=-1).topk(k, dim=-1, largest=False).indices
