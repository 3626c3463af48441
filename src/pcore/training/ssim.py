"""Structural similarity of pictures with gradients (Wang et al. 2004): window 11, sigma 1.5."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.training.losses import Losses

_WINDOW, _SIGMA = 11, 1.5
_MEAN_GUARD, _CONTRAST_GUARD = 0.01**2, 0.03**2


def ssim(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean over pixels, channels and pictures; beyond the border everything is black.

    Args:
        prediction: (C, H, W, D) in [0, 1]; differentiated.
        target: (C, H, W, D) in [0, 1].

    Returns:
        A scalar, 1 for equal pictures.
    """
    first, second = (one.permute(0, 3, 1, 2) for one in (prediction, target))
    # Apart, so that what has no gradient is not blurred on the way back.
    a, aa, ab = _blurred(torch.cat([first, first * first, first * second], dim=1)).chunk(3, dim=1)
    b, bb = _blurred(torch.cat([second, second * second], dim=1)).chunk(2, dim=1)
    squares, product = a * a + b * b, a * b
    means = (2 * product + _MEAN_GUARD) / (squares + _MEAN_GUARD)
    contrasts = (2 * (ab - product) + _CONTRAST_GUARD) / (aa + bb - squares + _CONTRAST_GUARD)
    return (means * contrasts).mean()


def picture_losses(rgb: Tensor, photo: Tensor, ssim_weight: float) -> Losses:
    """(1 - w) L1 + w (1 - SSIM) of pictures (C, H, W, 3), as 3D Gaussian Splatting trains by."""
    error = rgb - photo
    terms = {"l1": (1 - ssim_weight) * error.abs().mean()}
    if ssim_weight > 0:
        terms["ssim"] = ssim_weight * (1 - ssim(rgb, photo))
    return Losses(terms=terms, squared_error=error.detach().square().mean())


def _blurred(image: Tensor) -> Tensor:
    """Every channel of (C, D, H, W) by itself, columns first, then rows."""
    channels, window = image.shape[1], _window().to(image)
    across = window.view(1, 1, 1, -1).expand(channels, 1, 1, -1)
    down = window.view(1, 1, -1, 1).expand(channels, 1, -1, 1)
    image = F.conv2d(image, across, padding=(0, _WINDOW // 2), groups=channels)
    return F.conv2d(image, down, padding=(_WINDOW // 2, 0), groups=channels)


@cache
def _window() -> Tensor:
    distances = torch.arange(_WINDOW, dtype=torch.float64) - _WINDOW // 2
    weights = torch.exp(-distances.square() / (2 * _SIGMA**2))
    return weights / weights.sum()
