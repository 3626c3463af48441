"""Means over the squares of pixels that the renderer network takes for one."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def mean_around(features: Tensor, width: int) -> Tensor:
    """Means (H, W, C) over squares of so many pixels around every pixel, zeros beyond the rim.

    Where the number is even the outermost pixels of a square count half.
    """
    weights = [1.0 / width] * (2 * (width // 2) + 1)
    if width % 2 == 0:
        weights[0] = weights[-1] = 0.5 / width
    return _summed(_summed(features, weights, 0), weights, 1)


def _summed(values: Tensor, weights: list[float], axis: int) -> Tensor:
    """Weighted sum (H, W, C) of shifted copies along an axis.

    A convolution, of each channel by itself, takes thirty times as long.
    """
    reach, size = len(weights) // 2, values.shape[axis]
    rim = [0, 0, reach, reach, 0, 0] if axis else [0, 0, 0, 0, reach, reach]
    wide = F.pad(values, rim)
    total = weights[0] * wide.narrow(axis, 0, size)
    for shift, weight in enumerate(weights[1:], start=1):
        total = torch.add(total, wide.narrow(axis, shift, size), alpha=weight)
    return total
