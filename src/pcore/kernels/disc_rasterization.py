"""Public face of the kernels of flat Gaussians (2DGS): gsplat's names, on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pcore.geometry.rotation import rotations
from pcore.kernels.backends import of_discs
from pcore.kernels.cpu_gaussians import blended
from pcore.kernels.disc_projection import ProjectedDiscs, disc_normals, project_discs
from pcore.kernels.gaussian_rasterization import (
    RasterizeMode,
    RenderMode,
    check_inputs,
    finished,
)
from pcore.kernels.reference_discs import drawn_discs
from pcore.kernels.reference_gaussians import pixel_centers

PUBLISHED_FILTER = 0.5
"""Variance of the published screen filter, pixels squared."""


def rasterization_2dgs(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803 (gsplat's name)
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    eps2d: float = PUBLISHED_FILTER,
    rasterize_mode: RasterizeMode = "classic",
    backgrounds: Tensor | None = None,
    render_mode: RenderMode = "RGB",
    tangents: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, dict[str, Any]]:
    """Draw flat Gaussians by C cameras: every ray meets their planes (Huang et al. 2024).

    Names, order and shapes are those of `gsplat.rasterization_2dgs`, of whose results those of the
    distortion are left out. Differentiable, and the same for any number of
    threads, as `gaussian_rasterization.rasterization`.

    Args:
        means: (N, 3) world units.
        quats: (N, 4) w x y z: the third axis is the normal; unused with tangents.
        scales: (N, 3) standard deviations, world units; the third one is not looked at.
        opacities: (N,) between 0 and 1.
        colors: (N, D) or (C, N, D).
        viewmats: (C, 4, 4) camera from world, OpenCV axes.
        Ks: (C, 3, 3) pinhole matrices without skew, pixels.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        near_plane: discs whose middles are nearer are not drawn, world units.
        eps2d: variance of the screen filter, pixels squared.
        rasterize_mode: "classic" draws the disc or a round Gaussian of the filter's variance at its
            middle, whichever is more in a pixel (as published); "antialiased" widens the picture of
            the disc by the filter and takes from the opacity what that adds to the area, as for 3D
            Gaussians.
        backgrounds: (C, D) colours behind; None is black.
        render_mode: "RGB+ED" appends the expected camera z of the places where rays meet discs
            ("classic": of the middle, where the round Gaussian is drawn); "RGB+MD" the median of
            these places, as of `gaussian_rasterization.rasterization`.
        tangents: (N, 3, 2) the two axes of each disc, as long as its standard deviations, in the
            place of quats and scales; an affine map leaves them not perpendicular.

    Returns:
        Pictures (C, H, W, D) or (C, H, W, D + 1), alphas (C, H, W, 1), sums (C, H, W, 3) of the
        unit normals, in the world and towards the cameras (zeros of "RGB"), and a dict of
        `means2d` (C, N, 2), the projected means, `width`, `height` and `n_cameras`.

    Raises:
        InputError: shapes that do not go together.
        DependencyError: on a GPU.
    """
    size = (width, height)
    check_inputs(means, quats, scales, opacities, colors, viewmats, Ks, size, tangents=tangents)
    if tangents is None:
        assert quats is not None
        assert scales is not None
        tangents = rotations(quats)[..., :2] * scales[:, None, :2]
    cameras, channels = len(viewmats), colors.shape[-1]
    told = render_mode != "RGB"
    values = colors.expand(cameras, *colors.shape[-2:])
    if told:
        values = torch.cat([values, disc_normals(means, tangents, viewmats)], dim=-1)
    draw = _drawn if of_discs(means) == "cpu" else drawn_discs
    image, alpha, means2d = draw(
        means,
        tangents,
        opacities,
        values,
        viewmats,
        Ks,
        size,
        near_plane=near_plane,
        eps2d=eps2d,
        antialiased=rasterize_mode == "antialiased",
        deep=render_mode == "RGB+ED",
        median=render_mode == "RGB+MD",
    )
    meta = {"means2d": means2d, "width": width, "height": height, "n_cameras": cameras}
    alpha, normals = alpha.unsqueeze(-1), torch.zeros_like(image[..., :3])
    if told:
        image, normals, depth = image.split([channels, 3, 1], dim=-1)
        image = torch.cat([image, depth], dim=-1)
    return finished(image, alpha, backgrounds, render_mode), alpha, normals, meta


def _drawn(
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
    """As `reference_discs.drawn_discs`, by the kernels."""
    projected = project_discs(
        means,
        tangents,
        viewmats,
        intrinsics,
        near_plane=near_plane,
        eps2d=eps2d if antialiased else None,
    )
    if deep:
        colors = torch.cat([colors, projected.depths.unsqueeze(-1)], dim=-1)
    precision = 0.0 if antialiased else 1 / eps2d
    image, alpha, middle = blended(
        projected.means,
        projected.maps,
        opacities * projected.shares,
        colors,
        projected.depths,
        size,
        near_plane,
        precision,
        deep,
    )
    if median:
        depth = _median_depths(projected, middle, size, precision)
        image = torch.cat([image, depth.unsqueeze(-1)], dim=-1)
    return image, alpha, projected.means


def _median_depths(
    discs: ProjectedDiscs, middle: Tensor, size: tuple[int, int], precision: float
) -> Tensor:
    """Camera z (C, H, W) where rays meet the discs that pixels name; 0 where they name none."""
    known = torch.cat([discs.means, discs.maps, discs.depths.unsqueeze(-1)], dim=-1).flatten(0, 1)
    known = torch.cat([known, known.new_zeros(1, known.shape[1])])
    named = known.index_select(0, middle.flatten() % len(known)).view(*middle.shape, -1)
    x, y, px, py, qx, qy, wx, wy, depth = named.unbind(-1)
    columns, rows = pixel_centers(size, named)
    dx, dy = columns - x, rows - y
    below = 1 + wx * dx + wy * dy
    own = ((px * dx + py * dy).square() + (qx * dx + qy * dy).square()) / below.square()
    flat = (below > 0) & ~(precision * (dx * dx + dy * dy) < own) if precision else below > 0
    return depth / below.where(flat, 1.0)
