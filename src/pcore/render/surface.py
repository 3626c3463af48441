"""Where rays meet the surface, and how much brighter it is there than in the photos.

The paper's surface point is the mean of the points by their weights (`Hits.centroid`), which the
consistency losses ask for. At the rim of an arm before a body it lies in the air between them: a
depth that nothing has, a speck in a point cloud. Pictures take one layer of points: its mean, or,
where the surface over them is known, the place where a ray meets the surfels
(docs/concepts/light.md).

The colours of a ray are sharper than its points are apart, since attention has learned where
between them an edge runs. A mean over points is not, and knows nothing of the edge that light
makes. So gains are those of the surfels around that place which face the ray.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.kernels import cpu_intersection
from pcore.kernels.backends import takes_cpu
from pcore.model.hits import Hits

_FRONT = 0.2
"""Share of the weight in front of which nothing is taken for a layer. Chosen on a figure of our own
(ADR 5)."""
_FACING = 0.05
"""Least cosine between a ray and a surfel that it can see."""
_SLANT = 0.2
"""Cosine below which a ray meets a plane no more slantingly than that."""
_NEAR = 2.0
"""Spacings before and behind a surfel within which a ray meets its plane."""
_EXTENT, _WIDTH = 1.0, 0.6
"""Spacings from a surfel within which its plane says where a ray meets the surface, and its gain
what is seen there; beyond, with the inverse fourth power of the distance. All chosen on objects of
our own (ADR 14)."""
_HIDDEN = 1e-6
"""What a surfel counts that faces away: nothing, unless all do."""


def surface_of(
    posed: PosedCloud, rays: RayBundle, hits: Hits, cutoff: float | None
) -> tuple[Tensor, Tensor | None]:
    """Find where rays meet the surface: one layer of it, that of the first point that counts.

    That is the one where a fifth of the weight is met along the ray; points of its layer lie, at
    rest, within a cut-off of it.

    Args:
        posed: the points.
        rays: (R,) rays, world units.
        hits: what they hit.
        cutoff: distance beyond which a point gets no attention, world units; None: all points are
            one layer, for nothing says how thick it is.

    Returns:
        Places (R, 3), world units; NaN where a ray hits nothing. And gains (R,) there, 1 where a
        ray hits nothing; None where the light is that of the photos. Both are differentiable.
    """
    mask = hits.mask
    surface = hits.centroid.masked_fill(~mask.unsqueeze(1), math.nan)
    if cutoff is None and posed.surfels is None:
        return surface, None
    ray_of_hit = torch.nonzero(mask).squeeze(-1)
    lines, points = rays[ray_of_hit], hits.neighbours[ray_of_hit]
    weights, places = first_layer(posed, lines, hits.weights[ray_of_hit], points, cutoff)
    gains = None
    if posed.surfels is not None:
        places, found = intersect(posed.surfels, posed.gains, lines, weights, points)
        if found is not None:
            gains = torch.ones_like(surface[:, 0]).index_copy(0, ray_of_hit, found.to(surface))
    return surface.index_copy(0, ray_of_hit, places.to(surface)), gains


def first_layer(
    posed: PosedCloud, rays: RayBundle, weights: Tensor, points: Tensor, cutoff: float | None
) -> tuple[Tensor, Tensor]:
    """Weights (R, k) of the points of the layer that rays meet first, and its mean place (R, 3).

    Args:
        posed: the points.
        rays: (R,) world units.
        weights: (R, k) of the points that they hit, not all zero.
        points: (R, k) indices of those.
        cutoff: how far from the first of them, at rest, a layer's points lie at most; None: all
            are one layer.
    """
    positions, rest = posed.positions, posed.seen_positions
    if cutoff is not None and _by_kernel(weights, positions):
        # Points are ordered along one ray: where it begins does not matter.
        places, limits = (positions, rest), (_FRONT, cutoff)
        return cpu_intersection.first_layer(weights, points, places, rays.directions, limits)
    here = positions[points]
    if cutoff is not None:
        depth = ((here - rays.origins.unsqueeze(1)) * rays.directions.unsqueeze(1)).sum(dim=-1)
        order = depth.argsort(dim=1)
        least = _FRONT * weights.sum(dim=1, keepdim=True)
        reached = weights.gather(1, order).cumsum(dim=1) >= least
        first = order.gather(1, reached.int().argmax(dim=1, keepdim=True)).unsqueeze(-1)
        there = rest[points]
        apart = (there - there.take_along_dim(first, dim=1)).square().sum(dim=-1)
        weights = weights * (apart <= cutoff**2)
    return weights, (weights.unsqueeze(-1) * here).sum(dim=1) / weights.sum(dim=1, keepdim=True)


def intersect(
    surfels: Surfels, gains: Tensor | None, rays: RayBundle, weights: Tensor, points: Tensor
) -> tuple[Tensor, Tensor | None]:
    """Find where rays meet surfels (M, 3) and the gains there (M,), if there are any.

    Args:
        surfels: over the points, on the device of the rays.
        gains: (N,) of the surfels.
        rays: (M,) world units.
        weights: (M, k) of the points that they met, not all zero.
        points: (M, k) indices of those.
    """
    followed = [weights, surfels.places, surfels.normals, rays.origins, rays.directions]
    followed += [] if gains is None else [gains]
    spacing = surfels.spacing
    if isinstance(spacing, Tensor) or not _by_kernel(*followed):
        places, middle = meet_planes(surfels, rays, weights, points)
        return places, None if gains is None else gains_at(surfels, gains, rays, places, middle)
    extent, width = (one * spacing or 1.0 for one in (_EXTENT, _WIDTH))
    limits = _FACING, _SLANT, _NEAR * spacing, extent, width, _HIDDEN
    return cpu_intersection.intersect(surfels, gains, rays, weights, points, limits)


def meet_planes(
    surfels: Surfels, rays: RayBundle, weights: Tensor, points: Tensor
) -> tuple[Tensor, Tensor]:
    """Find where rays meet the surface.

    A ray meets the plane of every surfel over its points that faces it; the mean of the distances
    is taken, by the points' weights and by how near to its surfel each plane is met. Where none
    faces it, as behind an open rim, the surfels' own distances are.

    Returns:
        The places (M, 3), and the point (M,) that says most about each.
    """
    offset = surfels.places[points] - rays.origins.unsqueeze(1)
    normals, ahead = surfels.normals[points], rays.directions.unsqueeze(1)
    across, depth = (normals * ahead).sum(dim=2), (offset * ahead).sum(dim=2)
    facing = across < -_FACING
    reach = _NEAR * surfels.spacing
    plane = (offset * normals).sum(dim=2) / across.clamp_max(-_SLANT)
    plane = torch.minimum(torch.maximum(plane, depth - reach), depth + reach)
    distance = torch.where(facing, plane, depth)
    told = (weights * facing).sum(dim=1, keepdim=True) > _HIDDEN
    apart = (distance.unsqueeze(2) * ahead - offset).square().sum(dim=2)
    shown = torch.where(told, weights * facing, weights) * _nearness(apart, _EXTENT, surfels)
    mean = (shown * distance).sum(dim=1, keepdim=True) / shown.sum(dim=1, keepdim=True)
    middle = points.gather(1, shown.argmax(dim=1, keepdim=True)).squeeze(1)
    return rays.origins + mean * rays.directions, middle


def gains_at(
    surfels: Surfels, gains: Tensor, rays: RayBundle, places: Tensor, middle: Tensor
) -> Tensor:
    """Gain (M,) of what rays meet: of the surfels around that face them.

    Args:
        surfels: over the points.
        gains: (N,) of the surfels.
        rays: (M,) world units.
        places: (M, 3) where they meet the surface, world units.
        middle: (M,) the point that says most about each place.
    """
    if surfels.beside.shape[1] == 0:
        return places.new_ones(len(places))
    around = surfels.beside[middle]
    apart = (surfels.places[around] - places.unsqueeze(1)).square().sum(dim=2)
    towards = -(surfels.normals[around] * rays.directions.unsqueeze(1)).sum(dim=2)
    share = torch.where(towards > _FACING, 1.0, _HIDDEN) * _nearness(apart, _WIDTH, surfels)
    change = (share * gains.log()[around]).sum(dim=1) / share.sum(dim=1)
    return change.exp()


def middle_surface(surface: Tensor, origins: Tensor) -> Tensor:
    """Of the surface points (M, S, 3) of a pixel the one of the middle distance, (M, 3).

    A mean would lie between front and back where a pixel shows an edge. NaN are left out where
    there are others.
    """
    distance = (surface - origins).detach().norm(dim=-1).nan_to_num(nan=math.inf)
    met = torch.isfinite(distance).sum(dim=1, keepdim=True)
    middle = distance.argsort(dim=1).gather(1, (met - 1).clamp_min(0) // 2)
    return surface.take_along_dim(middle.unsqueeze(-1), dim=1).squeeze(1)


def _by_kernel(*tensors: Tensor) -> bool:
    """Whether the CPU's kernels can do it: they know float32 alone, and no gradient."""
    followed = torch.is_grad_enabled() and any(one.requires_grad for one in tensors)
    return not followed and all(takes_cpu(one) for one in tensors)


def _nearness(squared: Tensor, spacings: float, surfels: Surfels) -> Tensor:
    """Weights of surfels by their squared distances: 1 at 0, a quarter after so many spacings."""
    return (1 + squared / _reach(spacings, surfels) ** 2).pow(-2)


def _reach(spacings: float, surfels: Surfels) -> float | Tensor:
    """So many spacings in world units; 1 for a point alone, which is no distance from others."""
    return spacings * surfels.spacing or 1.0
