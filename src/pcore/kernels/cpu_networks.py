"""Embedding networks on the CPU, for chunks of ray-point pairs that stay in the cache."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pcore.kernels import cpu_attention_loops as loops
from pcore.kernels.networks import Layers

_CHUNK_BYTES = 2**20
"""Size of one activation of a chunk and thread: a few of them share a core's cache."""
_KEPT_BYTES = 2**30
"""Activations that a forward pass keeps for its backward pass; more are computed again."""


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Some pairs of consecutive rays.

    Attributes:
        rays: the rays.
        ids: (P,) pairs as indices into (R k), in order.
        starts: (rays + 1,) where the pairs of each ray begin.
    """

    rays: slice
    ids: np.ndarray
    starts: np.ndarray

    def narrowed(self, kept: np.ndarray) -> Chunk:
        """Return the chunk with those of its pairs that a mask (P,) keeps."""
        before = np.concatenate([[0], np.cumsum(kept)])
        return Chunk(rays=self.rays, ids=self.ids[kept], starts=before[self.starts])


def chunks_of(wanted: Tensor, width: int) -> Iterator[Chunk]:
    """Cut the pairs that a mask (R, k) wants into chunks that suit networks of a width."""
    size = max(1, _CHUNK_BYTES * torch.get_num_threads() // (4 * width))
    mask = wanted.numpy()
    ids = np.flatnonzero(mask)
    starts = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    first = 0
    while first < len(mask):
        last = max(first + 1, int(np.searchsorted(starts, starts[first] + size, "right")) - 1)
        pairs = slice(starts[first], starts[last])
        yield Chunk(
            rays=slice(first, last),
            ids=ids[pairs],
            starts=starts[first : last + 1] - starts[first],
        )
        first = last


@dataclass(frozen=True, kw_only=True)
class Network:
    """Layers with the work on a chunk: `linear` says that the last one has no activation."""

    layers: Layers
    linear: bool

    def _slope(self, index: int) -> np.float32:
        linear = self.linear and index == len(self.layers.weights) - 1
        return np.float32(1.0 if linear else self.layers.negative_slope)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Outputs of all layers for rows x; and the last one's with its skip, if it has one."""
        outputs: list[Tensor] = []
        out = x
        for index, (weight, bias) in enumerate(
            zip(self.layers.weights, self.layers.biases, strict=True)
        ):
            before = out.shape[1]
            out = out @ weight[:, :before].T
            if index > 0 and index == self.layers.skip_after:
                out.addmm_(x, weight[:, before:].T)
            loops.activate(out.numpy(), bias.detach().numpy(), self._slope(index))
            outputs.append(out)
        if len(outputs) == self.layers.skip_after:
            outputs.append(torch.cat([out, x], dim=1))
        return outputs

    def backward(
        self, gradient: Tensor, x: Tensor, outputs: Sequence[Tensor], to_layers: Layers
    ) -> Tensor:
        """Gradient of the rows x; those of weights and biases are added to `to_layers`."""
        to_x = torch.zeros_like(x)
        if len(outputs) > len(self.layers.weights):
            gradient, skipped = gradient.split([gradient.shape[1] - x.shape[1], x.shape[1]], dim=1)
            gradient, to_x = gradient.contiguous(), skipped.contiguous()
        for index in reversed(range(len(self.layers.weights))):
            weight, to_weight = self.layers.weights[index], to_layers.weights[index]
            below = outputs[index - 1] if index else x
            to_bias = to_layers.biases[index].numpy()
            loops.activate_backward(
                gradient.numpy(), outputs[index].numpy(), self._slope(index), to_bias
            )
            before = below.shape[1]
            to_weight[:, :before].addmm_(gradient.T, below)
            if index > 0 and index == self.layers.skip_after:
                to_weight[:, before:].addmm_(gradient.T, x)
                to_x.addmm_(gradient, weight[:, before:])
            gradient = gradient @ weight[:, :before]
        return to_x.add_(gradient)


class Kept:
    """Activations of the chunks of a forward pass, as far as they fit."""

    def __init__(self, *, keep: bool) -> None:
        self._left = _KEPT_BYTES if keep else 0
        self.chunks: list[Chunk] = []
        self.tensors: list[Tensor] = []
        self.each = 0

    def add(self, chunk: Chunk, activations: Sequence[Tensor]) -> None:
        """Take a chunk, and its activations while there is room."""
        self.chunks.append(chunk)
        self.each = len(activations)
        self._left -= sum(4 * one.numel() for one in activations)
        if self._left >= 0:
            self.tensors += activations


def recall(
    chunks: Sequence[Chunk], tensors: Sequence[Tensor], each: int
) -> Iterator[tuple[Chunk, Sequence[Tensor] | None]]:
    """Chunks with their activations, `each` for one chunk; None where they did not fit."""
    for index, chunk in enumerate(chunks):
        found = tensors[index * each : (index + 1) * each]
        yield chunk, found or None


def widest(network: Layers) -> int:
    """Width of the widest layer."""
    return max(len(bias) for bias in network.biases)
