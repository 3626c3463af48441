"""Sizes of the positional encoding, and the normalisation around the embedding networks."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F


def encoded_size(coordinates: int, frequencies: int) -> int:
    """Length of the encoding of a vector of `coordinates` numbers."""
    return coordinates * (1 + 2 * frequencies)


class Normalisation(nn.Module):
    """a (x - mean) / std + b over the last axis, with the UNBIASED standard deviation.

    The original adds 1e-6 to the standard deviation. We reach the same by torch's fused layer norm
    (biased variance, a vanishing eps) times sqrt((n - 1) / n); the two differ by 1e-6 / std,
    relative.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(size))
        self.offset = nn.Parameter(torch.zeros(size))
        self.unbias = math.sqrt((size - 1) / size)

    def forward(self, x: Tensor) -> Tensor:
        """Normalise the last axis of (..., size)."""
        return F.layer_norm(x, self.gain.shape, self.gain * self.unbias, self.offset, eps=1e-12)
