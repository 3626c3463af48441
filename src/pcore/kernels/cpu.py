"""Ray-point pairs on the CPU by numba: one pass per pair."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from pcore.kernels.layers import LayerRules, PulledBack
from pcore.kernels.numba_bridge import as_float32, use_torch_threads
from pcore.kernels.reference import LENGTH_GUARD, SHORTEST, per_pair, scaling
from pcore.kernels.sorted_keys import PLACE, key_of, sift


def pull_back(
    origins: Tensor,
    directions: Tensor,
    positions: Tensor,
    rest: Tensor,
    to_rest: Tensor,
    candidates: Tensor,
    k: int,
    layers: LayerRules | None = None,
    hidden: bool = False,
) -> PulledBack:
    """Rays of the rest state as each candidate sees them; see `functional.pull_back`."""
    use_torch_threads()
    rays = len(origins)
    chosen = torch.empty(rays, k, dtype=torch.int64)
    seen_from, seen_along = torch.empty(rays, k, 3), torch.empty(rays, k, 3)
    counts, strangers = torch.empty(rays, dtype=torch.int64), torch.empty(rays, dtype=torch.bool)
    # Without layers nothing is close enough to be the foremost.
    rules = (-1.0, 0.0, 0.0) if layers is None else (r**2 for r in vars(layers).values())
    close, apart, cutoff = (np.float32(rule) for rule in rules)
    _pull_back(
        as_float32(origins),
        as_float32(directions),
        as_float32(positions),
        as_float32(rest),
        as_float32(to_rest),
        candidates.contiguous().numpy(),
        close,
        apart,
        cutoff,
        hidden,
        chosen.numpy(),
        seen_from.numpy(),
        seen_along.numpy(),
        counts.numpy(),
        strangers.numpy(),
    )
    return PulledBack(
        neighbours=chosen,
        origins=seen_from,
        directions=seen_along,
        counts=counts,
        strangers=strangers,
    )


@numba.njit(cache=True, parallel=True)
def _pull_back(
    origins: np.ndarray,
    directions: np.ndarray,
    positions: np.ndarray,
    rest: np.ndarray,
    to_rest: np.ndarray,
    candidates: np.ndarray,
    close: np.float32,
    apart: np.float32,
    cutoff: np.float32,
    hidden: bool,
    chosen: np.ndarray,
    seen_from: np.ndarray,
    seen_along: np.ndarray,
    counts: np.ndarray,
    strangers: np.ndarray,
) -> None:
    rays, k = chosen.shape
    for ray in prange(rays):
        origin, direction = origins[ray], directions[ray]
        squared = np.empty(candidates.shape[1], dtype=np.float32)
        depth = np.empty(candidates.shape[1], dtype=np.float32)
        foremost, least = -1, np.float32(np.inf)
        for c in range(candidates.shape[1]):
            point = candidates[ray, c]
            here = positions[point]
            x, y, z, u, v, w = _at_rest(origin, direction, here, to_rest[point])
            squared[c] = _squared_distance(x, y, z, u, v, w)
            depth[c] = (
                (here[0] - origin[0]) * direction[0]
                + (here[1] - origin[1]) * direction[1]
                + (here[2] - origin[2]) * direction[2]
            )
            # What lies behind the origin hides nothing.
            if squared[c] <= close and 0 < depth[c] < least:
                foremost, least = c, depth[c]
        bits = squared.view(np.int32)
        best = np.full(k, np.iinfo(np.int64).max)
        count, met = 0, False
        for c in range(candidates.shape[1]):
            stranger = False
            if foremost >= 0 and depth[c] > least and squared[c] <= cutoff:
                point = candidates[ray, c]
                ahead = rest[candidates[ray, foremost]]
                x, y, z = (
                    rest[point, 0] - ahead[0],
                    rest[point, 1] - ahead[1],
                    rest[point, 2] - ahead[2],
                )
                # Between points close to each other, both close to the ray, nothing is apart.
                if max(x * x + y * y + z * z, squared[c]) > np.float32(0.25) * apart:
                    a, b, d, u, v, w = _at_rest(origin, direction, positions[point], to_rest[point])
                    stranger = _squared_distance(x + a, y + b, z + d, u, v, w) > apart
            met |= stranger
            if stranger == hidden:
                count += 1
                key = key_of(bits[c], c)
                if key < best[k - 1]:
                    sift(best, k - 1, key)
        counts[ray], strangers[ray] = min(count, k), met
        for s in range(k):
            # Slots that nothing fills repeat the first candidate.
            point = candidates[ray, best[s] & PLACE if s < count else 0]
            # Again, for k of the candidates: to keep it for all of them takes longer.
            x, y, z, u, v, w = _at_rest(origin, direction, positions[point], to_rest[point])
            length = max(np.float32(math.sqrt(u * u + v * v + w * w)), np.float32(SHORTEST))
            here, start, ahead = rest[point], seen_from[ray, s], seen_along[ray, s]
            chosen[ray, s] = point
            start[0], start[1], start[2] = here[0] + x, here[1] + y, here[2] + z
            ahead[0], ahead[1], ahead[2] = u / length, v / length, w / length


@numba.njit(cache=True)
def _squared_distance(x: float, y: float, z: float, u: float, v: float, w: float) -> Any:
    """Of the line through (x, y, z) along (u, v, w), of any length, from the origin."""
    length = max(u * u + v * v + w * w, np.float32(SHORTEST))
    return ((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2) / length


@numba.njit(cache=True)
def _at_rest(
    origin: np.ndarray, direction: np.ndarray, position: np.ndarray, to_rest: np.ndarray
) -> Any:
    """Offset of a ray's origin from a point, and its direction, both mapped to the rest state."""
    x, y, z = origin[0] - position[0], origin[1] - position[1], origin[2] - position[2]
    u, v, w = direction[0], direction[1], direction[2]
    x, y, z = _mapped(to_rest, x, y, z)
    u, v, w = _mapped(to_rest, u, v, w)
    return x, y, z, u, v, w


@numba.njit(cache=True)
def _mapped(matrix: np.ndarray, x: float, y: float, z: float) -> Any:
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


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
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
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
