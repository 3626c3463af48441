"""Which share of a ray's attention a point gets, and what is left of small shares."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from pcore.kernels.networks import Layers


def background_softmax(scores: Tensor, background_score: float) -> tuple[Tensor, Tensor]:
    """Softmax over k points and the background; then the points' weights renormalised.

    The renormalised weights a_i / sum a are the softmax of the points alone. Computed so, they
    neither underflow nor divide by a vanishing sum when the background outweighs every point.
    """
    constant = scores.new_full((scores.shape[0], 1), background_score)
    attention = torch.softmax(torch.cat([scores, constant], dim=-1), dim=-1)
    none = torch.isneginf(scores).all(dim=-1, keepdim=True)
    weights = torch.softmax(scores.masked_fill(none, 0.0), dim=-1).masked_fill(none, 0.0)
    return attention[:, -1], weights


def cut(weights: Tensor, threshold: float) -> Tensor:
    """Drop small weights and scale up the others; the greatest of a ray always stays."""
    kept = weights.where(weights >= weights.amax(dim=-1, keepdim=True).clamp_max(threshold), 0.0)
    return kept / kept.sum(dim=-1, keepdim=True).clamp_min(torch.finfo(kept.dtype).tiny)


def pooled_alone(pool: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Let the value network see the pairs with a weight alone, each as a ray with one neighbour."""

    def pooled(
        waves: Tensor, features: Tensor, neighbours: Tensor, weights: Tensor, value: Layers
    ) -> Tensor:
        kept = weights != 0
        pairs = kept.flatten().nonzero().squeeze(-1)
        alone = (one.flatten()[pairs].unsqueeze(-1) for one in (neighbours, weights))
        found = pool(waves[pairs], features, *alone, value)
        # Pairs come in the order of their rays. Sums of segments, unlike index_add, come out of a
        # GPU the same every time.
        return torch.segment_reduce(found, "sum", lengths=kept.sum(dim=-1), axis=0, unsafe=True)

    return pooled
