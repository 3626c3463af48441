"""What the networks look at: the points next to each ray, and the ray as these points see it.

Where parts of the cloud were moved, the points next to a ray are those of the foremost layer; what
that hides is looked at by itself, if at all (`pcore.model.strangers`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle, perpendicular
from pcore.kernels.functional import nearest_to_rays, pull_back
from pcore.kernels.ray_layers import LayerRules, PulledBack
from pcore.model.strangers import layer_rules

_CANDIDATES = 1.25
_MOST_CANDIDATES = 64
"""Candidates of the plain search, per neighbour and unit of the frames' condition number, and in
all (what the search on CUDA takes). A circle around an ellipse is larger by the ratio of its axes:
among so many times more are the nearest of the rest state, were all spread evenly. See ADR 5."""
_SHARED = 1.5
"""So many times more where the rays of a pixel share one search."""
_APART = 0.4
"""A pixel's rays share a search when none is farther from their mean than this part of the distance
to the last candidate. Both chosen on held-out deformations: 62 dB to a search by every ray."""
_AWAY = 4.0
"""In cut-offs: where the ray of a slot without a point is put, beside the point it repeats."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """What M rays may meet behind the foremost layer.

    Attributes:
        strangers: (M,) bool, which of them have strangers.
        asked: (M,) which they are of the rays below.
        rays: (A,) world units.
        candidates: (A, c) indices into the cloud.
        frames: of the cloud.
        layers: what tells strangers.
    """

    strangers: Tensor
    asked: Tensor
    rays: RayBundle
    candidates: Tensor
    frames: LocalMaps
    layers: LayerRules


@dataclass(frozen=True, kw_only=True)
class Sight:
    """What R rays meet.

    Attributes:
        neighbours: (R, k) indices into the cloud, of all rays.
        near: (M,) indices of the rays with a point within the cut-off.
        seen: these rays as the networks see them: (M,), or (M, k) as each neighbour sees them.
        hidden: of the M rays; None where nothing can hide what it did not hide at rest.
    """

    neighbours: Tensor
    near: Tensor
    seen: RayBundle
    hidden: Hidden | None = None


@torch.no_grad()
def look(cloud: PointCloud, rays: RayBundle, k: int, cutoff: float | None) -> Sight:
    """Find the neighbours of rays, those of the rest state where the cloud remembers it.

    Args:
        cloud: the points.
        rays: (R,) rays, or (P, S) rays of P pixels, world units; R = P * S.
        k: how many neighbours; all points when there are fewer.
        cutoff: distance beyond which a point gets no attention, world units; None for no limit.
    """
    positions, frames = cloud.positions.detach(), cloud.frames
    if frames is None:
        return _straight(positions, rays.flat(), k, cutoff)
    if cloud.moved_as_one:
        # One map for all: the rays of the rest state themselves, and no candidates to choose from.
        flat, to_rest = rays.flat(), frames.to_rest[0].T
        origins = frames.rest[0] + (flat.origins - positions[0]) @ to_rest
        directions = F.normalize(flat.directions @ to_rest, dim=-1)
        back = RayBundle(origins=origins, directions=directions)
        return _straight(frames.rest, back, k, cutoff)
    return _pulled_back(positions, frames, rays, min(k, len(positions)), cutoff)


def _straight(positions: Tensor, rays: RayBundle, k: int, cutoff: float | None) -> Sight:
    neighbours = nearest_to_rays(rays.origins, rays.directions, positions, k)
    if cutoff is None:
        everyone = torch.arange(len(neighbours), device=neighbours.device)
        return Sight(neighbours=neighbours, near=everyone, seen=rays)
    near = _reached(positions, neighbours, rays, cutoff)
    return Sight(neighbours=neighbours, near=near, seen=rays[near])


def _pulled_back(
    positions: Tensor, frames: LocalMaps, rays: RayBundle, k: int, cutoff: float | None
) -> Sight:
    """Look with rays (R,) or (P, S) at points that each have a map of their own."""
    pixels = rays if len(rays.shape) == 2 else rays[:, None]
    samples = pixels.shape[1]
    middle = _mean_lines(pixels) if samples > 1 else rays.flat()
    # The nearest in the rest state are sought among more than k of the deformed state.
    wanted = _CANDIDATES * frames.anisotropy * k * (_SHARED if samples > 1 else 1.0)
    count = max(k, math.ceil(min(wanted, _MOST_CANDIDATES)))
    shared = nearest_to_rays(middle.origins, middle.directions, positions, count)
    spread, width = _extent(pixels, middle, positions[shared[:, -1]])
    met = torch.arange(len(shared), device=shared.device)
    if cutoff is not None:
        # No point is farther from a ray in the deformed state than so many times in the rest state.
        reach = cutoff * frames.stretch[shared].amax(dim=1) + spread
        met = _reached(positions, shared, middle, reach)
    some, candidates = pixels[met], shared[met].repeat_interleave(samples, dim=0)
    alone = torch.nonzero(spread[met] > _APART * width[met]).squeeze(-1)
    if len(alone):
        own = some[alone].flat()
        found = nearest_to_rays(own.origins, own.directions, positions, count)
        candidates.index_copy_(0, _rays_of(alone, samples), found)
    some = some.flat()
    layers = None if cutoff is None else layer_rules(cutoff)
    found, seen = _chosen(positions, frames, some, candidates, k, layers)
    if cutoff is None or layers is None:
        return Sight(neighbours=found.neighbours, near=_rays_of(met, samples), seen=seen)
    answered = _reached(frames.rest, found.neighbours, seen[:, 0], cutoff)
    near = _rays_of(met, samples)[answered]
    neighbours = shared[:, :k].repeat_interleave(samples, dim=0)
    neighbours.index_copy_(0, near, found.neighbours[answered])
    hidden = Hidden(
        strangers=found.strangers[answered],
        asked=answered,
        rays=some,
        candidates=candidates,
        frames=frames,
        layers=layers,
    )
    return Sight(neighbours=neighbours, near=near, seen=seen[answered], hidden=hidden)


@torch.no_grad()
def look_behind(
    cloud: PointCloud, hidden: Hidden, rows: Tensor, k: int
) -> tuple[Tensor, RayBundle]:
    """Find the strangers nearest to some rays.

    Args:
        cloud: the points.
        hidden: what M rays may meet behind the foremost layer.
        rows: (L,) which of the M rays.
        k: how many.

    Returns:
        Indices (L, k) into the cloud, and the rays (L, k) as those see them.
    """
    asked = hidden.asked[rows]
    rays, candidates = hidden.rays[asked], hidden.candidates[asked]
    positions, k = cloud.positions.detach(), min(k, len(cloud))
    found, seen = _chosen(positions, hidden.frames, rays, candidates, k, hidden.layers, hidden=True)
    return found.neighbours, seen


def _chosen(
    positions: Tensor,
    frames: LocalMaps,
    rays: RayBundle,
    candidates: Tensor,
    k: int,
    layers: LayerRules | None,
    *,
    hidden: bool = False,
) -> tuple[PulledBack, RayBundle]:
    """What `pull_back` keeps of the candidates (R, c) of rays (R,), and the rays as they see them.

    Those (R, k) of slots without a point pass far beside the point that they repeat.
    """
    points = positions, frames.rest, frames.to_rest
    found = pull_back(
        rays.origins, rays.directions, *points, candidates, k=k, layers=layers, hidden=hidden
    )
    seen = RayBundle(origins=found.origins, directions=found.directions)
    empty = torch.nonzero(found.counts < k).squeeze(-1)
    if layers is None or len(empty) == 0:
        return found, seen
    slots = torch.arange(k, device=empty.device)
    slot = torch.nonzero(slots >= found.counts[empty].unsqueeze(1))
    pairs = empty[slot[:, 0]] * k + slot[:, 1]
    beside = perpendicular(seen.directions.flatten(0, 1)[pairs])
    away = frames.rest[found.neighbours.flatten()[pairs]] + _AWAY * layers.cutoff * beside
    origins = seen.origins.flatten(0, 1).index_copy(0, pairs, away).view_as(seen.origins)
    return found, RayBundle(origins=origins, directions=seen.directions)


def _rays_of(pixels: Tensor, samples: int) -> Tensor:
    """Numbers (P * S,) of the rays of pixels (P,) with S of them each."""
    steps = torch.arange(samples, device=pixels.device)
    return (pixels.unsqueeze(1) * samples + steps).flatten()


def _mean_lines(pixels: RayBundle) -> RayBundle:
    """One ray (P,) in the middle of each pixel's rays (P, S)."""
    direction = F.normalize(pixels.directions.mean(dim=1), dim=-1)
    return RayBundle(origins=pixels.origins.mean(dim=1), directions=direction)


def _extent(pixels: RayBundle, middle: RayBundle, points: Tensor) -> tuple[Tensor, Tensor]:
    """How far the rays (P, S) lie from their middle (P,) beside points (P, 3), and the points.

    Returns:
        The largest distance of a ray, and that of the point, (P,) each, world units.
    """
    depth, across = middle.beside(points)
    foot = depth * middle.directions
    places = pixels.origins - middle.origins[:, None] + depth[:, None] * pixels.directions
    spread = (places - foot[:, None]).square().sum(dim=-1).amax(dim=1).sqrt()
    return spread, across.norm(dim=-1)


def _reached(
    points: Tensor, neighbours: Tensor, rays: RayBundle, distance: Tensor | float
) -> Tensor:
    """Indices of the (R,) rays whose first neighbour (R, k) is within a distance (R,)."""
    _, across = rays.beside(points[neighbours[:, 0]])
    return torch.nonzero(across.square().sum(dim=-1) <= distance**2).squeeze(-1)
