"""Flat Gaussians (2DGS) in space to maps from pixels into their planes, in torch, with gradients.

A ray meets the plane of a disc in one place (Huang et al. 2024). With d the offset of a pixel from
the projected centre, A the derivative of the pixel by the disc's coordinates (u, v) and g that of
the logarithm of the depth, both at the centre, the place is exactly

    (u, v) = A^-1 d / (1 + w . d),    w = -A^-T g,    depth = depth of the centre / (1 + w . d).

This is the intersection of the published kernel, written about the centre, where nothing cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.kernels.cpu_projection_loops import SMALLEST_SHARE

_EDGE_ON = 1e-6
"""Least area of A as a share of its squared size: flatter discs would be divided by zero."""


@dataclass(frozen=True, kw_only=True)
class ProjectedDiscs:
    """N discs before C cameras; only those in front of the near plane mean anything.

    Attributes:
        means: (C, N, 2) columns and rows of the centres, pixels.
        depths: (C, N) camera z of the centres, world units.
        maps: (C, N, 6) p, q, w, 1 / pixels: the disc's squared distance at an offset d is
            ((p . d)^2 + (q . d)^2) / (1 + w . d)^2.
        shares: (C, N) what the filter leaves of the opacities where the discs' sums are to stay.
    """

    means: Tensor
    depths: Tensor
    maps: Tensor
    shares: Tensor


def project_discs(
    means: Tensor,
    tangents: Tensor,
    viewmats: Tensor,
    intrinsics: Tensor,
    *,
    near_plane: float,
    eps2d: float | None,
) -> ProjectedDiscs:
    """Map pixels into the planes of discs.

    Args:
        means: (N, 3) world units.
        tangents: (N, 3, 2) the two axes of each disc, as long as its standard deviations, world
            units; they need not be perpendicular.
        viewmats: (C, 4, 4) camera from world, OpenCV axes (z forward).
        intrinsics: (C, 3, 3) without skew, pixels.
        near_plane: depths below it are taken for this one, so that nothing is divided by zero.
        eps2d: variance that a pixel adds to the discs, pixels squared; None adds nothing.
    """
    rows = [[entry.unsqueeze(-1) for entry in row.unbind(-1)] for row in _rows(viewmats)]
    x, y, z = means.unbind(-1)
    right, down, depth = (r[0] * x + r[1] * y + r[2] * z + r[3] for r in rows)
    ahead = depth.clamp_min(near_plane)
    slopes = (right / ahead, down / ahead)
    axes = [tangents[..., k].unbind(-1) for k in range(2)]
    local = [[r[0] * a[0] + r[1] * a[1] + r[2] * a[2] for a in axes] for r in rows]
    farther = [along / ahead for along in local[2]]
    across: list[list[Tensor]] = []
    middles: list[Tensor] = []
    for axis in range(2):
        focal, middle = intrinsics[:, axis, axis, None], intrinsics[:, axis, 2, None]
        middles.append(focal * slopes[axis] + middle)
        across.append(
            [focal * (local[axis][k] / ahead - slopes[axis] * farther[k]) for k in range(2)]
        )
    maps, shares = _sharp(across, farther) if eps2d is None else _wide(across, farther, eps2d)
    return ProjectedDiscs(
        means=torch.stack(middles, dim=-1),
        depths=depth,
        maps=torch.stack(maps, dim=-1),
        shares=shares,
    )


def disc_normals(means: Tensor, tangents: Tensor, viewmats: Tensor) -> Tensor:
    """Unit normals (C, N, 3) of discs in the world, turned towards the cameras."""
    normal = torch.linalg.cross(tangents[..., 0], tangents[..., 1])
    normal = torch.nn.functional.normalize(normal, dim=-1)
    centers = -(viewmats[:, :3, :3].mT @ viewmats[:, :3, 3:]).squeeze(-1)
    away = ((means - centers[:, None]) * normal).sum(dim=-1, keepdim=True).detach() > 0
    return torch.where(away, -normal, normal)


def _rows(viewmats: Tensor) -> tuple[Tensor, ...]:
    return viewmats[:, :3].unbind(-2)


def _sharp(across: list[list[Tensor]], farther: list[Tensor]) -> tuple[list[Tensor], Tensor]:
    """p, q, w of the bare discs: p and q are the rows of A^-1."""
    (xu, xv), (yu, yv) = across
    area = xu * yv - xv * yu
    size = xu * xu + xv * xv + yu * yu + yv * yv
    least = (_EDGE_ON * size).clamp_min(torch.finfo(size.dtype).tiny ** 0.5)
    area = torch.where(area.abs() < least, least, area)
    p, q = (yv / area, -xv / area), (-yu / area, xu / area)
    w = [-(farther[0] * p[k] + farther[1] * q[k]) for k in range(2)]
    return [*p, *q, *w], torch.ones_like(area)


def _wide(
    across: list[list[Tensor]], farther: list[Tensor], eps2d: float
) -> tuple[list[Tensor], Tensor]:
    """p, q, w of the discs widened by a pixel, S = A A^T + eps I: S^-1 = p p^T + q q^T.

    Of the places in the disc that a pixel sees, u = A^T S^-1 d is the mean, so w = -S^-1 A g: where
    the disc stands across the view nothing is divided by zero.
    """
    (xu, xv), (yu, yv) = across
    xx, xy, yy = xu * xu + xv * xv + eps2d, xu * yu + xv * yv, yu * yu + yv * yv + eps2d
    area, bare = xx * yy - xy * xy, xu * yv - xv * yu
    root = (yy * area).sqrt()
    first, second = (a[0] * farther[0] + a[1] * farther[1] for a in across)
    w = (-(yy * first - xy * second) / area, (xy * first - xx * second) / area)
    p, q = (yy / root, -xy / root), (torch.zeros_like(xx), yy.rsqrt())
    share = (bare * bare / area).clamp(SMALLEST_SHARE, 1.0).sqrt()
    return [*p, *q, *w], share
