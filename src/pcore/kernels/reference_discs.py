"""What the kernels of flat Gaussians (2DGS) compute, written as formulas: dense and slow.

See `reference_gaussians`. The bare disc is written as published (Huang et al. 2024): planes through
a pixel's row and column, met with the disc's plane. The widened one is written with matrices.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.kernels.cpu_projection_loops import SMALLEST_SHARE
from pcore.kernels.reference_gaussians import composited, pixel_centers


def ray_transforms(means: Tensor, tangents: Tensor, viewmats: Tensor, intrinsics: Tensor) -> Tensor:
    """M (C, N, 3, 3): a place (u, v) of a disc is seen at the pixel of M (u, v, 1), by division."""
    rotation, shift = viewmats[:, None, :3, :3], viewmats[:, None, :3, 3:]
    places = torch.cat([rotation @ tangents, rotation @ means[..., None] + shift], dim=-1)
    return intrinsics[:, None] @ places


def drawn_discs(
    means: Tensor,
    tangents: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    *,
    near_plane: float,
    eps2d: float,
    antialiased: bool,
    deep: bool,
    median: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """See `disc_rasterization`: pictures (C, H, W, D), alphas (C, H, W), centres (C, N, 2)."""
    transforms = ray_transforms(means, tangents, viewmats, intrinsics)
    pictures: list[tuple[Tensor, Tensor]] = []
    for one, values in zip(transforms, colors, strict=True):
        front = one[:, 2, 2].detach() > near_plane
        front = (front & one.detach().isfinite().all(dim=2).all(dim=1)).nonzero().squeeze(1)
        one, values = one[front], values[front]
        place = _widened(one, size, eps2d) if antialiased else _bare(one, size, eps2d)
        square, depth, inside, share = place
        values = values[:, None, None, :].expand(*square.shape, -1)
        if deep:
            values = torch.cat([values, depth[..., None]], dim=-1)
        image, alpha, middle = composited(
            square, inside, opacities[front] * share, values, one[:, 2, 2]
        )
        if median:
            none = torch.zeros_like(alpha)[None]
            found = torch.cat([depth.expand_as(square), none]).gather(
                0, (middle % (len(depth) + 1))[None]
            )
            image = torch.cat([image, found[0][..., None]], dim=-1)
        pictures.append((image, alpha))
    image, alpha = (torch.stack(parts) for parts in zip(*pictures, strict=True))
    return image, alpha, transforms[..., :2, 2] / transforms[..., 2:, 2]


def _bare(
    transforms: Tensor, size: tuple[int, int], eps2d: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Squared distance, depth, whether there is one (N, H, W each); share of the opacity (N,)."""
    columns, rows = pixel_centers(size, transforms)
    first, second, third = (transforms[:, k, None, None] for k in range(3))
    met = torch.linalg.cross(
        columns[..., None] * third - first, rows[..., None] * third - second, dim=-1
    )
    u, v = met[..., 0] / met[..., 2], met[..., 1] / met[..., 2]
    depth = u * third[..., 0] + v * third[..., 1] + third[..., 2]
    own = (u * u + v * v).where(depth > 0, torch.inf)
    dx, dy = columns - first[..., 2] / third[..., 2], rows - second[..., 2] / third[..., 2]
    around = (dx * dx + dy * dy) / eps2d
    depth = depth.where(own <= around, third[..., 2])
    square = torch.minimum(own, around)
    return (
        square,
        depth,
        torch.ones_like(square, dtype=torch.bool),
        torch.ones_like(square[:, 0, 0]),
    )


def _widened(
    transforms: Tensor, size: tuple[int, int], eps2d: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """As `_bare`, of discs whose pictures are widened by a pixel."""
    columns, rows = pixel_centers(size, transforms)
    depth = transforms[:, 2:, 2]
    middle = transforms[:, :2, 2] / depth
    farther = transforms[:, 2, :2] / depth
    across = transforms[:, :2, :2] / depth[..., None] - middle[..., None] * farther[:, None]
    bare = across @ across.mT
    covariance = bare + eps2d * torch.eye(2).to(bare)
    share = (torch.linalg.det(bare) / torch.linalg.det(covariance)).clamp(SMALLEST_SHARE, 1.0)
    inverse = torch.linalg.inv(covariance)
    offset = torch.stack(
        torch.broadcast_tensors(columns - middle[:, :1, None], rows - middle[:, 1:, None]), dim=-1
    )
    seen = torch.einsum("nhwi,nij->nhwj", offset, inverse)
    below = 1 - torch.einsum("nhwi,nij,nj->nhw", seen, across, farther)
    square = (seen * offset).sum(dim=-1) / below.square()
    return square, depth[..., None] / below, below > 0, share.sqrt()
