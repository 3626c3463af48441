"""Proximity attention on the CPU: chunks of rays that stay in the cache, and a backward by hand.

Only pairs that matter are computed: those that can answer, and on the way back those whose score
has a gradient. Both results are exact. Matrix products are torch's, the rest is
`cpu_attention_loops`. What the backward needs is kept up to a fixed amount of memory; the chunks
beyond compute it again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels import cpu_attention_loops as loops
from pcore.kernels.cpu_networks import Chunk, Kept, Network, chunks_of, recall, widest
from pcore.kernels.networks import Layers


def attention_scores(
    waves: Tensor,
    own: Tensor,
    neighbours: Tensor,
    answering: Tensor,
    queries: Tensor,
    key: Layers,
) -> Tensor:
    """<query, standardise(key)> of the answering pairs, (R, k); see `reference_attention`."""
    keep = torch.is_grad_enabled()
    return _Scores.apply(
        waves, queries, own, neighbours, answering, key, keep, *key.weights, *key.biases
    )


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
        keep: bool,
        *parameters: Tensor,
    ) -> Tensor:
        use_torch_threads()
        network = Network(layers=key.with_parameters(parameters), linear=True)
        queries, points = queries.detach().contiguous(), neighbours.flatten()
        kept, scores = Kept(keep=keep), torch.zeros(neighbours.shape)
        for chunk in chunks_of(answering, widest(key)):
            activations = _key_activations(network, waves, own, points, chunk)
            loops.scores(
                activations[-1].numpy(),
                queries[chunk.rays].numpy(),
                chunk.starts,
                chunk.ids,
                scores.view(-1).numpy(),
            )
            kept.add(chunk, activations)
        ctx.save_for_backward(waves, queries, own, points, *parameters, *kept.tensors)
        ctx.key, ctx.chunks, ctx.each = key, kept.chunks, kept.each
        return scores

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        key: Layers = ctx.key
        waves, queries, own, points, *rest = ctx.saved_tensors
        parameters, tensors = rest[: 2 * len(key.weights)], rest[2 * len(key.weights) :]
        network = Network(layers=key.with_parameters(parameters), linear=True)
        upstream = gradients[0].flatten().numpy()
        to_waves, to_queries = torch.zeros_like(waves), torch.zeros_like(queries)
        to_parameters = [torch.zeros_like(one) for one in parameters]
        for whole, found in recall(ctx.chunks, tensors, ctx.each):
            # Half of the scores or more are cut by the ReLU: their keys have no gradient.
            mask = upstream[whole.ids] != 0
            chunk = whole.narrowed(mask)
            if found is None:
                found = _key_activations(network, waves, own, points, chunk)
            elif not mask.all():
                rows = torch.from_numpy(np.flatnonzero(mask))
                found = [one.index_select(0, rows) for one in found]
            scales, x, *outputs = found
            to_keys = torch.empty_like(outputs[-1])
            loops.scores_backward(
                upstream,
                outputs[-1].numpy(),
                queries[chunk.rays].numpy(),
                chunk.starts,
                chunk.ids,
                to_queries[chunk.rays].numpy(),
                to_keys.numpy(),
            )
            to_x = network.backward(to_keys, x, outputs, key.with_parameters(to_parameters))
            loops.key_rows_backward(
                to_x.numpy(), x.numpy(), scales.numpy(), chunk.ids, to_waves.numpy()
            )
        return to_waves, to_queries, None, None, None, None, None, *to_parameters


def _key_activations(
    network: Network, waves: Tensor, own: Tensor, points: Tensor, chunk: Chunk
) -> list[Tensor]:
    """1 / std of the input, the standardised input, and the outputs of all layers."""
    scales = torch.empty(len(chunk.ids))
    x = torch.empty(len(chunk.ids), own.shape[1] + waves.shape[1])
    loops.key_rows(
        own.numpy(), waves.detach().numpy(), points.numpy(), chunk.ids, x.numpy(), scales.numpy()
    )
    return [scales, x, *network.forward(x)]


def attention_features(
    waves: Tensor, features: Tensor, neighbours: Tensor, weights: Tensor, value: Layers
) -> Tensor:
    """Weighted hidden values (R, width) of the pairs that have a weight."""
    keep, hidden = torch.is_grad_enabled(), len(value.weights) - 1
    return _Features.apply(
        waves,
        features,
        weights,
        neighbours,
        value,
        keep,
        *value.weights[:hidden],
        *value.biases[:hidden],
    )


class _Features(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        waves: Tensor,
        features: Tensor,
        weights: Tensor,
        neighbours: Tensor,
        value: Layers,
        keep: bool,
        *parameters: Tensor,
    ) -> Tensor:
        use_torch_threads()
        network = Network(layers=value.with_parameters(parameters), linear=False)
        points, weights = neighbours.flatten(), weights.contiguous()
        kept, pooled = Kept(keep=keep), torch.zeros(len(neighbours), value.weights[-1].shape[1])
        for chunk in chunks_of(weights != 0, widest(value)):
            activations = _value_activations(network, waves, features, points, chunk)
            loops.pool(
                activations[-1].numpy(),
                weights.detach().view(-1).numpy(),
                chunk.starts,
                chunk.ids,
                pooled[chunk.rays].numpy(),
            )
            kept.add(chunk, activations)
        ctx.save_for_backward(waves, features, weights, points, *parameters, *kept.tensors)
        ctx.value, ctx.chunks, ctx.each = value, kept.chunks, kept.each
        return pooled

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        value: Layers = ctx.value
        waves, features, weights, points, *rest = ctx.saved_tensors
        split = 2 * (len(value.weights) - 1)
        parameters, tensors = rest[:split], rest[split:]
        network = Network(layers=value.with_parameters(parameters), linear=False)
        upstream = gradients[0].contiguous()
        to_waves, to_features = torch.zeros_like(waves), torch.zeros_like(features)
        to_weights = torch.zeros_like(weights)
        to_parameters = [torch.zeros_like(one) for one in parameters]
        for chunk, found in recall(ctx.chunks, tensors, ctx.each):
            if found is None:
                found = _value_activations(network, waves, features, points, chunk)
            x, *outputs = found
            to_hidden = torch.empty_like(outputs[-1])
            loops.pool_backward(
                upstream[chunk.rays].numpy(),
                outputs[-1].numpy(),
                weights.view(-1).numpy(),
                chunk.starts,
                chunk.ids,
                to_weights.view(-1).numpy(),
                to_hidden.numpy(),
            )
            to_x = network.backward(to_hidden, x, outputs, value.with_parameters(to_parameters))
            loops.value_rows_backward(
                to_x.numpy(), points.numpy(), chunk.ids, to_waves.numpy(), to_features.numpy()
            )
        return to_waves, to_features, to_weights, None, None, None, *to_parameters


def _value_activations(
    network: Network, waves: Tensor, features: Tensor, points: Tensor, chunk: Chunk
) -> list[Tensor]:
    """The input and the outputs of all layers."""
    x = torch.empty(len(chunk.ids), waves.shape[1] + features.shape[1])
    loops.value_rows(
        waves.detach().numpy(), features.detach().numpy(), points.numpy(), chunk.ids, x.numpy()
    )
    return [x, *network.forward(x)]
