"""Proximity attention on a GPU by Triton: the activations of the networks never leave the chip.

A program takes a block of ray-point pairs through all layers of a network. Layers go in twos: a
few columns of the first one's output are made, activated and multiplied at once by the rows of the
second one's weights that they meet, so only one activation has to be held whole. The last layer's
columns are used up as they come: compared with the query, or summed over a ray by its weights.
Where a gradient is wanted the specification computes some rays again, and cuBLAS does the work.

float32 stays float32 (no TF32); under autocast the products are in its type, sums in float32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.kernels import reference_attention
from pcore.kernels.networks import Layers
from pcore.kernels.triton_networks import pack
from pcore.kernels.triton_pairs import launch_features, launch_scores

_RECOMPUTED_BYTES = 2**30
"""Activations that a backward pass holds at a time."""


def attention_scores(
    waves: Tensor,
    own: Tensor,
    neighbours: Tensor,
    answering: Tensor,
    queries: Tensor,
    key: Layers,
) -> Tensor:
    """<query, standardise(key)> of every pair, (R, k); see `reference_attention`."""
    return _Scores.apply(
        waves, queries, own, neighbours, answering, key, _half(waves), *key.weights, *key.biases
    )


def attention_features(
    waves: Tensor, features: Tensor, neighbours: Tensor, weights: Tensor, value: Layers
) -> Tensor:
    """Weighted hidden values (R, width); see `reference_attention`."""
    return _Features.apply(
        waves, weights, features, neighbours, value, _half(waves), *value.weights, *value.biases
    )


def _half(tensor: Tensor) -> torch.dtype | None:
    """Type of the products under autocast, None without it."""
    kind = tensor.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else None


class _Scores(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        waves: Tensor,
        queries: Tensor,
        own: Tensor,
        neighbours: Tensor,
        answering: Tensor,
        key: Layers,
        half: torch.dtype | None,
        *parameters: Tensor,
    ) -> Tensor:
        ctx.save_for_backward(waves, queries, own, neighbours, answering, *parameters)
        ctx.like, ctx.half = key, half
        # Without its mean over the columns the last layer's output is standardised by its length.
        last = [one - one.mean(dim=0) for one in (parameters[len(key.weights) - 1], parameters[-1])]
        inner = len(key.weights) - 1
        layers = key.with_parameters(
            [*parameters[:inner], last[0], *parameters[inner + 1 : -1], last[1]]
        )
        packed = pack(layers, own.shape[1], waves.shape[1], half or torch.float32)
        return launch_scores(packed, own, waves, neighbours, answering, queries)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        waves, queries, own, neighbours, answering, *parameters = ctx.saved_tensors

        def again(rays: slice, waves: Tensor, queries: Tensor, *parameters: Tensor) -> Tensor:
            return reference_attention.attention_scores(
                waves.flatten(0, 1),
                own,
                neighbours[rays],
                answering[rays],
                queries,
                ctx.like.with_parameters(parameters),
            )

        pairs = waves.unflatten(0, neighbours.shape)
        to_rays, to_parameters = _gradients(ctx, again, (pairs, queries), parameters, gradients[0])
        to_waves, to_queries = to_rays
        return to_waves.flatten(0, 1), to_queries, None, None, None, None, None, *to_parameters


class _Features(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        waves: Tensor,
        weights: Tensor,
        features: Tensor,
        neighbours: Tensor,
        value: Layers,
        half: torch.dtype | None,
        *parameters: Tensor,
    ) -> Tensor:
        ctx.save_for_backward(waves, weights, features, neighbours, *parameters)
        ctx.like, ctx.half = value, half
        hidden = all_but_last(value.with_parameters(parameters))
        sizes = waves.shape[1], features.shape[1]
        packed = pack(hidden, *sizes, half or torch.float32, neighbours.shape[1])
        pooled = launch_features(packed, waves, features, neighbours, weights)
        if value.skip_after == len(hidden.weights):  # The last layer takes the input, too.
            pairs = [waves, features.index_select(0, neighbours.flatten())]
            sums = [weights.unsqueeze(1) @ one.unflatten(0, neighbours.shape) for one in pairs]
            pooled = torch.cat([pooled, *(one.squeeze(1) for one in sums)], dim=1)
        return pooled

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        waves, weights, features, neighbours, *parameters = ctx.saved_tensors

        def again(
            rays: slice, waves: Tensor, weights: Tensor, features: Tensor, *parameters: Tensor
        ) -> Tensor:
            return reference_attention.attention_features(
                waves.flatten(0, 1),
                features,
                neighbours[rays],
                weights,
                ctx.like.with_parameters(parameters),
            )

        pairs = waves.unflatten(0, neighbours.shape)
        shared = (features, *parameters)
        to_rays, to_shared = _gradients(ctx, again, (pairs, weights), shared, gradients[0])
        to_waves, to_weights = to_rays
        to_features, *to_parameters = to_shared
        to_waves = to_waves.flatten(0, 1)
        return to_waves, to_weights, to_features, None, None, None, *to_parameters


def all_but_last(network: Layers) -> Layers:
    """Return a network without its last layer."""
    return replace(network, weights=network.weights[:-1], biases=network.biases[:-1])


def _gradients(
    ctx: Any,
    again: Callable[..., Tensor],
    of_rays: Sequence[Tensor],
    shared: Sequence[Tensor],
    upstream: Tensor,
) -> tuple[list[Tensor], list[Tensor]]:
    """Gradients of what belongs to rays and of what they share, some rays at a time."""
    leaves = [one.detach().requires_grad_() for one in shared]
    to_rays = [torch.zeros_like(one) for one in of_rays]
    to_shared = [torch.zeros_like(one) for one in shared]
    size = _rays_at_a_time(ctx.like, of_rays[0].shape[1])
    for first in range(0, len(upstream), size):
        rays = slice(first, first + size)
        parts = [one[rays].detach().requires_grad_() for one in of_rays]
        with torch.enable_grad(), _as_forward(upstream.device.type, ctx.half):
            out = again(rays, *parts, *leaves)
        found = torch.autograd.grad(
            out,
            [*parts, *leaves],
            upstream[rays].to(out.dtype),
            allow_unused=True,  # Of the values the last layer is applied elsewhere.
            materialize_grads=True,
        )
        for total, part in zip(to_rays, found[: len(parts)], strict=True):
            total[rays] = part
        for total, part in zip(to_shared, found[len(parts) :], strict=True):
            total += part
    return to_rays, to_shared


def _rays_at_a_time(network: Layers, neighbours: int) -> int:
    # Of every layer its output, its activation and a gradient.
    per_pair = 3 * 4 * sum(weight.shape[1] for weight in network.weights)
    return max(1, _RECOMPUTED_BYTES // (per_pair * neighbours))


def _as_forward(kind: str, half: torch.dtype | None) -> torch.autocast:
    return torch.autocast(kind, dtype=half, enabled=half is not None)
