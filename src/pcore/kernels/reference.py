"""The specification in plain PyTorch: dense, in chunks of rays."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pcore.geometry.rays import RayBundle

_CHUNK_ELEMENTS = 4_000_000
SHORTEST = 1e-30
LENGTH_GUARD = 1e-6
"""The original adds this to the squared length of a direction before it divides by it, also for
unit directions; without it the features of its checkpoints are off by 1e-4 instead of 1e-5."""


def nearest_to_rays(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Indices (R, k) of the points with the smallest distance to the lines of (R, 3) rays."""
    out = torch.empty(origins.shape[0], k, dtype=torch.int64, device=points.device)
    chunk = max(1, _CHUNK_ELEMENTS // points.shape[0])
    for start in range(0, origins.shape[0], chunk):
        rows = slice(start, start + chunk)
        squared = squared_distances(origins[rows], directions[rows], points)
        # A stable sort makes equal distances come in order of the index; topk promises no order.
        out[rows] = torch.sort(squared, dim=-1, stable=True).indices[:, :k]
    return out


def squared_distances(origins: Tensor, directions: Tensor, points: Tensor) -> Tensor:
    """Squared perpendicular distances (R, N) of points (N, 3) to the lines of (R, 3) rays.

    The difference form |v - (v.d) d|^2: |v|^2 - (v.d)^2 cancels in float32.
    """
    offset = points[None, :, :] - origins[:, None, :]
    along = (offset * directions[:, None, :]).sum(dim=-1, keepdim=True)
    return (offset - along * directions[:, None, :]).square().sum(dim=-1)


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
    origins, directions = per_pair(origins), per_pair(directions)
    from_origin = positions[neighbours] - origins
    guarded = directions / (directions.square().sum(dim=-1, keepdim=True) + LENGTH_GUARD)
    along = (from_origin * directions).sum(dim=-1, keepdim=True) * guarded
    off = from_origin - along
    pairs = zip((along, off), frequencies, strict=True)
    waves = torch.cat([encode(scaling(scale, n) * x, n) for x, n in pairs], dim=-1)
    return waves.flatten(0, 1), off.detach().square().sum(dim=-1)


def per_pair(vectors: Tensor) -> Tensor:
    """Vectors (R, 1, 3) or (R, k, 3) of rays given once per row, (R, 3), or once per pair."""
    return vectors.unsqueeze(1) if vectors.ndim == 2 else vectors


def scaling(scale: float, frequencies: int) -> float:
    """Factor on what is encoded: 1 without waves, whose lengths are all that it is for."""
    return scale if frequencies > 0 else 1.0


def encode(x: Tensor, frequencies: int) -> Tensor:
    """Positional encoding gamma of the paper, with the input itself.

    Every scalar becomes the block [x, sin x, cos x, sin 2x, cos 2x, ..., cos 2^(L-1) x]; the blocks
    of a vector follow one another.

    Args:
        x: (..., C).
        frequencies: number of octaves L; 0 leaves the input alone.

    Returns:
        (..., C (1 + 2 L)).
    """
    octaves = 2.0 ** torch.arange(frequencies, device=x.device, dtype=x.dtype)
    phase = x.unsqueeze(-1) * octaves
    waves = torch.stack([phase.sin(), phase.cos()], dim=-1).flatten(-2)
    return torch.cat([x.unsqueeze(-1), waves], dim=-1).flatten(-2)


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
    here = rest[candidates]
    offset = origins[:, None, :] - positions[candidates]
    back, turned = turned_back(offset, directions, to_rest[candidates])
    squared = _squared_distance(back, turned)
    behind = torch.zeros_like(squared, dtype=torch.bool)
    if layers is not None:
        close, apart, cutoff = layers
        # What lies behind the origin hides nothing.
        depth = -(offset * directions[:, None, :]).sum(dim=-1)
        first = (squared <= close**2) & (depth > 0)
        least, foremost = depth.masked_fill(~first, math.inf).min(dim=1, keepdim=True)
        ahead = here.take_along_dim(foremost.unsqueeze(-1), dim=1)
        behind = (least < math.inf) & (depth > least)
        behind &= _squared_distance(here - ahead + back, turned) > apart**2
        behind &= squared <= cutoff**2
    wanted = behind == back_layer
    order = torch.sort(squared.masked_fill(~wanted, math.inf), dim=-1, stable=True).indices[:, :k]
    counts = wanted.sum(dim=-1).clamp_max(order.shape[1])
    # Slots that nothing fills repeat the nearest, or the first candidate where there is none.
    nearest = order[:, :1].where(counts.unsqueeze(1) > 0, 0)
    empty = torch.arange(order.shape[1], device=order.device) >= counts.unsqueeze(1)
    order = order.where(~empty, nearest)
    rows = order.unsqueeze(-1)
    chosen = candidates.gather(1, order)
    seen = RayBundle(
        origins=rest[chosen] + back.take_along_dim(rows, dim=1),
        directions=turned.take_along_dim(rows, dim=1),
    )
    return chosen, seen, counts, behind.any(dim=-1)


def turned_back(offset: Tensor, directions: Tensor, to_rest: Tensor) -> tuple[Tensor, Tensor]:
    """Rays as points see them at rest, from their offsets.

    Args:
        offset: (R, k, 3) from points to the origins of rays, world units.
        directions: (R, 3) of the rays.
        to_rest: (R, k, 3, 3) the ways back around the points.

    Returns:
        Offsets (R, k, 3) and unit directions (R, k, 3) at rest, differentiable.
    """
    back = (to_rest @ offset.unsqueeze(-1)).squeeze(-1)
    turned = (to_rest @ directions[:, None, :, None]).squeeze(-1)
    return back, turned / turned.norm(dim=-1, keepdim=True).clamp_min(SHORTEST)


def _squared_distance(origins: Tensor, directions: Tensor) -> Tensor:
    """Of lines (..., 3) with unit directions from where coordinates begin, (...)."""
    across = origins - (origins * directions).sum(dim=-1, keepdim=True) * directions
    return across.square().sum(dim=-1)
