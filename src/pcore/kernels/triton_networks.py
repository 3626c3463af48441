"""Embedding networks inside Triton kernels: what `triton_pairs` is made of.

All weights of a network lie in one matrix of WIDTH columns, padded with zeros: first those that
read the network's input, then, layer by layer, those that read the layer before. Padding needs no
masks: what it gives is zero and meets zero weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.nn import functional as F

from pcore.kernels.networks import Layers

SMALLEST = 16
"""Least side of what `tl.dot` multiplies; all sizes are powers of two."""


class Shape(NamedTuple):
    """Sizes that a kernel is compiled for.

    Attributes:
        pairs: ray-point pairs of a program.
        left: columns of the input that come from the first table; a row of it belongs to a point
            (keys) or a pair (values).
        right: columns from the second table, the other way round.
        rows: columns of the input, padded to a multiple of `part`.
        layers: linear layers.
        skip: the layer, from 0, that reads the input besides its predecessor; 0 for none.
        slope: negative slope of the activations.
        width: columns of the padded layers.
        size: columns of the last layer, not padded.
        part: columns made at a time.
    """

    pairs: int
    left: int
    right: int
    rows: int
    layers: int
    skip: int
    slope: float
    width: int
    size: int
    part: int


@dataclass(frozen=True, kw_only=True)
class Packed:
    """A network as the kernels take it.

    Attributes:
        weights: rows of WIDTH columns, in the type of the products.
        biases: (layers, WIDTH) float32.
        shape: sizes, and how many pairs a program takes.
    """

    weights: Tensor
    biases: Tensor
    shape: Shape


def pack(network: Layers, left: int, right: int, dtype: torch.dtype, neighbours: int = 1) -> Packed:
    """Lay out all layers of a network whose input is `left` and then `right` numbers.

    Args:
        network: all its layers count, the last one, too.
        left: columns of the first table.
        right: columns of the second.
        dtype: of the products: float32, bfloat16 or float16.
        neighbours: pairs that belong together, at most so many are in a program.
    """
    shape = shape_of(network, left, right, dtype, neighbours)
    inputs, layers = [], []
    for index, weight in enumerate(network.weights):
        before = 0 if index == 0 else len(network.biases[index - 1])
        if index in {0, shape.skip}:
            inputs.append(_padded(weight[:, before:], shape.rows, shape.width))
        if index > 0:
            layers.append(_padded(weight[:, :before], shape.width, shape.width))
    biases = [F.pad(bias, (0, shape.width - len(bias))) for bias in network.biases]
    return Packed(
        weights=torch.cat([*inputs, *layers]).to(dtype),
        biases=torch.stack(biases).float(),
        shape=shape,
    )


def shape_of(
    network: Layers, left: int, right: int, dtype: torch.dtype, neighbours: int = 1
) -> Shape:
    """Sizes of the kernel that serves a network; see `pack`."""
    width = max(SMALLEST, triton.next_power_of_2(max(len(bias) for bias in network.biases)))
    # float32 takes twice the room: half as many pairs at a time.
    part, pairs = (16, 32) if dtype == torch.float32 else (32, 64)
    part = min(part, width)
    skip = network.skip_after or 0
    return Shape(
        pairs=max(pairs, triton.next_power_of_2(neighbours)),
        left=left,
        right=right,
        rows=triton.cdiv(left + right, part) * part,
        layers=len(network.weights),
        skip=skip if skip < len(network.weights) else 0,
        slope=network.negative_slope,
        width=width,
        size=len(network.biases[-1]),
        part=part,
    )


def launch_options(shape: Shape) -> dict[str, int | bool]:
    """Options of the compiler; at 256 columns the activations fill the registers of eight warps.

    Two stages of loads ahead keep shared memory below the 99 KB that GPUs for games have, too.
    """
    return {"num_warps": max(4, shape.width // 32), "num_stages": 2, "enable_fp_fusion": True}


def _padded(weight: Tensor, rows: int, width: int) -> Tensor:
    """(in, out), padded."""
    return F.pad(weight.T, (0, width - len(weight), 0, rows - weight.shape[1]))


@triton.jit
def input_columns(rows, at, SHAPE: tl.constexpr):
    """Columns `at` of the input (pairs, columns), zero beyond its last."""
    left, left_row, right, right_row, mean, scale = rows
    first = (at < SHAPE.left)[None, :]
    second = ((at >= SHAPE.left) & (at < SHAPE.left + SHAPE.right))[None, :]
    x = tl.load(left + left_row[:, None] * SHAPE.left + at[None, :], mask=first, other=0.0)
    column = (at - SHAPE.left)[None, :]
    x += tl.load(right + right_row[:, None] * SHAPE.right + column, mask=second, other=0.0)
    return tl.where(first | second, (x - mean[:, None]) * scale[:, None], 0.0)


@triton.jit
def standardised(rows, SHAPE: tl.constexpr, EPSILON: tl.constexpr):
    """The same rows with mean and 1 / std of their columns, in two passes as layer norm does."""
    left, left_row, right, right_row, mean, scale = rows
    total = tl.zeros_like(mean)
    for start in range(0, SHAPE.rows, SHAPE.part):
        total += tl.sum(input_columns(rows, start + tl.arange(0, SHAPE.part), SHAPE), axis=1)
    mean = total / (SHAPE.left + SHAPE.right)
    total = tl.zeros_like(mean)
    for start in range(0, SHAPE.rows, SHAPE.part):
        x = input_columns(
            (left, left_row, right, right_row, mean, scale),
            start + tl.arange(0, SHAPE.part),
            SHAPE,
        )
        total += tl.sum(x * x, axis=1)
    scale = 1.0 / tl.sqrt(total / (SHAPE.left + SHAPE.right) + EPSILON)
    return left, left_row, right, right_row, mean, scale


@triton.jit
def activated(x, SHAPE: tl.constexpr):
    """(Leaky) ReLU."""
    return tl.where(x > 0, x, SHAPE.slope * x)


@triton.jit
def _add_input(out, rows, weights, columns, layer: tl.constexpr, SHAPE: tl.constexpr):
    """Add what a layer makes of the input, for some of its columns."""
    # The skip's weights lie behind those of the first layer.
    weights += (SHAPE.rows * SHAPE.width) * (layer > 0)
    for start in range(0, SHAPE.rows, SHAPE.part):
        at = start + tl.arange(0, SHAPE.part)
        weight = tl.load(weights + at[:, None] * SHAPE.width + columns[None, :])
        x = input_columns(rows, at, SHAPE).to(weight.dtype)
        out = tl.dot(x, weight, out, input_precision="ieee")
    return out


@triton.jit
def _of_layer(weights, layer: tl.constexpr, SHAPE: tl.constexpr):
    """Where the weights begin that a layer applies to the one before."""
    inputs: tl.constexpr = 1 + (SHAPE.skip > 0)
    return weights + (inputs * SHAPE.rows + (layer - 1) * SHAPE.width) * SHAPE.width


@triton.jit
def columns_of_layer(
    rows, hidden, weights, biases, columns, layer: tl.constexpr, SHAPE: tl.constexpr
):
    """Some columns of a layer's output before its activation, (pairs, columns) float32."""
    bias = tl.load(biases + layer * SHAPE.width + columns)[None, :]
    out = tl.zeros((SHAPE.pairs, columns.shape[0]), tl.float32) + bias
    if layer > 0:
        above = tl.arange(0, SHAPE.width)
        weight = tl.load(
            _of_layer(weights, layer, SHAPE) + above[:, None] * SHAPE.width + columns[None, :]
        )
        out = tl.dot(hidden, weight, out, input_precision="ieee")
    if layer == 0 or layer == SHAPE.skip:
        out = _add_input(out, rows, weights, columns, layer, SHAPE)
    return out


@triton.jit
def _two_layers(rows, hidden, weights, biases, layer: tl.constexpr, SHAPE: tl.constexpr):
    """The activated output (pairs, width) of the layer behind `layer`."""
    every = tl.arange(0, SHAPE.width)
    out = tl.zeros((SHAPE.pairs, SHAPE.width), tl.float32)
    out += tl.load(biases + (layer + 1) * SHAPE.width + every)[None, :]
    if layer + 1 == SHAPE.skip:
        out = _add_input(out, rows, weights, every, layer + 1, SHAPE)
    behind = _of_layer(weights, layer + 1, SHAPE)
    for start in range(0, SHAPE.width, SHAPE.part):
        columns = start + tl.arange(0, SHAPE.part)
        middle = columns_of_layer(rows, hidden, weights, biases, columns, layer, SHAPE)
        weight = tl.load(behind + columns[:, None] * SHAPE.width + every[None, :])
        middle = activated(middle, SHAPE).to(weight.dtype)
        out = tl.dot(middle, weight, out, input_precision="ieee")
    return activated(out, SHAPE).to(weights.dtype.element_ty)


@triton.jit
def all_but_last(rows, weights, biases, SHAPE: tl.constexpr):
    """The activation (pairs, width) that the last layer takes; zeros where it takes the input."""
    hidden = tl.zeros((SHAPE.pairs, SHAPE.width), weights.dtype.element_ty)
    odd: tl.constexpr = (SHAPE.layers - 1) % 2
    if odd == 1:
        every = tl.arange(0, SHAPE.width)
        first = columns_of_layer(rows, hidden, weights, biases, every, 0, SHAPE)
        hidden = activated(first, SHAPE).to(weights.dtype.element_ty)
    for two in tl.static_range((SHAPE.layers - 1) // 2):
        hidden = _two_layers(rows, hidden, weights, biases, odd + 2 * two, SHAPE)
    return hidden
