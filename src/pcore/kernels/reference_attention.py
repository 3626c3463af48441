"""The specification of proximity attention in plain PyTorch: dense, all pairs at once."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.kernels.networks import Layers, standardise


def attention_scores(
    waves: Tensor,
    own: Tensor,
    neighbours: Tensor,
    answering: Tensor,
    queries: Tensor,
    key: Layers,
) -> Tensor:
    """<query, standardise(key)> of every pair, (R, k); see `functional.proximity_attention`.

    Args:
        waves: (R k, V) encoded parts of the offset from ray to point.
        own: (N, V / 2) encoded positions.
        neighbours: (R, k) indices into the points.
        answering: (R, k) pairs whose score is of use; the others may come out as anything finite.
        queries: (R, D).
        key: network from (own, waves) to D numbers.
    """
    table = torch.cat([own.index_select(0, neighbours.flatten()), waves], dim=-1)
    keys = standardise(key(standardise(table))).unflatten(0, answering.shape)
    return torch.bmm(keys, queries.unsqueeze(-1)).squeeze(-1)


def attention_features(
    waves: Tensor, features: Tensor, neighbours: Tensor, weights: Tensor, value: Layers
) -> Tensor:
    """Weighted sum (R, D) of what the value network's last layer takes.

    Args:
        waves: (R k, V) encoded parts of the offset from ray to point.
        features: (N, F).
        neighbours: (R, k) indices into the points.
        weights: (R, k).
        value: network from (waves, features).
    """
    table = torch.cat([waves, features.index_select(0, neighbours.flatten())], dim=-1)
    hidden = value.hidden(table).unflatten(0, neighbours.shape)
    return torch.bmm(weights.unsqueeze(1), hidden).squeeze(1)
