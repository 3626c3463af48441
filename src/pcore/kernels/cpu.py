"""Ray-point pairs on the CPU by numba: one pass per pair."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.numba_bridge import as_float32
from pcore.kernels.reference import LENGTH_GUARD, per_pair, scaling


def encode_pairs(
    positions: Tensor,
    origins: Tensor,
    directions: Tensor,
    neighbours: Tensor,
    *,
    scale: float,
    frequencies: tuple[int, int],
) -> tuple[Tensor, Tensor]:
    """Encode what every ray-point pair is like; see `functional.encode_pairs`."""
    waves, squared = _EncodePairs.apply(
        positions, origins, directions, neighbours, scale, frequencies
    )
    return waves, squared


class _EncodePairs(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        positions: Tensor,
        origins: Tensor,
        directions: Tensor,
        neighbours: Tensor,
        scale: float,
        frequencies: tuple[int, int],
    ) -> tuple[Tensor, Tensor]:
        use_torch_threads()
        rays, k = neighbours.shape
        waves = torch.empty(rays * k, 6 * (1 + sum(frequencies)))
        squared = torch.empty(rays, k)
        directions = per_pair(directions).contiguous()
        neighbours = neighbours.contiguous()
        _encode_forward(
            as_float32(positions),
            as_float32(per_pair(origins)),
            directions.numpy(),
            neighbours.numpy(),
            *_scales(scale, frequencies),
            *frequencies,
            waves.numpy(),
            squared.numpy(),
        )
        ctx.save_for_backward(directions, neighbours, waves)
        ctx.scale, ctx.frequencies, ctx.points = scale, frequencies, positions.shape[0]
        ctx.mark_non_differentiable(squared)
        return waves, squared

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        directions, neighbours, waves = ctx.saved_tensors
        to_position = torch.empty(waves.shape[0], 3)
        _encode_backward(
            gradients[0].contiguous().numpy(),
            waves.numpy(),
            directions.numpy(),
            neighbours.shape[1],
            *_scales(ctx.scale, ctx.frequencies),
            ctx.frequencies[0],
            ctx.frequencies[1],
            to_position.numpy(),
        )
        positions = torch.zeros(ctx.points, 3).index_add_(0, neighbours.flatten(), to_position)
        return positions, None, None, None, None, None


def _scales(scale: float, frequencies: tuple[int, int]) -> tuple[np.float32, np.float32]:
    along, across = (np.float32(scaling(scale, number)) for number in frequencies)
    return along, across


@numba.njit(cache=True)
def _guarded_length(direction: np.ndarray) -> Any:
    """Squared length, guarded as in the original."""
    total = np.float32(LENGTH_GUARD)
    for axis in range(3):
        total += direction[axis] * direction[axis]
    return total


@numba.njit(cache=True)
def _encode_scalar(x: float, frequencies: int, row: np.ndarray, column: int) -> None:
    """Write [x, sin x, cos x, sin 2x, ...]; octaves by double angles in float64."""
    row[column] = x
    sine, cosine = math.sin(np.float64(x)), math.cos(np.float64(x))
    for octave in range(frequencies):
        row[column + 1 + 2 * octave] = sine
        row[column + 2 + 2 * octave] = cosine
        sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine


@numba.njit(cache=True, parallel=True)
def _encode_forward(
    positions: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    neighbours: np.ndarray,
    scale_along: np.float32,
    scale_across: np.float32,
    octaves_along: int,
    octaves_across: int,
    waves: np.ndarray,
    squared: np.ndarray,
) -> None:
    rays, k = neighbours.shape
    of_h, of_t = 1 + 2 * octaves_along, 1 + 2 * octaves_across
    shared = directions.shape[1] == 1
    for ray in prange(rays):
        for slot in range(k):
            seen = 0 if shared else slot
            origin, direction = origins[ray, seen], directions[ray, seen]
            length = _guarded_length(direction)
            point = neighbours[ray, slot]
            row = waves[ray * k + slot]
            along = np.float32(0.0)
            for axis in range(3):
                along += (positions[point, axis] - origin[axis]) * direction[axis]
            along /= length
            total = np.float32(0.0)
            for axis in range(3):
                h = along * direction[axis]
                t = positions[point, axis] - origin[axis] - h
                total += t * t
                _encode_scalar(scale_along * h, octaves_along, row, axis * of_h)
                _encode_scalar(scale_across * t, octaves_across, row, 3 * of_h + axis * of_t)
            squared[ray, slot] = total


@numba.njit(cache=True)
def _decode_gradient(upstream: np.ndarray, row: np.ndarray, column: int, frequencies: int) -> float:
    """Gradient of an encoded scalar: the encoding holds its own sines and cosines."""
    total = upstream[column]
    factor = np.float32(1.0)
    for octave in range(frequencies):
        sine, cosine = column + 1 + 2 * octave, column + 2 + 2 * octave
        total += factor * (upstream[sine] * row[cosine] - upstream[cosine] * row[sine])
        factor *= np.float32(2.0)
    return total


@numba.njit(cache=True, parallel=True)
def _encode_backward(
    upstream: np.ndarray,
    waves: np.ndarray,
    directions: np.ndarray,
    k: int,
    scale_along: np.float32,
    scale_across: np.float32,
    octaves_along: int,
    octaves_across: int,
    to_position: np.ndarray,
) -> None:
    of_h, of_t = 1 + 2 * octaves_along, 1 + 2 * octaves_across
    shared = directions.shape[1] == 1
    for pair in prange(waves.shape[0]):
        direction = directions[pair // k, 0 if shared else pair % k]
        row, gradient = waves[pair], upstream[pair]
        # With d d^T divided by the guarded length: h = d d^T (p - o) and t = (I - d d^T)(p - o), so
        # dL/dp = dL/dt + d <d, dL/dh - dL/dt>.
        difference = np.float32(0.0)
        for axis in range(3):
            to_h = scale_along * _decode_gradient(gradient, row, axis * of_h, octaves_along)
            at_t = 3 * of_h + axis * of_t
            to_t = scale_across * _decode_gradient(gradient, row, at_t, octaves_across)
            to_position[pair, axis] = to_t
            difference += direction[axis] * (to_h - to_t)
        difference /= _guarded_length(direction)
        for axis in range(3):
            to_position[pair, axis] += direction[axis] * difference
