"""Means over the squares of pixels that the renderer network takes for one."""

from __future__ import annotations

from torch import Tensor


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
    total = weights[reach] * values
    for away in range(-min(reach, size - 1), min(reach, size - 1) + 1):
        if away:  # Beyond the rim is nothing to be added.
            there = values.narrow(axis, max(0, away), size - abs(away))
            here = total.narrow(axis, max(0, -away), size - abs(away))
            here.add_(there, alpha=weights[reach + away])
    return total
