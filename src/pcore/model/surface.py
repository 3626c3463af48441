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
from pcore.kernels import cpu_intersection as cpu_meeting
from pcore.kernels.backends import takes_cpu
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
    if cutoff is None and skin is None:
        return Met(surface=surface, gains=None)
    rows = torch.nonzero(met).squeeze(-1)
    weights, lines, points = attended.weights[rows], rays[rows], neighbours[rows]
    weights, places = _first_layer(cloud, lines, weights, points, cutoff)
    if skin is None:
        return Met(surface=surface.index_copy(0, rows, places.to(surface)), gains=None)
    on_skin, factors = meet_lit(skin, lines, weights, points)
    gains = None
    if factors is not None:
        gains = torch.ones_like(surface[:, 0]).index_copy(0, rows, factors.to(surface))
    places = (on_skin if skin.deep else places).to(surface)
    return Met(surface=surface.index_copy(0, rows, places), gains=gains)


def _first_layer(
    cloud: PointCloud, rays: RayBundle, weights: Tensor, points: Tensor, cutoff: float | None
) -> tuple[Tensor, Tensor]:
    """Weights (R, k) of the points of the layer that rays meet first, and its mean place (R, 3).

    Args:
        cloud: the points.
        rays: (R,) world units.
        weights: (R, k) of the points that they met, not all zero.
        points: (R, k) indices of those.
        cutoff: how far from the first of them, at rest, a layer's points lie at most; None: all
            are one layer.
    """
    positions = cloud.positions.detach()
    rest = positions if cloud.frames is None else cloud.frames.rest.detach()
    if cutoff is not None and takes_cpu(weights) and takes_cpu(positions):
        # Points are ordered along one ray: where it begins does not matter.
        limits = _FRONT, cutoff
        return cpu_meeting.first_layer(weights, points, (positions, rest), rays.directions, limits)
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


def middle_surface(surface: Tensor, origins: Tensor) -> Tensor:
    """Of the surface points (M, S, 3) of a pixel the one of the middle distance, (M, 3).

    A mean would lie between front and back where a pixel shows an edge. NaN are left out where
    there are others.
    """
    distance = (surface - origins).norm(dim=-1).nan_to_num(nan=math.inf)
    met = torch.isfinite(distance).sum(dim=1, keepdim=True)
    middle = distance.argsort(dim=1).gather(1, (met - 1).clamp_min(0) // 2)
    return surface.take_along_dim(middle.unsqueeze(-1), dim=1).squeeze(1)
