"""Where a pixel's rays meet the surface: one place, however many layers of points answer.

The paper's surface point is the mean of the points by their weights (`Attended.surface`), which the
consistency losses ask for. At the rim of an arm before a body it lies in the air between them: a
depth that nothing has, a speck in a point cloud. Pictures take the mean over one layer.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended

_FRONT = 0.2
"""Share of the weight in front of which nothing is taken for a layer. Chosen on a figure of our own
(ADR 5)."""


@torch.no_grad()
def surface_points(
    cloud: PointCloud,
    rays: RayBundle,
    attended: Attended,
    neighbours: Tensor,
    cutoff: float | None,
) -> Tensor:
    """Mean by weight of the points that lie, at rest, within a cut-off of the first that counts.

    That is the one where a fifth of the weight is met along the ray.

    Args:
        cloud: the points.
        rays: (R,) rays, world units.
        attended: what they met.
        neighbours: (R, k) indices into the cloud.
        cutoff: distance beyond which a point gets no attention, world units; None: the mean of all
            points, for nothing says how thick a layer is.

    Returns:
        (R, 3) world units; NaN where a ray has no attention at all.
    """
    met = attended.weights.sum(dim=-1) > 0
    surface = attended.surface.masked_fill(~met.unsqueeze(1), math.nan)
    if cutoff is None:
        return surface
    rows = torch.nonzero(met).squeeze(-1)
    weights, lines = attended.weights[rows], rays[rows]
    points = neighbours[rows]
    here = cloud.positions.detach()[points]
    depth = ((here - lines.origins.unsqueeze(1)) * lines.directions.unsqueeze(1)).sum(dim=-1)
    order = depth.argsort(dim=1)
    reached = weights.gather(1, order).cumsum(dim=1) >= _FRONT * weights.sum(dim=1, keepdim=True)
    first = order.gather(1, reached.int().argmax(dim=1, keepdim=True)).unsqueeze(-1)
    rest = here if cloud.frames is None else cloud.frames.rest.detach()[points]
    apart = (rest - rest.take_along_dim(first, dim=1)).square().sum(dim=-1)
    kept = (weights * (apart <= cutoff**2)).unsqueeze(-1)
    return surface.index_copy(0, rows, (kept * here).sum(dim=1) / kept.sum(dim=1))


def middle_surface(surface: Tensor, origins: Tensor) -> Tensor:
    """Of the surface points (M, S, 3) of a pixel the one of the middle distance, (M, 3).

    A mean would lie between front and back where a pixel shows an edge. NaN are left out where
    there are others.
    """
    distance = (surface - origins).norm(dim=-1).nan_to_num(nan=math.inf)
    met = torch.isfinite(distance).sum(dim=1, keepdim=True)
    middle = distance.argsort(dim=1).gather(1, (met - 1).clamp_min(0) // 2)
    return surface.take_along_dim(middle.unsqueeze(-1), dim=1).squeeze(1)
