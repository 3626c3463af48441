"""PSNR, SSIM and LPIPS of one picture, over the whole image or over its foreground.

Definitions as formulas: `docs/concepts/metrics.md`. Which variant belongs to which published way of
measuring: `pcore.evaluation.protocol`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.errors import InputError
from pcore.metrics.perceptual import Lpips
from pcore.packages import package

Array = Tensor | NDArray[Any]
FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WINDOW = 11
_BORDER = (_WINDOW - 1) // 2


def as_array(name: str, value: Array, channels: int | None) -> FloatArray:
    """Give (H, W, channels) or, with channels None, (H, W) in float64 on the CPU.

    Args:
        name: what the array is, for the message.
        value: tensor or array.
        channels: length of the last axis; None for a plane.

    Raises:
        InputError: another shape, an empty image, or NaN or infinity.
    """
    result = as_plane_or_image(name, value, channels)
    bad = int((~np.isfinite(result)).sum())
    if bad:
        raise InputError(
            f"{name}: expected finite numbers, got NaN or infinity in {bad} of {result.size} "
            "values; look at the picture before measuring it"
        )
    return result


def as_plane_or_image(name: str, value: Array, channels: int | None) -> FloatArray:
    """Like `as_array`, but NaN and infinity are let through (depth maps have them).

    Raises:
        InputError: another shape or an empty image.
    """
    plain = value.detach().cpu().numpy() if isinstance(value, Tensor) else value
    result = np.asarray(plain, dtype=np.float64)
    wanted = "(H, W)" if channels is None else f"(H, W, {channels})"
    tail = () if channels is None else (channels,)
    if result.ndim != 2 + len(tail) or result.shape[2:] != tail or result.size == 0:
        raise InputError(f"{name}: expected shape {wanted}, got {tuple(result.shape)}")
    return result


def require_same_size(**arrays: FloatArray | Mask) -> None:
    """Check that all arrays have one height and width.

    Raises:
        InputError: sizes differ; the message names each.
    """
    if len({a.shape[:2] for a in arrays.values()}) > 1:
        sizes = ", ".join(f"{k} {a.shape[1]} x {a.shape[0]}" for k, a in arrays.items())
        raise InputError(
            f"expected arrays of one width x height, got {sizes}; "
            "render at the resolution of the ground truth"
        )


def psnr(prediction: Array, target: Array, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio in dB, one mean square error over pixels AND channels.

    Args:
        prediction: (H, W, 3) in [0, 1].
        target: (H, W, 3) in [0, 1].
        mask: (H, W) pixels that count; all when None.

    Returns:
        -10 log10(MSE); infinity for identical images, NaN when the mask is empty.

    Raises:
        InputError: wrong shapes, sizes that differ, NaN.
    """
    first, second = _pair(prediction, target)
    squares = np.square(first - second)
    if mask is not None:
        require_same_size(prediction=first, mask=mask)
        squares = squares[mask]
    if squares.size == 0:
        return math.nan
    error = float(squares.mean())
    return math.inf if error == 0 else -10 * math.log10(error)


def uniform_ssim_map(prediction: Array, target: Array) -> FloatArray:
    """SSIM of every pixel, uniform 11 x 11 window, sample covariance, data range 1 (PAPR's).

    Args:
        prediction: (H, W, 3) in [0, 1].
        target: (H, W, 3) in [0, 1].

    Returns:
        (H, W), mean over channels; infinity-free, 1 where the windows are identical. The outer 5
        pixels see mirrored windows: `mean_ssim` leaves them out.

    Raises:
        InputError: wrong shapes, sizes that differ, NaN, images under 11 x 11 pixels.
        DependencyError: scikit-image is not installed.
    """
    return _ssim_map(prediction, target, gaussian_weights=False, use_sample_covariance=True)


def gaussian_ssim_map(prediction: Array, target: Array) -> FloatArray:
    """SSIM of every pixel with the Gaussian window (sigma 1.5, 11 x 11) of Wang et al. 2004.

    Arguments, result and errors as `uniform_ssim_map`; population covariance.
    """
    return _ssim_map(
        prediction, target, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )


def mean_ssim(ssim_map: FloatArray, mask: Mask | None = None) -> float:
    """Mean of an SSIM map over the pixels whose window lies inside the image.

    Args:
        ssim_map: (H, W) from one of the map functions.
        mask: (H, W) pixels that count; all when None.

    Returns:
        The mean; NaN when no pixel counts.

    Raises:
        InputError: mask and map differ in size.
    """
    inner = (slice(_BORDER, -_BORDER), slice(_BORDER, -_BORDER))
    values = ssim_map[inner]
    if mask is not None:
        require_same_size(ssim_map=ssim_map, mask=mask)
        values = values[mask[inner]]
    return float(values.mean()) if values.size else math.nan


def lpips_distance(
    lpips: Lpips, prediction: Array, target: Array, to_input: Callable[[Tensor], Tensor]
) -> float:
    """LPIPS of one picture.

    Args:
        lpips: the loaded module, on any device.
        prediction: (H, W, 3) in [0, 1].
        target: (H, W, 3) in [0, 1].
        to_input: map from [0, 1] to what the network is fed (its definition wants [-1, 1]).

    Raises:
        InputError: wrong shapes, sizes that differ, NaN, image too small for the trunk.
    """
    first, second = _pair(prediction, target)
    device = lpips.get_buffer("shift").device
    batches = [
        to_input(torch.from_numpy(image).permute(2, 0, 1)[None].to(device, torch.float32))
        for image in (first, second)
    ]
    with torch.inference_mode():
        return float(lpips(*batches).item())


def _pair(prediction: Array, target: Array) -> tuple[FloatArray, FloatArray]:
    first, second = as_array("prediction", prediction, 3), as_array("target", target, 3)
    require_same_size(prediction=first, target=second)
    return first, second


def _ssim_map(prediction: Array, target: Array, **options: object) -> FloatArray:
    first, second = _pair(prediction, target)
    if min(first.shape[:2]) < _WINDOW:
        raise InputError(
            f"SSIM: expected images of at least {_WINDOW} x {_WINDOW} pixels, "
            f"got {first.shape[1]} x {first.shape[0]}"
        )
    skimage = package("skimage.metrics", extra="metrics", need="SSIM needs", named="scikit-image")
    full: FloatArray = skimage.structural_similarity(
        first, second, win_size=_WINDOW, data_range=1.0, channel_axis=2, full=True, **options
    )[1]
    return full.mean(axis=2)
