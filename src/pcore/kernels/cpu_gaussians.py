"""Blending of projected Gaussians on the CPU by numba, with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.cpu_gaussian_lists import Lists, listed
from pcore.kernels.cpu_gaussian_loops import blend, blend_backward, sum_pairs
from pcore.kernels.cpu_splats import Discs, Splats
from pcore.kernels.numba_bridge import as_array


def blended(
    means: Tensor,
    shapes: Tensor,
    opacities: Tensor,
    colors: Tensor,
    depths: Tensor,
    size: tuple[int, int],
    near_plane: float,
    precision: float = 0.0,
    deep: bool = False,
) -> tuple[Tensor, Tensor, Tensor]:
    """Blend Gaussians of C pictures from front to back.

    Args:
        means: (C, N, 2) columns and rows, pixels; float32 or float64, as all others.
        shapes: (C, N, 3) inverse covariances xx, xy, yy; or (C, N, 6) maps of discs.
        opacities: (C, N).
        colors: (C, N, D).
        depths: (C, N) the order; not differentiated.
        size: width and height.
        near_plane: what is nearer is not drawn.
        precision: of the round Gaussian that a disc never is smaller than, 1 / pixels squared.
        deep: the last colour is the depth of the middle of each disc, and becomes the pixel's.

    Returns:
        (C, H, W, D) sums of weight times colour, (C, H, W) alphas, and (C, H, W) int64 which of all
        C N is in the middle of what a pixel shows: the last that over half of the light from
        behind would meet; -1 where there is none.
    """
    image, through, middle = _Blend.apply(
        means, shapes, opacities, colors, depths.detach(), size, near_plane, precision, deep
    )
    return image, 1 - through, middle


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        shapes: Tensor,
        opacities: Tensor,
        colors: Tensor,
        depths: Tensor,
        size: tuple[int, int],
        near_plane: float,
        precision: float,
        deep: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:
        use_torch_threads()
        splats = _splats(means, shapes, opacities, colors, precision, deep)
        lists = listed(
            as_array(means),
            as_array(shapes),
            as_array(opacities),
            as_array(depths),
            size,
            near_plane,
            precision,
        )
        cameras, (width, height) = len(depths), size
        image = torch.empty(cameras, height, width, colors.shape[-1], dtype=means.dtype)
        through = torch.ones(cameras, height, width, dtype=means.dtype)
        middle = torch.full((cameras, height, width), -1)
        blend(splats, lists, image.numpy(), through.numpy(), middle.numpy())
        ctx.mark_non_differentiable(middle)
        ctx.save_for_backward(means, shapes, opacities, colors, image, through)
        ctx.lists, ctx.precision, ctx.deep = lists, precision, deep
        return image, through, middle

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        means, shapes, opacities, colors, image, through = ctx.saved_tensors
        lists: Lists = ctx.lists
        to_image, to_through = (one.contiguous() for one in gradients[:2])
        rest = (to_image * image).sum(dim=-1) + through * to_through
        splats = _splats(means, shapes, opacities, colors, ctx.precision, ctx.deep)
        parts = [2, shapes.shape[-1], 1, colors.shape[-1]]
        numbers = sum(parts)
        of_pairs = np.empty((len(lists.gaussians), numbers), dtype=splats.means.dtype)
        blend_backward(splats, lists, to_image.numpy(), rest.numpy(), of_pairs)
        total = torch.empty(*opacities.shape, numbers, dtype=means.dtype)
        sum_pairs(of_pairs, lists.slots, total.view(-1, numbers).numpy())
        to_means, to_shapes, to_opacities, to_colors = total.split(parts, dim=-1)
        nothing = (None,) * 5
        return to_means, to_shapes, to_opacities.squeeze(-1), to_colors, *nothing


def _splats(
    means: Tensor, shapes: Tensor, opacities: Tensor, colors: Tensor, precision: float, deep: bool
) -> Splats | Discs:
    arrays = (
        as_array(means).reshape(-1, 2),
        as_array(shapes).reshape(-1, shapes.shape[-1]),
        as_array(opacities).reshape(-1),
        as_array(colors).reshape(-1, colors.shape[-1]),
    )
    return Splats(*arrays) if shapes.shape[-1] == 3 else Discs(*arrays, precision, deep)
