"""Where rays meet the surface over points, and how much brighter it is there than in the photos.

The colours of a ray are sharper than its points are apart, since attention has learned where
between them an edge runs. A mean over points by attention is not: it lies too deep, because points
do, and it knows nothing of the edge that light makes. So a ray looks for the place where it meets
the planes over its points, and takes the light of those around that place which face it
(docs/concepts/light.md).
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.kernels import cpu_intersection as cpu_meeting
from pcore.kernels.backends import takes_cpu

_FACING = 0.05
"""Least cosine between a ray and a piece of surface that it can see."""
_SLANT = 0.2
"""Cosine below which a ray meets a plane no more slantingly than that."""
_NEAR = 2.0
"""Spacings before and behind a piece of surface within which a ray meets its plane."""
_EXTENT, _WIDTH = 1.0, 0.6
"""Spacings from a piece of surface within which its plane says where a ray meets the surface, and
its light what is seen there; beyond, with the inverse fourth power of the distance. All chosen on
objects of our own (ADR 14)."""
_HIDDEN = 1e-6
"""What a piece counts that faces away: nothing, unless all do."""


def meet_lit(
    skin: Surfels, rays: RayBundle, weights: Tensor, points: Tensor
) -> tuple[Tensor, Tensor | None]:
    """Find where rays meet the surface (M, 3) and the factors there (M,), if it has any.

    Args:
        skin: over the points, on the device of the rays.
        rays: (M,) world units.
        weights: (M, k) of the points that they met, not all zero.
        points: (M, k) indices of those.
    """
    if not takes_cpu(skin.places):
        places, middle = meet(skin, rays, weights, points)
        return places, None if skin.gains is None else gains_at(skin, rays, places, middle)
    extent, width = (_reach(one, skin) for one in (_EXTENT, _WIDTH))
    limits = _FACING, _SLANT, _NEAR * skin.spacing, extent, width, _HIDDEN
    return cpu_meeting.meet(skin, rays, weights, points, limits)


def meet(skin: Surfels, rays: RayBundle, weights: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Find where rays meet the surface.

    A ray meets the plane of every piece of surface over its points that faces it; the mean of the
    distances is taken, by the points' weights and by how near to its piece each plane is met. Where
    none faces it, as behind an open rim, the pieces' own distances are.

    Args:
        skin: over the points, on the device of the rays.
        rays: (M,) world units.
        weights: (M, k) of the points that they met, not all zero.
        points: (M, k) indices of those.

    Returns:
        The places (M, 3), and the point (M,) that says most about each.
    """
    offset = skin.places[points] - rays.origins.unsqueeze(1)
    normals, ahead = skin.normals[points], rays.directions.unsqueeze(1)
    across, depth = (normals * ahead).sum(dim=2), (offset * ahead).sum(dim=2)
    facing = across < -_FACING
    reach = _NEAR * skin.spacing
    plane = (offset * normals).sum(dim=2) / across.clamp_max(-_SLANT)
    plane = torch.minimum(torch.maximum(plane, depth - reach), depth + reach)
    distance = torch.where(facing, plane, depth)
    told = (weights * facing).sum(dim=1, keepdim=True) > _HIDDEN
    apart = (distance.unsqueeze(2) * ahead - offset).square().sum(dim=2)
    shown = torch.where(told, weights * facing, weights) * _nearness(apart, _EXTENT, skin)
    mean = (shown * distance).sum(dim=1, keepdim=True) / shown.sum(dim=1, keepdim=True)
    middle = points.gather(1, shown.argmax(dim=1, keepdim=True)).squeeze(1)
    return rays.origins + mean * rays.directions, middle


def gains_at(skin: Surfels, rays: RayBundle, places: Tensor, middle: Tensor) -> Tensor:
    """Factor (M,) on the brightness of what rays meet: of pieces of surface around that face them.

    Args:
        skin: with gains.
        rays: (M,) world units.
        places: (M, 3) where they meet the surface, world units.
        middle: (M,) the point that says most about each place.
    """
    if skin.gains is None or skin.beside.shape[1] == 0:
        return places.new_ones(len(places))
    around = skin.beside[middle]
    apart = (skin.places[around] - places.unsqueeze(1)).square().sum(dim=2)
    towards = -(skin.normals[around] * rays.directions.unsqueeze(1)).sum(dim=2)
    share = torch.where(towards > _FACING, 1.0, _HIDDEN) * _nearness(apart, _WIDTH, skin)
    change = (share * skin.gains.log()[around]).sum(dim=1) / share.sum(dim=1)
    return change.exp()


def _nearness(squared: Tensor, spacings: float, skin: Surfels) -> Tensor:
    """Weights of pieces by their squared distances: 1 at 0, a quarter after so many spacings."""
    return (1 + squared / _reach(spacings, skin) ** 2).pow(-2)


def _reach(spacings: float, skin: Surfels) -> float:
    """So many spacings in world units; 1 for a point alone, which is no distance from others."""
    return spacings * skin.spacing or 1.0
