"""Gaussians in space to Gaussians in the picture: element by element in torch, with gradients.

Every quantity is kept as its components (C, N) or (N,). Batched products of 3 x 3 matrices say the
same (`reference_gaussians` does it so) and take several times as long on a CPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

BEYOND = 0.15
"""The linearised projection follows centres up to so many picture sizes beyond the border."""
SMALLEST_SHARE = 1e-12
"""Least squared part of its opacity that the screen filter leaves a Gaussian, for its root."""


@dataclass(frozen=True, kw_only=True)
class Projected:
    """N Gaussians before C cameras; only those in front of the near plane mean anything.

    Attributes:
        means: (C, N, 2) columns and rows of the centres, pixels.
        depths: (C, N) camera z of the centres, world units.
        conics: (C, N, 3) inverse of the 2 x 2 covariances: xx, xy, yy, 1 / pixels squared.
        shares: (C, N) what the screen filter leaves of the opacities when the Gaussians' sums are
            to stay (antialiased); between 0 and 1.
    """

    means: Tensor
    depths: Tensor
    conics: Tensor
    shares: Tensor


def project(
    means: Tensor,
    covariances: Sequence[Tensor],
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    *,
    near_plane: float,
    eps2d: float,
) -> Projected:
    """Project by the pinhole's derivative at the centres (Zwicker et al. 2001).

    Args:
        means: (N, 3) world units.
        covariances: xx, xy, xz, yy, yz, zz, each (N,), world units squared.
        viewmats: (C, 4, 4) camera from world, OpenCV axes (z forward).
        intrinsics: (C, 3, 3) without skew, pixels.
        size: width and height, pixels.
        near_plane: depths below it are taken for this one, so that nothing is divided by zero.
        eps2d: variance of the screen filter, pixels squared.
    """
    rows = [row.unbind(-1) for row in viewmats[:, :3].unbind(-2)]
    rows = [[entry.unsqueeze(-1) for entry in row] for row in rows]
    x, y, z = means.unbind(-1)
    right, down, depth = (r[0] * x + r[1] * y + r[2] * z + r[3] for r in rows)
    ahead = depth.clamp_min(near_plane)
    lens_x, lens_y = _lens(intrinsics, 0), _lens(intrinsics, 1)
    slope_x, slope_y = right / ahead, down / ahead
    means2d = torch.stack(
        [lens_x[0] * slope_x + lens_x[1], lens_y[0] * slope_y + lens_y[1]], dim=-1
    )
    first = _gradient_of_slope(rows[0], rows[2], slope_x, ahead, lens_x, size[0])
    second = _gradient_of_slope(rows[1], rows[2], slope_y, ahead, lens_y, size[1])
    along, beside = _times(covariances, first), _times(covariances, second)
    xx, xy, yy = _dot(first, along), _dot(second, along), _dot(second, beside)
    before = xx * yy - xy * xy
    xx, yy = xx + eps2d, yy + eps2d
    area = xx * yy - xy * xy
    return Projected(
        means=means2d,
        depths=depth,
        conics=torch.stack([yy / area, -xy / area, xx / area], dim=-1),
        shares=(before / area).clamp(SMALLEST_SHARE, 1.0).sqrt(),
    )


def covariances_of(quats: Tensor, scales: Tensor) -> list[Tensor]:
    """Entries xx, xy, xz, yy, yz, zz (N,) of R S S R^T.

    Args:
        quats: (N, 4) w x y z, of any length but zero.
        scales: (N, 3) standard deviations.
    """
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    a, b, c = scales.unbind(-1)
    first = ((1 - 2 * (y * y + z * z)) * a, 2 * (x * y - w * z) * b, 2 * (x * z + w * y) * c)
    second = (2 * (x * y + w * z) * a, (1 - 2 * (x * x + z * z)) * b, 2 * (y * z - w * x) * c)
    third = (2 * (x * z - w * y) * a, 2 * (y * z + w * x) * b, (1 - 2 * (x * x + y * y)) * c)
    rows = (first, second, third)
    return [_dot(rows[i], rows[j]) for i in range(3) for j in range(i, 3)]


def entries_of(covars: Tensor) -> list[Tensor]:
    """Entries xx, xy, xz, yy, yz, zz (N,) of symmetric matrices (N, 3, 3)."""
    rows = [row.unbind(-1) for row in covars.unbind(-2)]
    # Both triangles get gradient, as a symmetric matrix's must.
    return [rows[i][i] if i == j else (rows[i][j] + rows[j][i]) / 2 for i, j in _UPPER]


_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _lens(intrinsics: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Focal length and principal point along one axis, (C, 1) each."""
    return intrinsics[:, axis, axis, None], intrinsics[:, axis, 2, None]


def _gradient_of_slope(
    across: Sequence[Tensor],
    forward: Sequence[Tensor],
    slope: Tensor,
    depth: Tensor,
    lens: tuple[Tensor, Tensor],
    pixels: int,
) -> list[Tensor]:
    """Derivative of a pixel coordinate by the place in the world: three components (C, N)."""
    focal, middle = lens
    room = BEYOND * pixels
    slope = slope.clamp(-(middle + room) / focal, (pixels - middle + room) / focal)
    per_depth = focal / depth
    return [per_depth * (a - slope * f) for a, f in zip(across[:3], forward[:3], strict=True)]


def _times(covariances: Sequence[Tensor], vector: Sequence[Tensor]) -> list[Tensor]:
    xx, xy, xz, yy, yz, zz = covariances
    x, y, z = vector
    return [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]


def _dot(first: Sequence[Tensor], second: Sequence[Tensor]) -> Tensor:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
