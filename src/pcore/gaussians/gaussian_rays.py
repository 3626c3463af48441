"""What single rays see of Gaussians: every ray is a picture of one pixel, with gradients.

Along a ray the density of a Gaussian is greatest at exp(-m^2 / 2), where m is the Mahalanobis
distance at which the ray passes; that is the Gaussian's shadow along the ray, looked up where the
ray passes. A ray may have a width, as a pixel has: it is added to the shadow as in
`pcore.gaussians.render`. Blending is front to back, in the order of the means along the ray.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.gaussians.covariance import covariances
from pcore.gaussians.render import Footprint, PosedGaussians
from pcore.geometry.rays import RayBundle, perpendicular

_FAINT = 1 / 255
"""Less opacity than this is not drawn, as in pictures."""
_OPAQUE = 0.999
_PAIRS = 4_000_000
"""Rays times Gaussians that are looked through at once."""
_TINY = 1e-20
_FLATTEST = 1e-6
"""Shadows are not thinner than the root of this, so that rounding makes none of them negative."""


@dataclass(frozen=True, kw_only=True)
class Traced:
    """What R rays see.

    Attributes:
        rgb: (R, 3) over the background, not clamped.
        alpha: (R,) opacity.
        depth: (R,) mean distance along the ray of what is blended, world units; 0 where nothing is.
        centroid: (R, 3) mean of the means of what is blended, world units; 0 where nothing is.
        spread: (R,) variance of that distance times the opacity, world units squared.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    centroid: Tensor
    spread: Tensor


def trace(
    posed: PosedGaussians,
    rays: RayBundle,
    *,
    background: Tensor,
    footprint: Footprint,
    pixels: Tensor | None = None,
) -> Traced:
    """Blend Gaussians along rays.

    Args:
        posed: N Gaussians.
        rays: (R,) of them, on the same device; gradients reach them.
        background: (3,) colour.
        footprint: as the Gaussians were trained.
        pixels: (R, 3, 3) squared width of the rays, world units squared, at the object: a pixel
            as wide as w is w^2 times the identity. None draws lines: many of them in a pixel have
            its colour as their mean.
    """
    if pixels is None:
        pixels = rays.directions.new_zeros(rays.shape[0], 3, 3)
    filters = footprint.variance * pixels
    parts: list[tuple[Tensor, ...]] = []
    for part in _parts(rays.shape[0], len(posed.gaussians)):
        some, wide = rays[part], filters[part]
        met = _met(posed, some.each(Tensor.detach), wide)
        parts.append(_blend(posed, some, met, wide, background, footprint))
    rgb, alpha, depth, centroid, spread = (torch.cat(one) for one in zip(*parts, strict=True))
    return Traced(rgb=rgb, alpha=alpha, depth=depth, centroid=centroid, spread=spread)


def _parts(rays: int, count: int) -> Iterator[slice]:
    step = max(1, _PAIRS // max(count, 1))
    for first in range(0, max(rays, 1), step):
        yield slice(first, first + step)


@torch.no_grad()
def _met(posed: PosedGaussians, rays: RayBundle, filters: Tensor) -> tuple[Tensor, Tensor]:
    """Which rays (P,) may see which Gaussians (P,); sorted by ray, then from front to back."""
    gaussians = posed.gaussians
    means = gaussians.means.detach()
    # Beside the object, so that squares of distances keep their digits.
    ahead = ((means.mean(dim=0) - rays.origins) * rays.directions).sum(dim=-1, keepdim=True)
    feet = rays.origins + ahead * rays.directions
    along = rays.directions @ means.T - (feet * rays.directions).sum(dim=-1, keepdim=True)
    squares = (means.square().sum(dim=-1) - 2 * feet @ means.T).add_(
        feet.square().sum(dim=-1, keepdim=True)
    )
    distance = along + ahead
    reach = (2 * (gaussians.opacities.detach() / _FAINT).clamp_min(1).log()).sqrt()
    wide = filters.norm(dim=(-2, -1)).sqrt().unsqueeze(-1)
    width = reach * (_sizes(posed) + wide)
    met = (squares - along.square() < width.square()) & (distance > 0)
    met &= gaussians.opacities.detach() > _FAINT
    ray, which = met.nonzero(as_tuple=True)
    order = distance[ray, which].argsort(stable=True)
    order = order[ray[order].argsort(stable=True)]
    return ray[order], which[order]


def _sizes(posed: PosedGaussians) -> Tensor:
    """(N,) at least the longest standard deviation."""
    if posed.axes is None:
        return posed.gaussians.scales.detach().amax(dim=-1)
    return posed.axes.detach().norm(dim=(-2, -1))


def _blend(
    posed: PosedGaussians,
    rays: RayBundle,
    met: tuple[Tensor, Tensor],
    filters: Tensor,
    background: Tensor,
    footprint: Footprint,
) -> tuple[Tensor, ...]:
    """Colour (R, 3), opacity and depth (R,), centroid (R, 3), spread (R,)."""
    ray, which = met
    opacity, distance, directions = _opacities(posed, rays, met, filters, footprint)
    rgb = posed.colors(directions, which)
    weights = opacity * _clearness(opacity, ray)
    count = rays.shape[0]

    def total(values: Tensor) -> Tensor:
        return values.new_zeros(count, *values.shape[1:]).index_add(0, ray, values)

    alpha = total(weights)
    shares = weights / alpha.clamp_min(_FAINT).index_select(0, ray)
    depth = total(shares * distance)
    centroid = total(shares.unsqueeze(-1) * posed.gaussians.means.index_select(0, which))
    spread = total(weights * (distance - depth.index_select(0, ray)).square())
    behind = (1 - alpha).unsqueeze(-1) * background.to(rgb)
    return total(weights.unsqueeze(-1) * rgb) + behind, alpha, depth, centroid, spread


def _opacities(
    posed: PosedGaussians,
    rays: RayBundle,
    met: tuple[Tensor, Tensor],
    filters: Tensor,
    footprint: Footprint,
) -> tuple[Tensor, Tensor, Tensor]:
    """Of P pairs: opacity (P,), distance of the mean (P,), direction to it (P, 3)."""
    ray, which = met
    gaussians = posed.gaussians
    spread = posed.covariances
    if spread is None:
        spread = covariances(gaussians.quats, gaussians.scales)
    offsets = gaussians.means.index_select(0, which) - rays.origins.index_select(0, ray)
    side = perpendicular(rays.directions)
    across = torch.stack([side, torch.linalg.cross(rays.directions, side)], dim=-1)
    frame, forward = across.index_select(0, ray), rays.directions.index_select(0, ray)
    distance = (offsets * forward).sum(dim=-1)
    x, y = (offsets.unsqueeze(-2) @ frame).squeeze(-2).unbind(dim=-1)
    shapes = spread.index_select(0, which)
    bare, wide = (frame.mT @ one @ frame for one in (shapes, filters.index_select(0, ray)))
    sharp = footprint.flat and not footprint.antialiased
    power, area = _power(bare if sharp else bare + wide, x, y)
    if sharp and bool(filters.any()):
        power = torch.maximum(power, _power(wide, x, y)[0])
    opacity = gaussians.opacities.index_select(0, which) * power.exp()
    if footprint.antialiased:
        opacity = opacity * (_area(bare)[1] / area).sqrt()
    opacity = torch.where(opacity < _FAINT, 0.0, opacity.clamp(max=_OPAQUE))
    return opacity, distance, offsets / offsets.norm(dim=-1, keepdim=True).clamp_min(_TINY)


def _power(shadow: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """-m^2 / 2 (P,) where rays pass shadows (P, 2, 2) at x and y from the middle; determinants."""
    a, area = _area(shadow)
    # A sum of squares: rounding makes no power of a long Gaussian positive.
    rest = y - shadow[:, 0, 1] / a * x
    return -0.5 * (x * x / a + a * rest * rest / area), area


def _area(flat: Tensor) -> tuple[Tensor, Tensor]:
    """First entries and determinants (P,) of shadows (P, 2, 2), both above 0."""
    a, c = flat[:, 0, 0], flat[:, 1, 1]
    tiny = torch.finfo(flat.dtype).tiny
    a = torch.maximum(a, _FLATTEST * c + tiny)
    product = a * c
    return a, torch.maximum(product - flat[:, 0, 1].square(), _FLATTEST * product + tiny)


def _clearness(opacity: Tensor, ray: Tensor) -> Tensor:
    """(P,) what those before let through, of pairs sorted by ray and from front to back."""
    logs = torch.log1p(-opacity.double())
    before = logs.cumsum(dim=0) - logs
    first = torch.ones_like(ray, dtype=torch.bool)
    first[1:] = ray[1:] != ray[:-1]
    starts = before[first]
    return (before - starts.index_select(0, first.cumsum(dim=0) - 1)).exp().to(opacity)
