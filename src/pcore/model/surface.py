"""Where a pixel's rays meet the surface: one place, however many layers of points answer.

The paper's surface point is the mean of the points by their weights (`Attended.surface`), which the
consistency losses ask for. At the rim of an arm before a body it lies in the air between them: a
depth that nothing has, a speck in a point cloud. Pictures take the mean over one layer, or where
the ray meets the surface over its points if a cloud knows it (`pcore.model.meeting`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended
from pcore.model.meeting import meet_lit

_FRONT = 0.2
"""Share of the weight in front of which nothing is taken for a layer. Chosen on a figure of our own
(ADR 5)."""


@dataclass(frozen=True, kw_only=True)
class Met:
    """What R rays meet.

    Attributes:
        surface: (R, 3) world units; NaN where a ray has no attention at all.
        gains: (R,) factor on the brightness of the surface there, 1 where a ray meets nothing; None
            where the light is that of the photos.
    """

    surface: Tensor
    gains: Tensor | None


@torch.no_grad()
def surface_of(
    cloud: PointCloud,
    rays: RayBundle,
    attended: Attended,
    neighbours: Tensor,
    cutoff: float | None,
) -> Met:
    """Find where rays meet the surface: one layer of it, that of the first point that counts.

    That is the one where a fifth of the weight is met along the ray; points of its layer lie, at
    rest, within a cut-off of it.

    Args:
        cloud: the points.
        rays: (R,) rays, world units.
        attended: what they met.
        neighbours: (R, k) indices into the cloud.
        cutoff: distance beyond which a point gets no attention, world units; None: all points are
            one layer, for nothing says how thick it is.
    """
    met = attended.weights.sum(dim=-1) > 0
    surface = attended.surface.masked_fill(~met.unsqueeze(1), math.nan)
    skin = cloud.skin
    gains = None if skin is None or skin.gains is None else torch.ones_like(surface[:, 0])
    if cutoff is None and skin is None:
        return Met(surface=surface, gains=None)
    rows = torch.nonzero(met).squeeze(-1)
    weights, lines, points = attended.weights[rows], rays[rows], neighbours[rows]
    here = cloud.positions.detach()[points]
    if cutoff is not None:
        depth = ((here - lines.origins.unsqueeze(1)) * lines.directions.unsqueeze(1)).sum(dim=-1)
        rest = here if cloud.frames is None else cloud.frames.rest.detach()[points]
        weights = weights * _first_layer(weights, depth, rest, cutoff)
    if skin is None:
        places = _mean(here, weights)
        return Met(surface=surface.index_copy(0, rows, places), gains=None)
    on_skin, factors = meet_lit(skin, lines, weights, points)
    if gains is not None and factors is not None:
        gains = gains.index_copy(0, rows, factors.to(gains))
    places = on_skin.to(surface) if skin.deep else _mean(here, weights)
    return Met(surface=surface.index_copy(0, rows, places), gains=gains)


def _mean(places: Tensor, weights: Tensor) -> Tensor:
    """Means (R, 3) of places (R, k, 3) by weights (R, k)."""
    return (weights.unsqueeze(-1) * places).sum(dim=1) / weights.sum(dim=1, keepdim=True)


def _first_layer(weights: Tensor, depth: Tensor, rest: Tensor, cutoff: float) -> Tensor:
    """(R, k) bool, which points of rays belong to the layer that they meet first.

    Args:
        weights: (R, k) of the points.
        depth: (R, k) along the rays, world units.
        rest: (R, k, 3) places of the points at rest, world units.
        cutoff: how far from the first of them, at rest, a layer's points lie at most.
    """
    order = depth.argsort(dim=1)
    reached = weights.gather(1, order).cumsum(dim=1) >= _FRONT * weights.sum(dim=1, keepdim=True)
    first = order.gather(1, reached.int().argmax(dim=1, keepdim=True)).unsqueeze(-1)
    apart = (rest - rest.take_along_dim(first, dim=1)).square().sum(dim=-1)
    return apart <= cutoff**2


def middle_surface(surface: Tensor, origins: Tensor) -> Tensor:
    """Of the surface points (M, S, 3) of a pixel the one of the middle distance, (M, 3).

    A mean would lie between front and back where a pixel shows an edge. NaN are left out where
    there are others.
    """
    distance = (surface - origins).norm(dim=-1).nan_to_num(nan=math.inf)
    met = torch.isfinite(distance).sum(dim=1, keepdim=True)
    middle = distance.argsort(dim=1).gather(1, (met - 1).clamp_min(0) // 2)
    return surface.take_along_dim(middle.unsqueeze(-1), dim=1).squeeze(1)
