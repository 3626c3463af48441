"""How much brighter than in the photos rays find the surface: where they meet it, not its points.

The colours of a ray are sharper than its points are apart, since attention has learned where
between them an edge runs. A mean over points by attention is not: it knows nothing of the edge that
light makes. So a ray looks for the place where it meets the surface, and takes the light of the
pieces of surface around that place which face it (docs/guide/light.md).
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.lit_surface import LitSurface
from pcore.geometry.rays import RayBundle

_FACING = 0.05
"""Least cosine between a ray and a piece of surface that it can see."""
_SLANT = 0.2
"""Cosine below which a ray meets a plane no more slantingly than that."""
_NEAR = 2.0
"""Spacings before and behind a piece of surface within which a ray meets its plane."""
_WIDTH = 0.6
"""Spacings within which pieces count alike; beyond, with the inverse fourth power. All chosen on
objects of our own (ADR 14)."""
_HIDDEN = 1e-6
"""What a piece counts that faces away: nothing, unless all do."""


@torch.no_grad()
def gains_of_rays(
    surface: LitSurface, rays: RayBundle, weights: Tensor, neighbours: Tensor
) -> Tensor:
    """Factor (R,) on the brightness of what rays meet; 1 where they meet nothing.

    Args:
        surface: over the points, on the device of the rays.
        rays: (R,) world units.
        weights: (R, k) of the points that they met; all zero where they met none.
        neighbours: (R, k) indices of those.
    """
    gains = weights.new_ones(len(weights))
    met = torch.nonzero(weights.sum(dim=1) > 0).squeeze(-1)
    if len(met) == 0 or surface.beside.shape[1] == 0:
        return gains
    lines, points = rays[met], neighbours[met]
    place, middle = _met(surface, lines, weights[met], points)
    around = surface.beside[middle]
    apart = (surface.places[around] - place.unsqueeze(1)).square().sum(dim=2)
    towards = -(surface.normals[around] * lines.directions.unsqueeze(1)).sum(dim=2)
    share = torch.where(towards > _FACING, 1.0, _HIDDEN)
    # A point alone is no distance from others.
    width = _WIDTH * surface.spacing or 1.0
    share = share / (1 + apart / width**2).square()
    change = (share * surface.gains.log()[around]).sum(dim=1) / share.sum(dim=1)
    return gains.index_copy(0, met, change.exp())


def _met(
    surface: LitSurface, rays: RayBundle, weights: Tensor, points: Tensor
) -> tuple[Tensor, Tensor]:
    """Where rays (M,) meet the surface (M, 3), and the point (M,) that says most about it.

    A ray meets the plane of every piece of surface over its points that faces it; the mean by their
    weights is taken. Where none does, as behind an open rim, the pieces themselves.
    """
    offset = surface.places[points] - rays.origins.unsqueeze(1)
    normals, ahead = surface.normals[points], rays.directions.unsqueeze(1)
    across, depth = (normals * ahead).sum(dim=2), (offset * ahead).sum(dim=2)
    facing = across < -_FACING
    reach = _NEAR * surface.spacing
    plane = (offset * normals).sum(dim=2) / across.clamp_max(-_SLANT)
    plane = torch.minimum(torch.maximum(plane, depth - reach), depth + reach)
    distance = torch.where(facing, plane, depth)
    shown = weights * facing
    told = shown.sum(dim=1, keepdim=True) > _HIDDEN
    shown = torch.where(told, shown, weights)
    mean = (shown * distance).sum(dim=1, keepdim=True) / shown.sum(dim=1, keepdim=True)
    middle = points.gather(1, shown.argmax(dim=1, keepdim=True)).squeeze(1)
    return rays.origins + mean * rays.directions, middle
