"""Proximity attention: what the k points nearest to a ray contribute to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.functional import encode_pairs
from pcore.kernels.reference import encode
from pcore.model.config import MlpConfig, PaprConfig
from pcore.model.encoding import Normalisation, encoded_size


@dataclass(frozen=True, kw_only=True)
class Attended:
    """What attention says about R rays.

    Attributes:
        features: (R, C) weighted values.
        background: (R,) attention that the background keeps; 1 minus it is the opacity.
        weights: (R, k) weights of the points, renormalised to sum to one (zero where no point
            is within the cut-off).
        surface: (R, 3) weighted positions, world units (paper: s_j = sum w p).
        behind: (R,) weighted mean squared distance along the ray from the first of the points:
            large where the back of the object shows through. No gradient to the positions.
    """

    features: Tensor
    background: Tensor
    weights: Tensor
    surface: Tensor
    behind: Tensor


class Mlp(nn.Module):
    """Linear layers with (leaky) ReLU between them and an optional skip of the input."""

    def __init__(self, size_in: int, config: MlpConfig, negative_slope: float) -> None:
        super().__init__()
        self.skip_after = config.skip_after
        self.negative_slope = negative_slope
        self.layers = nn.ModuleList()
        width_in = size_in
        for index in range(1, config.layers + 1):
            width_out = config.size if index == config.layers else config.width
            layer = nn.Linear(width_in, width_out)
            nn.init.xavier_uniform_(layer.weight)
            self.layers.append(layer)
            width_in = width_out + (size_in if index == config.skip_after else 0)

    def hidden(self, x: Tensor) -> Tensor:
        """Everything but the last linear layer."""
        out = x
        for index, layer in enumerate(self.layers[:-1], start=1):
            out = layer(out)
            out = F.leaky_relu_(out, self.negative_slope) if self.negative_slope else F.relu_(out)
            if index == self.skip_after:
                out = torch.cat([out, x], dim=-1)
        return out

    def forward(self, x: Tensor) -> Tensor:
        """Embed (..., size_in)."""
        return self.layers[-1](self.hidden(x))


class NormalisedMlp(nn.Module):
    """An embedding network with the original's normalisation before and after."""

    def __init__(self, size_in: int, config: MlpConfig, negative_slope: float) -> None:
        super().__init__()
        self.innorm = Normalisation(size_in)
        self.mlp = Mlp(size_in, config, negative_slope)
        self.outnorm = Normalisation(config.size)

    def forward(self, x: Tensor) -> Tensor:
        """Embed (..., size_in)."""
        return self.outnorm(self.mlp(self.innorm(x)))


class ProximityAttention(nn.Module):
    """Keys, queries, values and scores of PAPR."""

    def __init__(self, config: PaprConfig) -> None:
        super().__init__()
        self.config = config
        vector = encoded_size(3, config.frequencies)
        self.key = NormalisedMlp(3 * vector, config.key, config.negative_slope)
        self.query = NormalisedMlp(vector, config.query, config.negative_slope)
        self.value = Mlp(2 * vector + config.feature_size, config.value, config.negative_slope)
        self.w_key = nn.Linear(config.key.size, config.key.size)
        self.w_query = nn.Linear(config.query.size, config.query.size)

    def forward(
        self, cloud: PointCloud, rays: RayBundle, neighbours: Tensor, seen: RayBundle
    ) -> Attended:
        """Attend from R rays to their neighbours.

        Args:
            cloud: the points.
            rays: (R,) rays, world units.
            neighbours: (R, k) indices into the cloud.
            seen: the rays as the networks see them: (R,), or (R, k) as each neighbour sees them
                in the rest state of the cloud.

        Returns:
            The attended features, opacity and surface points.
        """
        config = self.config
        rays_count, k = neighbours.shape
        table, squared = encode_pairs(
            cloud.positions if cloud.frames is None else cloud.frames.rest,
            cloud.features,
            seen.origins,
            seen.directions,
            neighbours,
            scale=config.coord_scale,
            frequencies=config.frequencies,
        )
        vector = encoded_size(3, config.frequencies)
        scores = self._scores(table[:, : 3 * vector], _of_query(seen.directions), k)
        rows = neighbours.flatten()
        scores = scores * cloud.influence.index_select(0, rows).view(rays_count, k)
        if config.cutoff is not None:
            scores = scores.masked_fill(squared > config.cutoff**2, -math.inf)
        background, weights = _background_softmax(scores, config.background_score)
        hidden = self.value.hidden(table[:, vector:]).unflatten(0, (rays_count, k))
        positions = cloud.positions.index_select(0, rows).view(rays_count, k, 3)
        # The last linear layer commutes with the weighted sum: once per ray, not once per pair.
        last = cast("nn.Linear", self.value.layers[-1])
        pooled = torch.bmm(weights.unsqueeze(1), hidden).squeeze(1)
        features = F.linear(pooled, last.weight) + weights.sum(dim=-1, keepdim=True) * last.bias
        # Sums, not matrix products: those would run in half precision under autocast.
        surface = (weights.unsqueeze(-1) * positions).sum(dim=1)
        along = (positions.detach() * rays.directions.unsqueeze(1)).sum(dim=-1)
        answering = ~torch.isneginf(scores.detach())
        first = along.masked_fill(~answering, math.inf).amin(dim=-1, keepdim=True)
        past_first = torch.where(answering, along - first, 0.0)
        return Attended(
            features=features,
            background=background,
            weights=weights,
            surface=surface,
            behind=(weights * past_first.square()).sum(dim=-1),
        )

    def _scores(self, key_input: Tensor, directions: Tensor, k: int) -> Tensor:
        """relu(<W_q q, W_k k> / sqrt(width)), (R, k); W_k is folded into the query."""
        query = self.query(encode(directions, self.config.frequencies))
        query = self.w_query(query) / math.sqrt(self.config.key.size)
        folded = query @ self.w_key.weight
        constant = query @ self.w_key.bias
        keys = self.key(key_input).unflatten(0, (len(directions), k))
        return F.relu(torch.bmm(keys, folded.unsqueeze(-1)).squeeze(-1) + constant[:, None])


def _of_query(directions: Tensor) -> Tensor:
    """Direction (R, 3) of a ray as the query sees it, from directions (R, 3) or (R, k, 3)."""
    if directions.ndim == 2:
        return directions
    # The neighbours see the ray from almost the same side; the mean is as good as a query per pair.
    return F.normalize(directions.mean(dim=1), dim=-1)


def _background_softmax(scores: Tensor, background_score: float) -> tuple[Tensor, Tensor]:
    """Softmax over k points and the background; then the points' weights renormalised.

    The renormalised weights a_i / sum a are the softmax of the points alone. Computed so, they
    neither underflow nor divide by a vanishing sum when the background outweighs every point.
    """
    constant = scores.new_full((scores.shape[0], 1), background_score)
    attention = torch.softmax(torch.cat([scores, constant], dim=-1), dim=-1)
    none = torch.isneginf(scores).all(dim=-1, keepdim=True)
    weights = torch.softmax(scores.masked_fill(none, 0.0), dim=-1).masked_fill(none, 0.0)
    return attention[:, -1], weights
