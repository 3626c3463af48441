"""The two kernels of proximity attention: scores of pairs, weighted sums of values over rays."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from pcore.kernels.networks import EPSILON
from pcore.kernels.triton_networks import (
    SMALLEST,
    Packed,
    Shape,
    activated,
    all_but_last,
    columns_of_layer,
    launch_options,
    standardised,
)


@triton.jit
def pair_scores(
    own,
    waves,
    points,
    answering,
    queries,
    weights,
    biases,
    out,
    pairs,
    neighbours,
    SHAPE: tl.constexpr,
    EPSILON: tl.constexpr,
):
    """Write <query, standardised key> of each of `pairs` pairs whose program has an answer."""
    pair = tl.program_id(0).to(tl.int64) * SHAPE.pairs + tl.arange(0, SHAPE.pairs)
    real = pair < pairs
    pair = tl.where(real, pair, 0)
    score = tl.zeros((SHAPE.pairs,), tl.float32)
    if tl.max(tl.load(answering + pair, mask=real, other=0).to(tl.int32)) > 0:
        point = tl.load(points + pair)
        mean = tl.zeros((SHAPE.pairs,), tl.float32)
        rows = standardised((own, point, waves, pair, mean, mean + 1.0), SHAPE, EPSILON)
        hidden = all_but_last(rows, weights, biases, SHAPE)
        squared = tl.zeros((SHAPE.pairs,), tl.float32)
        ray = pair // neighbours
        for start in range(0, SHAPE.width, SHAPE.part):
            columns = start + tl.arange(0, SHAPE.part)
            key = columns_of_layer(rows, hidden, weights, biases, columns, SHAPE.layers - 1, SHAPE)
            query = tl.load(
                queries + ray[:, None] * SHAPE.size + columns[None, :],
                mask=(columns < SHAPE.size)[None, :],
                other=0.0,
            )
            score += tl.sum(query * key, axis=1)
            squared += tl.sum(key * key, axis=1)
        score = score / tl.sqrt(squared / SHAPE.size + EPSILON)
    tl.store(out + pair, score, mask=real)


@triton.jit
def pooled_values(
    waves,
    features,
    points,
    shares,
    weights,
    biases,
    out,
    rays,
    neighbours,
    SHAPE: tl.constexpr,
    RAYS: tl.constexpr,
):
    """Write the weighted sums (rays, size) of the values; a program takes whole rays."""
    each = SHAPE.pairs // neighbours
    first = tl.program_id(0).to(tl.int64) * each
    slot = tl.arange(0, SHAPE.pairs)
    pair = first * neighbours + slot
    real = (slot < each * neighbours) & (first + slot // neighbours < rays)
    pair = tl.where(real, pair, 0)
    share = tl.load(shares + pair, mask=real, other=0.0)
    if tl.max(tl.abs(share)) > 0:
        point = tl.load(points + pair)
        mean = tl.zeros((SHAPE.pairs,), tl.float32)
        rows = (waves, pair, features, point, mean, mean + 1.0)
        hidden = all_but_last(rows, weights, biases, SHAPE)
        ray = tl.arange(0, RAYS)
        summed = tl.where(ray[:, None] == (slot // neighbours)[None, :], share[None, :], 0.0)
        summed = summed.to(weights.dtype.element_ty)
        there = (ray < each) & (first + ray < rays)
        for start in range(0, SHAPE.width, SHAPE.part):
            columns = start + tl.arange(0, SHAPE.part)
            value = columns_of_layer(
                rows, hidden, weights, biases, columns, SHAPE.layers - 1, SHAPE
            )
            value = activated(value, SHAPE).to(summed.dtype)
            tl.store(
                out + (first + ray)[:, None] * SHAPE.size + columns[None, :],
                tl.dot(summed, value, input_precision="ieee"),
                mask=there[:, None] & (columns < SHAPE.size)[None, :],
            )


def launch_scores(
    packed: Packed,
    own: Tensor,
    waves: Tensor,
    neighbours: Tensor,
    answering: Tensor,
    queries: Tensor,
) -> Tensor:
    """Scores (R, k); zero in programs without an answering pair."""
    out = torch.empty(neighbours.shape, dtype=torch.float32, device=waves.device)
    if out.numel() > 0:
        pair_scores[(triton.cdiv(out.numel(), packed.shape.pairs),)](
            own.contiguous(),
            waves.contiguous(),
            neighbours.contiguous(),
            answering.contiguous(),
            queries.float().contiguous(),
            packed.weights,
            packed.biases,
            out,
            out.numel(),
            neighbours.shape[1],
            packed.shape,
            EPSILON,
            **launch_options(packed.shape),
        )
    return out


def launch_features(
    packed: Packed, waves: Tensor, features: Tensor, neighbours: Tensor, weights: Tensor
) -> Tensor:
    """Weighted sums (R, size) of the last layer's activations."""
    rays, k = neighbours.shape
    out = torch.zeros(rays, packed.shape.size, dtype=torch.float32, device=waves.device)
    if out.numel() > 0 and k > 0:
        pooled_values[(triton.cdiv(rays, packed.shape.pairs // k),)](
            waves.contiguous(),
            features.contiguous(),
            neighbours.contiguous(),
            weights.float().contiguous(),
            packed.weights,
            packed.biases,
            out,
            rays,
            k,
            packed.shape,
            sum_rows(packed.shape, k),
            **launch_options(packed.shape),
        )
    return out


def sum_rows(shape: Shape, neighbours: int) -> int:
    """Rays of a program, padded to what `tl.dot` takes."""
    return max(SMALLEST, triton.next_power_of_2(shape.pairs // neighbours))
