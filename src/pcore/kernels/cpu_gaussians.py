"""Blending of projected Gaussians on the CPU by numba, with gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcore.kernels.cpu_gaussian_lists import Lists, listed
from pcore.kernels.cpu_gaussian_loops import Splats, blend, blend_backward, sum_pairs
from pcore.kernels.numba_bridge import use_torch_threads


def blended(
    means: Tensor,
    conics: Tensor,
    opacities: Tensor,
    colors: Tensor,
    depths: Tensor,
    size: tuple[int, int],
    near_plane: float,
) -> tuple[Tensor, Tensor]:
    """Blend Gaussians of C pictures from front to back.

    Args:
        means: (C, N, 2) columns and rows, pixels; float32 or float64, as all others.
        conics: (C, N, 3) inverse covariances xx, xy, yy.
        opacities: (C, N).
        colors: (C, N, D).
        depths: (C, N) the order; not differentiated.
        size: width and height.
        near_plane: what is nearer is not drawn.

    Returns:
        (C, H, W, D) sums of weight times colour and (C, H, W) alphas.
    """
    image, through = _Blend.apply(
        means, conics, opacities, colors, depths.detach(), size, near_plane
    )
    return image, 1 - through


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        conics: Tensor,
        opacities: Tensor,
        colors: Tensor,
        depths: Tensor,
        size: tuple[int, int],
        near_plane: float,
    ) -> tuple[Tensor, Tensor]:
        use_torch_threads()
        splats = _splats(means, conics, opacities, colors)
        lists = listed(
            _plain(means), _plain(conics), _plain(opacities), _plain(depths), size, near_plane
        )
        cameras, (width, height) = len(depths), size
        image = torch.zeros(cameras, height, width, colors.shape[-1], dtype=means.dtype)
        through = torch.ones(cameras, height, width, dtype=means.dtype)
        blend(splats, lists, image.numpy(), through.numpy())
        ctx.save_for_backward(means, conics, opacities, colors, image, through)
        ctx.lists = lists
        return image, through

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        use_torch_threads()
        means, conics, opacities, colors, image, through = ctx.saved_tensors
        lists: Lists = ctx.lists
        to_image, to_through = (one.contiguous() for one in gradients)
        rest = (to_image * image).sum(dim=-1) + through * to_through
        splats = _splats(means, conics, opacities, colors)
        numbers = 6 + colors.shape[-1]
        of_pairs = np.empty((len(lists.gaussians), numbers), dtype=splats.means.dtype)
        blend_backward(splats, lists, to_image.numpy(), rest.numpy(), of_pairs)
        total = torch.empty(*opacities.shape, numbers, dtype=means.dtype)
        sum_pairs(of_pairs, lists.slots, total.view(-1, numbers).numpy())
        to_means, to_conics, to_opacities, to_colors = total.split([2, 3, 1, numbers - 6], dim=-1)
        return to_means, to_conics, to_opacities.squeeze(-1), to_colors, None, None, None


def _plain(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy())


def _splats(means: Tensor, conics: Tensor, opacities: Tensor, colors: Tensor) -> Splats:
    return Splats(
        means=_plain(means).reshape(-1, 2),
        conics=_plain(conics).reshape(-1, 3),
        opacities=_plain(opacities).reshape(-1),
        colors=_plain(colors).reshape(-1, colors.shape[-1]),
    )
