"""What the Gaussian kernels compute, written as formulas: the specification, dense and slow.

Every Gaussian meets every pixel, so memory is C N H W numbers: for tests, and for small pictures in
types and on devices that no kernel serves.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.kernels.cpu_gaussian_lists import FAINTEST
from pcore.kernels.cpu_projection_loops import BEYOND, SMALLEST_SHARE
from pcore.kernels.cpu_splats import FULL, HALF, MOST_OPAQUE
from pcore.kernels.gaussian_projection import Projected


def covariances_of(quats: Tensor, scales: Tensor) -> Tensor:
    """R S S R^T (N, 3, 3) of quaternions w x y z (N, 4) and standard deviations (N, 3)."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    root = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2) * scales[:, None]
    return root @ root.mT


def entries_of(covars: Tensor) -> Tensor:
    """The symmetric part (N, 3, 3): what `project` takes."""
    return (covars + covars.mT) / 2


def project(
    means: Tensor,
    covariances: Tensor,
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    *,
    near_plane: float,
    eps2d: float,
) -> Projected:
    """S2 = J W S W^T J^T + eps I, W the rotation of the view, J the derivative of the pinhole.

    Arguments as of `gaussian_projection.project`, but covariances (N, 3, 3).
    """
    rotation, shift = viewmats[:, None, :3, :3], viewmats[:, None, :3, 3]
    local = (rotation @ means[:, :, None]).squeeze(-1) + shift
    ahead = local[..., 2].clamp_min(near_plane)
    focal = torch.diagonal(intrinsics, dim1=1, dim2=2)[:, None, :2]
    middle = intrinsics[:, None, :2, 2]
    slopes = local[..., :2] / ahead[..., None]
    pixels = means.new_tensor(size)
    room = BEYOND * pixels
    clamped = slopes.clamp(-(middle + room) / focal, (pixels - middle + room) / focal)
    plain = torch.eye(2, dtype=means.dtype, device=means.device).expand(*clamped.shape, 2)
    jacobian = (
        torch.cat([plain, -clamped[..., None]], dim=-1) * (focal / ahead[..., None])[..., None]
    )
    to_picture = jacobian @ rotation
    before = to_picture @ covariances @ to_picture.mT
    covariance = before + eps2d * torch.eye(2, dtype=means.dtype, device=means.device)
    conic = torch.linalg.inv(covariance)
    share = torch.linalg.det(before) / torch.linalg.det(covariance)
    return Projected(
        means=focal * slopes + middle,
        depths=local[..., 2],
        conics=torch.stack([conic[..., 0, 0], conic[..., 0, 1], conic[..., 1, 1]], dim=-1),
        shares=share.clamp(SMALLEST_SHARE, 1.0).sqrt(),
    )


def blended(
    means: Tensor,
    conics: Tensor,
    opacities: Tensor,
    colors: Tensor,
    depths: Tensor,
    size: tuple[int, int],
    near_plane: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """C = sum_i T_i alpha_i c_i, T_i = prod_{j < i} (1 - alpha_j); see `cpu_gaussians.blended`.

    alpha = min(0.999, o exp(-d^2 / 2)), nothing where it is under 1 / 255; a pixel takes no more
    once T would fall to 1e-4.
    """
    pictures = [
        _picture(*one, size, near_plane)
        for one in zip(means, conics, opacities, colors, depths, strict=True)
    ]
    images, alphas, middles = (torch.stack(parts) for parts in zip(*pictures, strict=True))
    first = depths.shape[1] * torch.arange(len(depths), device=depths.device)
    return images, alphas, (middles + first[:, None, None]).where(middles >= 0, -1)


def _picture(
    means: Tensor,
    conics: Tensor,
    opacities: Tensor,
    colors: Tensor,
    depths: Tensor,
    size: tuple[int, int],
    near_plane: float,
) -> tuple[Tensor, Tensor, Tensor]:
    # What is NaN is in front of nothing.
    front = (depths.detach() > near_plane).nonzero().squeeze(1)
    means, conics, opacities, colors, depths = (
        one[front] for one in (means, conics, opacities, colors, depths)
    )
    columns, rows = pixel_centers(size, means)
    x, y = means.unbind(-1)
    a, b, c = (one[:, None, None] for one in conics.unbind(-1))
    dx, dy = columns - x[:, None, None], rows - y[:, None, None]
    square = a * dx * dx + 2 * b * dx * dy + c * dy * dy
    # What is no ellipse is left out: NaN, and matrices that are not positive.
    drawn = (a * c - b * b > 0).expand_as(square)
    values = colors[:, None, None, :].expand(*square.shape, -1)
    image, alpha, middle = composited(square, drawn, opacities, values, depths)
    return image, alpha, torch.cat([front, front.new_tensor([-1])])[middle]


def pixel_centers(size: tuple[int, int], like: Tensor) -> tuple[Tensor, Tensor]:
    """Columns (1, W) and rows (H, 1) of the centres of pixels."""
    columns, rows = (torch.arange(n, device=like.device, dtype=like.dtype) + 0.5 for n in size)
    return columns[None], rows[:, None]


def composited(
    square: Tensor, drawn: Tensor, opacities: Tensor, values: Tensor, depths: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Blend N Gaussians from front to back: colour (H, W, D), alpha (H, W), the middle one (H, W).

    Args:
        square: (N, H, W) squared Mahalanobis distances.
        drawn: (N, H, W) where they may be drawn at all.
        opacities: (N,).
        values: (N, H, W, D) colours.
        depths: (N,) the order.
    """
    order = torch.argsort(depths.detach(), stable=True)
    alpha = opacities[:, None, None] * torch.exp(-square / 2)
    drawn = (drawn & (alpha >= FAINTEST))[order]
    alpha = alpha[order].clamp_max(MOST_OPAQUE).where(drawn, 0.0)
    after = torch.cumprod(1 - alpha, dim=0)
    alpha = alpha.where(after > FULL, 0.0)
    after = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    image = ((before * alpha)[..., None] * values[order].where(drawn[..., None], 0.0)).sum(dim=0)
    places = torch.arange(len(order), device=order.device)[:, None, None]
    places = places.where((alpha > 0) & (before > HALF), -1)
    empty = torch.ones(square.shape[1:]).to(square)
    last = torch.cat([places.new_full((1, *empty.shape), -1), places]).amax(dim=0)
    middle = torch.cat([order, order.new_tensor([-1])])[last]
    return image, 1 - (after[-1] if len(order) else empty), middle
