"""Embedding networks as plain tensors, the form in which the kernels take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

EPSILON = 1e-12
"""Added to a variance: far below any that occurs, it only keeps equal numbers finite."""


@dataclass(frozen=True, kw_only=True)
class Layers:
    """Linear layers with (leaky) ReLU between them and an optional skip of the input.

    Attributes:
        weights: (out, in) of every layer.
        biases: (out,) of every layer.
        negative_slope: of the leaky ReLU; 0 is ReLU.
        skip_after: the input is concatenated behind the output of this layer (1 is the first).
    """

    weights: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]
    negative_slope: float = 0.0
    skip_after: int | None = None

    def with_parameters(self, parameters: Sequence[Tensor]) -> Layers:
        """Return the same network with other weights and, behind them, biases."""
        half = len(parameters) // 2
        return replace(self, weights=tuple(parameters[:half]), biases=tuple(parameters[half:]))

    def hidden(self, x: Tensor) -> Tensor:
        """Everything but the last linear layer, of (..., in)."""
        out = x
        for index, (weight, bias) in enumerate(
            zip(self.weights[:-1], self.biases[:-1], strict=True), start=1
        ):
            out = F.linear(out, weight, bias)
            out = F.leaky_relu_(out, self.negative_slope) if self.negative_slope else F.relu_(out)
            if index == self.skip_after:
                out = torch.cat([out, x], dim=-1)
        return out

    def last(self, hidden: Tensor) -> Tensor:
        """The last linear layer."""
        return F.linear(hidden, self.weights[-1], self.biases[-1])

    def __call__(self, x: Tensor) -> Tensor:
        """Embed (..., in)."""
        return self.last(self.hidden(x))

    def after(self, gain: Tensor, offset: Tensor) -> Layers:
        """Return the network that does to x what this one does to gain x + offset."""
        weights, biases = list(self.weights), list(self.biases)
        for index in {0, self.skip_after or 0}:
            weight = weights[index]
            before, read = weight.split([weight.shape[1] - len(gain), len(gain)], dim=1)
            weights[index] = torch.cat([before, read * gain], dim=1)
            biases[index] = biases[index] + read @ offset
        return self.with_parameters([*weights, *biases])


def standardise(x: Tensor) -> Tensor:
    """(x - mean) / std over the last axis, with the biased standard deviation."""
    return F.layer_norm(x, x.shape[-1:], eps=EPSILON)
