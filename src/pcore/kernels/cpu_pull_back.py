"""Rays of the rest state on the CPU by numba: one pass per ray."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from pcore.geometry.rays import RayBundle
from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.numba_bridge import as_float32
from pcore.kernels.reference import SHORTEST
from pcore.kernels.sorted_keys import PLACE, key_of, sift


def pull_back(
    origins: Tensor,
    directions: Tensor,
    positions: Tensor,
    rest: Tensor,
    to_rest: Tensor,
    candidates: Tensor,
    k: int,
    layers: tuple[float, float, float] | None = None,
    back_layer: bool = False,
) -> tuple[Tensor, RayBundle, Tensor, Tensor]:
    """Rays of the rest state as each candidate sees them; see `functional.pull_back`."""
    use_torch_threads()
    rays = len(origins)
    chosen = torch.empty(rays, k, dtype=torch.int64)
    seen_from, seen_along = torch.empty(rays, k, 3), torch.empty(rays, k, 3)
    counts, has_back = torch.empty(rays, dtype=torch.int64), torch.empty(rays, dtype=torch.bool)
    limits = np.array([-1.0, 0.0, 0.0])  # Nothing is close enough to be the foremost.
    if layers is not None:
        limits = np.array(layers) ** 2
    _pull_back(
        as_float32(origins),
        as_float32(directions),
        as_float32(positions),
        as_float32(rest),
        as_float32(to_rest),
        candidates.contiguous().numpy(),
        limits.astype(np.float32),
        back_layer,
        chosen.numpy(),
        seen_from.numpy(),
        seen_along.numpy(),
        counts.numpy(),
        has_back.numpy(),
    )
    return chosen, RayBundle(origins=seen_from, directions=seen_along), counts, has_back


@numba.njit(cache=True, parallel=True)
def _pull_back(
    origins: np.ndarray,
    directions: np.ndarray,
    positions: np.ndarray,
    rest: np.ndarray,
    to_rest: np.ndarray,
    candidates: np.ndarray,
    limits: np.ndarray,
    back_layer: bool,
    chosen: np.ndarray,
    seen_from: np.ndarray,
    seen_along: np.ndarray,
    counts: np.ndarray,
    has_back: np.ndarray,
) -> None:
    rays, k = chosen.shape
    for ray in prange(rays):
        origin, direction = origins[ray], directions[ray]
        squared = np.empty(candidates.shape[1], dtype=np.float32)
        depth = np.empty(candidates.shape[1], dtype=np.float32)
        foremost = _foremost(
            origin, direction, positions, to_rest, candidates[ray], limits[0], squared, depth
        )
        bits = squared.view(np.int32)
        best = np.full(k, np.iinfo(np.int64).max)
        count, layered = 0, False
        for c in range(candidates.shape[1]):
            behind = False
            if foremost >= 0 and depth[c] > depth[foremost] and squared[c] <= limits[2]:
                point, ahead = candidates[ray, c], rest[candidates[ray, foremost]]
                there = positions[point], rest[point], to_rest[point]
                behind = _apart(origin, direction, *there, ahead, squared[c], limits[1])
            layered |= behind
            if behind == back_layer:
                count += 1
                key = key_of(bits[c], c)
                if key < best[k - 1]:
                    sift(best, k - 1, key)
        counts[ray], has_back[ray] = min(count, k), layered
        for s in range(k):
            # Slots that nothing fills repeat the nearest, or the first candidate.
            slot = best[s if s < count else 0] & PLACE if count > 0 else 0
            point = candidates[ray, slot]
            # Again, for k of the candidates: to keep it for all of them takes longer.
            x, y, z, u, v, w = _at_rest(origin, direction, positions[point], to_rest[point])
            length = max(np.float32(math.sqrt(u * u + v * v + w * w)), np.float32(SHORTEST))
            here, start, ahead = rest[point], seen_from[ray, s], seen_along[ray, s]
            chosen[ray, s] = point
            start[0], start[1], start[2] = here[0] + x, here[1] + y, here[2] + z
            ahead[0], ahead[1], ahead[2] = u / length, v / length, w / length


@numba.njit(cache=True)
def _foremost(
    origin: np.ndarray,
    direction: np.ndarray,
    positions: np.ndarray,
    to_rest: np.ndarray,
    candidates: np.ndarray,
    close: np.float32,
    squared: np.ndarray,
    depth: np.ndarray,
) -> int:
    """Fill squared distances at rest and depths (c,); return which is the foremost, or -1."""
    foremost, least = -1, np.float32(np.inf)
    for c in range(len(candidates)):
        point = candidates[c]
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
    return foremost


@numba.njit(cache=True)
def _apart(
    origin: np.ndarray,
    direction: np.ndarray,
    position: np.ndarray,
    rest: np.ndarray,
    to_rest: np.ndarray,
    ahead: np.ndarray,
    squared: np.float32,
    limit: np.float32,
) -> bool:
    """Whether the ray that a point sees passes the foremost one `ahead` farther than a limit."""
    x, y, z = rest[0] - ahead[0], rest[1] - ahead[1], rest[2] - ahead[2]
    # Between points close to each other, both close to the ray, nothing is apart.
    if max(x * x + y * y + z * z, squared) <= np.float32(0.25) * limit:
        return False
    a, b, c, u, v, w = _at_rest(origin, direction, position, to_rest)
    return _squared_distance(x + a, y + b, z + c, u, v, w) > limit


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
