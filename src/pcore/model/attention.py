"""Proximity attention: what the k points nearest to a ray contribute to it."""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcore.gaussians.spherical_harmonics import basis
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.functional import AttentionRules, proximity_attention
from pcore.kernels.networks import Layers
from pcore.kernels.reference import encode
from pcore.model.encoding import Normalisation, encoded_size
from pcore.model.hits import Hits
from pcore.model.papr_config import COLOR_CHANNELS, MlpConfig, PaprConfig


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

    def stack(self) -> Layers:
        """Return the layers as the kernels take them."""
        layers = [cast("nn.Linear", layer) for layer in self.layers]
        return Layers(
            weights=tuple(layer.weight for layer in layers),
            biases=tuple(layer.bias for layer in layers),
            negative_slope=self.negative_slope,
            skip_after=self.skip_after,
        )

    def forward(self, x: Tensor) -> Tensor:
        """Embed (..., size_in)."""
        return self.stack()(x)


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
        octaves, slope = config.octaves, config.negative_slope
        point, along, across, direction = (
            encoded_size(3, number)
            for number in (octaves.point, octaves.along, octaves.across, octaves.direction)
        )
        self.key = NormalisedMlp(point + along + across, config.key, slope)
        self.query = NormalisedMlp(direction, config.query, slope)
        self.value = Mlp(along + across + config.feature_size, config.value, slope)
        self.w_key = nn.Linear(config.key.size, config.key.size)
        self.w_query = nn.Linear(config.query.size, config.query.size)

    def forward(
        self,
        posed: PosedCloud,
        rays: RayBundle,
        neighbours: Tensor,
        seen: RayBundle,
        threshold: float = 0.0,
        *,
        stop_encoding: bool = False,
    ) -> Hits:
        """Attend from R rays to their neighbours.

        Args:
            posed: the points.
            rays: (R,) rays, world units.
            neighbours: (R, k) indices into the points.
            seen: the rays as the networks see them: (R,), or (R, k) as each neighbour sees them
                in the rest state of the points.
            threshold: values with less than this weight are left out; 0 is exact.
            stop_encoding: no gradient flows through the encoded positions of the keys, as in the
                original's training.
        """
        queries, constants = self._queries(_of_query(seen.directions))
        inside, frame = self.key.innorm, self.config.frame
        places, origins = posed.seen_positions, seen.origins
        if frame is not None:
            places, origins = frame.from_world(places), frame.from_world(origins)
        features, background, weights, answering = proximity_attention(
            places,
            posed.cloud.features,
            posed.cloud.influence,
            origins,
            seen.directions,
            neighbours,
            queries=queries,
            constants=constants,
            key=self.key.mlp.stack().after(inside.gain * inside.unbias, inside.offset),
            value=self.value.stack(),
            rules=self._rules(threshold, stop_encoding=stop_encoding),
        )
        if self.config.point_colors:
            waves = basis(self.config.color_degree, seen.directions)
            colors = posed.cloud.features[:, : self.config.color_features]
            features = _with_colors(features, colors, weights, neighbours, waves)
        positions, past_first = _along(posed.positions, rays, neighbours, answering)
        return Hits(
            neighbours=neighbours,
            weights=weights,
            background=background,
            features=features,
            # Sums, not matrix products: those would run in half precision under autocast.
            centroid=(weights.unsqueeze(-1) * positions).sum(dim=1),
            spread=(weights * past_first.square()).sum(dim=-1),
        )

    def _rules(self, threshold: float, *, stop_encoding: bool) -> AttentionRules:
        octaves, cutoff = self.config.octaves, self.config.cutoff
        return AttentionRules(
            scale=self.config.coord_scale,
            frequencies=(octaves.point, octaves.along, octaves.across),
            background_score=self.config.background_score,
            cutoff=None if cutoff is None else cutoff / self.config.unit,
            threshold=threshold,
            stop_encoding=stop_encoding,
        )

    def _queries(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """What standardised keys are compared with, (R, D), and what is added then, (R,).

        <W_q q, W_k k> / sqrt(D) with k = gain x + offset: W_k, the gain and the offset of the key
        are folded into the query, once per ray instead of once per pair.
        """
        outside = self.key.outnorm
        query = self.query(encode(directions, self.config.octaves.direction))
        query = self.w_query(query) / math.sqrt(self.config.key.size)
        folded = query @ self.w_key.weight
        constants = query @ self.w_key.bias + folded @ outside.offset
        return folded * (outside.gain * outside.unbias), constants


def _along(
    points: Tensor, rays: RayBundle, neighbours: Tensor, answering: Tensor
) -> tuple[Tensor, Tensor]:
    """Positions (R, k, 3) of neighbours, and how far (R, k) past the first that answers."""
    positions = points.index_select(0, neighbours.flatten()).unflatten(0, neighbours.shape)
    along = (positions.detach() * rays.directions.detach().unsqueeze(1)).sum(dim=-1)
    first = along.masked_fill(~answering, math.inf).amin(dim=-1, keepdim=True)
    past_first = torch.where(answering, along - first, 0.0)
    return positions, past_first


def _with_colors(
    features: Tensor, colors: Tensor, weights: Tensor, neighbours: Tensor, waves: Tensor
) -> Tensor:
    """Features (R, C) whose first channels are the colours of points.

    Args:
        features: (R, C).
        colors: (N, K 3) coefficients of every point; those of the first harmonic are a colour.
        weights: (R, k).
        neighbours: (R, k).
        waves: K harmonics in the directions from which points are seen, (R, K) or (R, k, K).
    """
    waves = waves.unsqueeze(1) if waves.ndim == 2 else waves
    factors = weights.unsqueeze(-1) * torch.cat(
        [torch.ones_like(waves[..., :1]), waves[..., 1:]], -1
    )
    many = neighbours.shape[1] * (colors.shape[1] // COLOR_CHANNELS)
    rows = colors.index_select(0, neighbours.flatten()).view(len(weights), many, COLOR_CHANNELS)
    blend = (factors.flatten(1).unsqueeze(-1) * rows).sum(dim=1)
    return torch.cat([blend.to(features), features[:, COLOR_CHANNELS:]], dim=1)


def _of_query(directions: Tensor) -> Tensor:
    """Direction (R, 3) of a ray as the query sees it, from directions (R, 3) or (R, k, 3)."""
    if directions.ndim == 2:
        return directions
    # The neighbours see the ray from almost the same side; the mean is as good as a query per pair.
    return F.normalize(directions.mean(dim=1), dim=-1)
