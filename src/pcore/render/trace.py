"""From rays to what they hit, in one piece: `trace`.

1. Search once: the points nearest to each ray, the rays of a pixel together.
2. Attend to the foremost layer. Where a pose is known, rays are those of the rest state, as every
   point sees them through its own map, and points that never met one ray at rest (an arm that was
   lowered and the hip behind it) are layers: attention has learned which point of a ray hides
   which, and knows nothing of those.
3. Attend to the layer behind where the foremost lets light through, and composite.
4. Close gaps. A line through a closed object is opaque from either end, but attention has learned
   opacity from the outside only: where an edit lays the inside open, a ray that enters may pass the
   far side, whose inner face no photo has shown. Such a line is traced from its other end.

Why and how well: docs/concepts/deformation-aware-rays.md, ADR 5. An index says what it numbers:
`ray_of_near` holds the rays that near rows are of. Autograd follows everything but the choice of
the points that a ray meets.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle, perpendicular
from pcore.kernels.functional import nearest_to_rays, pull_back, rays_at_rest
from pcore.model.hits import Hits, composite_over
from pcore.model.papr import Papr, constant

CANDIDATES = 1.25
MOST_CANDIDATES = 64
"""Candidates of the search, per neighbour and unit of the maps' condition number, and in all (what
the search on CUDA takes). A circle around an ellipse is larger by the ratio of its axes: among so
many times more are the nearest of the rest state, were all spread evenly. See ADR 5."""
SHARED = 1.5
"""So many times more where the rays of a pixel share one search."""
WIDEST = 0.4
"""A pixel's rays share a search when none is farther from their mean than this part of the distance
to the last candidate. Both chosen on held-out deformations: 62 dB to a search by every ray."""
CLOSE = 0.2
"""In cut-offs, about as far as the points of `tiny` are apart: a ray that meets a surface has a
point of it so near, one that passes its rim by seldom has."""
APART = 0.5
"""In cut-offs: a ray that passes the foremost point by more never met it. Both chosen on poses of
our own (ADR 5)."""
AWAY = 4.0
"""In cut-offs: where the ray of a slot without a point is put, beside the point it repeats."""
OPAQUE = 0.97
"""Behind such an opacity no layer is looked at."""
SOLID = 0.5
"""Opacity from which on a line hits something, and is not a gap."""
GAP = 0.25
"""In cut-offs: a ray that passes no point closer than that passes the object by. Chosen, as is the
opacity, on held-out deformations and on poses of our own (ADR 5)."""

_Attend = Callable[[RayBundle, Tensor, RayBundle], Hits]


def trace(
    papr: Papr,
    posed: PosedCloud,
    rays: RayBundle,
    *,
    threshold: float = 0.0,
    stop_encoding: bool = False,
) -> Hits:
    """Trace rays to the points that they hit; rays beyond the cut-off cost nothing.

    Args:
        papr: the networks.
        posed: the points.
        rays: of any batch shape, world units; those of a pixel share a search.
        threshold: points with less than this weight add nothing to a feature; 0 is exact.
        stop_encoding: as `ProximityAttention.forward` has it.

    Returns:
        What each of the R rays hits, in the order of `rays.flat()`.
    """
    attend = partial(_attend, papr, posed, threshold, stop_encoding)
    hits = _trace_layers(papr, posed, rays, attend)
    if papr.config.cutoff is None or posed.local_maps is None or posed.moved_as_one:
        return hits
    lines = rays.flat()
    ray_of_gap = gaps(hits, posed, lines, papr.config.cutoff)
    if len(ray_of_gap) == 0:
        return hits
    other_ends = lines[ray_of_gap].from_other_ends(*posed.followed_sphere)
    back = _trace_layers(papr, posed, other_ends, attend)
    gap_of_solid = torch.nonzero(back.background < 1 - SOLID).squeeze(-1)
    return hits.with_rows(ray_of_gap[gap_of_solid], back[gap_of_solid])


def _trace_layers(papr: Papr, posed: PosedCloud, rays: RayBundle, attend: _Attend) -> Hits:
    """What R rays hit from this end: the foremost layer, and through it the one behind."""
    k, cutoff = min(papr.config.neighbours, len(posed)), papr.config.cutoff
    nearest, ray_of_near, candidates = search(posed, rays, k, cutoff)
    lines = rays.flat()[ray_of_near]
    neighbours, seen, has_back = layer_of(posed, lines, candidates, k, cutoff)
    if cutoff is not None:
        first = posed.seen_positions.detach()[neighbours[:, 0]]
        near = _closer(first, seen if len(seen.shape) == 1 else seen[:, 0], cutoff)
        neighbours, seen, has_back = neighbours[near], seen[near], has_back[near]
        lines, candidates, ray_of_near = lines[near], candidates[near], ray_of_near[near]
    front = attend(lines, neighbours, seen)
    hits = front.spread_over(nearest, ray_of_near)
    near_of_open = torch.nonzero(has_back & (front.background > 1 - OPAQUE)).squeeze(-1)
    if len(near_of_open) == 0:
        return hits
    lines, candidates = lines[near_of_open], candidates[near_of_open]
    neighbours, seen, _ = layer_of(posed, lines, candidates, k, cutoff, back_layer=True)
    back = attend(lines, neighbours, seen)
    return composite_over(hits, ray_of_near[near_of_open], back)


@torch.no_grad()
def search(
    posed: PosedCloud, rays: RayBundle, k: int, cutoff: float | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Find the points that R rays may meet.

    Args:
        posed: the points.
        rays: of any batch shape, world units; those of a pixel share a search.
        k: how many neighbours a ray has, at most as many as points.
        cutoff: distance beyond which a point gets no attention, world units; None: no limit.

    Returns:
        The k nearest points (R, k) of all rays, nearest first; which rays (M,) may be near points,
        and the candidates (M, c) for their neighbours.
    """
    if posed.local_maps is None or posed.moved_as_one:
        lines = rays.flat() if posed.local_maps is None else _moved_back(posed, rays.flat())
        found = nearest_to_rays(lines.origins, lines.directions, posed.seen_positions, k)
        return found, torch.arange(len(found), device=found.device), found
    pixels, maps, positions = rays.by_pixel(), posed.local_maps, posed.positions
    samples, middle = pixels.shape[1], pixels.middle()
    # The nearest in the rest state are sought among more than k of the deformed state.
    wanted = CANDIDATES * maps.anisotropy * k * (SHARED if samples > 1 else 1.0)
    count = max(k, math.ceil(min(wanted, MOST_CANDIDATES)))
    shared = nearest_to_rays(middle.origins, middle.directions, positions, count)
    last = positions[shared[:, -1]]
    spread, width = pixels.width_at(last), middle.beside(last)[1].norm(dim=-1)
    pixel_of_near = torch.arange(len(shared), device=shared.device)
    if cutoff is not None:
        # No point is farther from a ray in the deformed state than so many times in the rest state.
        reach = cutoff * maps.stretch[shared].amax(dim=1) + spread
        pixel_of_near = _closer(positions[shared[:, 0]], middle, reach)
    candidates = shared[pixel_of_near].repeat_interleave(samples, dim=0)
    wide = torch.nonzero((spread > WIDEST * width)[pixel_of_near]).squeeze(-1)
    if len(wide):
        alone = pixels[pixel_of_near[wide]].flat()
        own = nearest_to_rays(alone.origins, alone.directions, positions, count)
        candidates.index_copy_(0, _rays_of(wide, samples), own)
    nearest = shared[:, :k].repeat_interleave(samples, dim=0)
    return nearest, _rays_of(pixel_of_near, samples), candidates


def layer_of(
    posed: PosedCloud,
    lines: RayBundle,
    candidates: Tensor,
    k: int,
    cutoff: float | None,
    *,
    back_layer: bool = False,
) -> tuple[Tensor, RayBundle, Tensor]:
    """Choose the points that rays attend to, and the rays as those see them.

    Args:
        posed: the points.
        lines: (M,) rays, world units.
        candidates: (M, c) indices of points.
        k: how many points a ray attends to.
        cutoff: distance beyond which a point gets no attention, world units.
        back_layer: those behind the foremost layer instead of the foremost.

    Returns:
        Neighbours (M, k); the rays (M,), or (M, k) as each sees them; which have a layer behind.
    """
    maps = posed.local_maps
    one_layer = torch.zeros(len(candidates), dtype=torch.bool, device=candidates.device)
    if maps is None:
        return candidates, lines, one_layer
    followed = posed.asks_gradient or lines.asks_gradient
    if posed.moved_as_one:
        seen = _seen_at_rest(posed, lines, candidates) if followed else _moved_back(posed, lines)
        return candidates, seen, one_layer
    points = posed.positions, posed.cloud.positions, maps.to_rest
    layers = None if cutoff is None else (CLOSE * cutoff, APART * cutoff, cutoff)
    chosen, seen, counts, has_back = pull_back(
        lines.origins, lines.directions, *points, candidates, k, layers, back_layer
    )
    if followed:
        seen = _seen_at_rest(posed, lines, chosen)
    if cutoff is not None:
        seen = _muted(posed, chosen, seen, counts, cutoff)
    return chosen, seen, has_back


@torch.no_grad()
def gaps(hits: Hits, posed: PosedCloud, lines: RayBundle, cutoff: float) -> Tensor:
    """Which (G,) of R rays from outside pass close to points and see through them.

    Args:
        hits: what they hit.
        posed: the points.
        lines: (R,) the rays, world units.
        cutoff: distance beyond which a point gets no attention, world units.
    """
    ray_of_gap = torch.nonzero(hits.mask & (hits.background > 1 - SOLID)).squeeze(-1)
    if len(ray_of_gap) == 0:
        return ray_of_gap
    some, near = lines[ray_of_gap], posed.positions[hits.neighbours[ray_of_gap]]
    _, across = some[:, None].beside(near)
    squared = across.square().sum(dim=-1).amin(dim=1)
    middle, radius = posed.sphere
    outside = (some.origins - middle).norm(dim=-1) > radius
    return ray_of_gap[(squared <= (GAP * cutoff) ** 2) & outside]


def _attend(
    papr: Papr,
    posed: PosedCloud,
    threshold: float,
    stop_encoding: bool,
    lines: RayBundle,
    neighbours: Tensor,
    seen: RayBundle,
) -> Hits:
    """Attention of rays (M,) to neighbours (M, k) that see them as `seen`."""
    reference = papr.config.reference
    if reference is not None:
        seen = seen.slid(constant(reference.center, posed.positions), reference.distance)
    return papr.attention(posed, lines, neighbours, seen, threshold, stop_encoding=stop_encoding)


def _seen_at_rest(posed: PosedCloud, lines: RayBundle, neighbours: Tensor) -> RayBundle:
    """Rays (M, k) of the rest state as neighbours see rays (M,), with their gradient."""
    assert posed.local_maps is not None
    points = posed.positions, posed.cloud.positions, posed.local_maps.to_rest
    return rays_at_rest(lines.origins, lines.directions, *points, neighbours)


def _moved_back(posed: PosedCloud, lines: RayBundle) -> RayBundle:
    """Rays (R,) of the rest state from which one map takes all points."""
    assert posed.local_maps is not None
    to_rest = posed.local_maps.to_rest[0].T
    origins = posed.cloud.positions[0] + (lines.origins - posed.positions[0]) @ to_rest
    return RayBundle(origins=origins, directions=F.normalize(lines.directions @ to_rest, dim=-1))


def _muted(
    posed: PosedCloud, neighbours: Tensor, seen: RayBundle, counts: Tensor, cutoff: float
) -> RayBundle:
    """Rays (M, k) where those of slots without a point pass far beside the point they repeat."""
    k = neighbours.shape[1]
    ray_of_empty = torch.nonzero(counts < k).squeeze(-1)
    if len(ray_of_empty) == 0:
        return seen
    slots = torch.arange(k, device=counts.device)
    slot = torch.nonzero(slots >= counts[ray_of_empty].unsqueeze(1))
    pairs = ray_of_empty[slot[:, 0]] * k + slot[:, 1]
    beside = perpendicular(seen.directions.detach().flatten(0, 1)[pairs])
    rest = posed.cloud.positions.detach()[neighbours.flatten()[pairs]]
    origins = seen.origins.flatten(0, 1).index_copy(0, pairs, rest + AWAY * cutoff * beside)
    return RayBundle(origins=origins.view_as(seen.origins), directions=seen.directions)


def _rays_of(pixels: Tensor, samples: int) -> Tensor:
    """Numbers (P * S,) of the rays of pixels (P,) with S of them each."""
    steps = torch.arange(samples, device=pixels.device)
    return (pixels.unsqueeze(1) * samples + steps).flatten()


@torch.no_grad()
def _closer(points: Tensor, lines: RayBundle, distance: Tensor | float) -> Tensor:
    """Indices of the lines (R,) that pass their points (R, 3) within a distance (R,)."""
    _, across = lines.beside(points)
    return torch.nonzero(across.square().sum(dim=-1) <= distance**2).squeeze(-1)
