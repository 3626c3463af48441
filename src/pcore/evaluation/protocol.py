"""Two named ways to score a picture, so that numbers are only compared with their like.

`PAPR` repeats the original evaluation, quirk included; `STANDARD` is what the metrics' authors
define and what a person gets who measures the PNG files that we write.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from torch import Tensor

from pcore.metrics.image_metrics import (
    Array,
    FloatArray,
    Mask,
    as_array,
    gaussian_ssim_map,
    lpips_distance,
    mean_ssim,
    psnr,
    require_same_size,
    uniform_ssim_map,
)
from pcore.metrics.perceptual import Lpips, find_weights, load_lpips, missing_weights
from pcore.metrics.trunks import TrunkName

FOREGROUND_ALPHA = 0.5
"""Ground-truth opacity above which a pixel is foreground in image metrics."""


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How pictures are compared. Both images lie on white.

    Attributes:
        name: goes into every table and file.
        description: one line for captions.
        encode: what happens to prediction and target before they are compared; (H, W, 3) both.
        ssim_map: SSIM of every pixel, (H, W).
        lpips_input: map from [0, 1] to what LPIPS is fed.
    """

    name: str
    description: str
    encode: Callable[[FloatArray], FloatArray]
    ssim_map: Callable[[FloatArray, FloatArray], FloatArray]
    lpips_input: Callable[[Tensor], Tensor]


@dataclass(frozen=True, kw_only=True)
class Perceptual:
    """The LPIPS networks of an evaluation.

    Attributes:
        loaded: networks by trunk.
        missing: for a trunk without weights, what is missing and how to get it.
    """

    loaded: Mapping[TrunkName, Lpips] = field(default_factory=dict[TrunkName, Lpips])
    missing: Mapping[TrunkName, str] = field(default_factory=dict[TrunkName, str])

    def note(self) -> str | None:
        """Text that stands under a table whose LPIPS columns are empty; None when complete."""
        return "\n".join(self.missing.values()) or None


@dataclass(frozen=True, kw_only=True)
class ImageScores:
    """Scores of one picture.

    Attributes:
        psnr: dB over all pixels and channels; infinity for identical images.
        ssim: mean over the image.
        foreground_psnr: dB over foreground pixels; None without foreground.
        foreground_ssim: mean over foreground pixels; None without foreground.
        lpips: distance by trunk; None where the weights are missing.
    """

    psnr: float
    ssim: float
    foreground_psnr: float | None
    foreground_ssim: float | None
    lpips: Mapping[TrunkName, float | None]

    def row(self) -> dict[str, float | None]:
        """One flat row for a table; LPIPS columns are called `lpips_<trunk>`."""
        return {
            "psnr": self.psnr,
            "ssim": self.ssim,
            "foreground_psnr": self.foreground_psnr,
            "foreground_ssim": self.foreground_ssim,
            **{f"lpips_{trunk}": value for trunk, value in self.lpips.items()},
        }


def load_perceptual(
    trunks: Sequence[TrunkName] = ("alex", "vgg"), *, folder: Path | None = None
) -> Perceptual:
    """Load the LPIPS networks whose weights are on this machine and say which are not.

    Raises:
        WeightsError: a weight file is there but damaged (absent files are no error here).
    """
    loaded: dict[TrunkName, Lpips] = {}
    missing: dict[TrunkName, str] = {}
    for trunk in trunks:
        if find_weights(trunk, folder) is None:
            missing[trunk] = missing_weights(trunk, folder) or ""
        else:
            loaded[trunk] = load_lpips(trunk, folder=folder)
    return Perceptual(loaded=loaded, missing=missing)


def measure(
    protocol: Protocol,
    prediction: Array,
    target_rgba: Array,
    perceptual: Perceptual | None = None,
    valid: Mask | None = None,
) -> ImageScores:
    """Score one picture.

    Args:
        protocol: `PAPR`, `STANDARD` or your own.
        prediction: (H, W, 3) rendered on white; values outside [0, 1] are clamped.
        target_rgba: (H, W, 4) straight alpha in [0, 1], already at the resolution of the
            prediction; composited on white here, after any resizing.
        perceptual: LPIPS networks; None leaves LPIPS out.
        valid: (H, W) pixels that the photo shows; None: all. The others count nowhere: means leave
            them out, and networks see the photo there.

    Raises:
        InputError: wrong shapes, sizes that differ, NaN, images under 11 x 11 pixels.
        DependencyError: scikit-image is not installed.
    """
    rgba = as_array("target", target_rgba, 4)
    drawn = as_array("prediction", prediction, 3)
    require_same_size(prediction=drawn, target=rgba)
    if valid is not None:
        drawn = np.where(valid[..., None], drawn, on_white(rgba))
    first, second = protocol.encode(drawn), protocol.encode(on_white(rgba))
    mask: Mask = rgba[..., 3] > FOREGROUND_ALPHA
    ssim_map = protocol.ssim_map(first, second)
    lpips: dict[TrunkName, float | None] = {}
    if perceptual is not None:
        lpips.update(dict.fromkeys(perceptual.missing))
        for trunk, network in perceptual.loaded.items():
            lpips[trunk] = lpips_distance(network, first, second, protocol.lpips_input)
    return ImageScores(
        psnr=psnr(first, second, valid),
        ssim=mean_ssim(ssim_map, valid),
        foreground_psnr=_or_none(psnr(first, second, mask)),
        foreground_ssim=_or_none(mean_ssim(ssim_map, mask)),
        lpips=lpips,
    )


def on_white(rgba: FloatArray) -> FloatArray:
    """Composite (H, W, 4) straight alpha on white: c a + 1 - a, (H, W, 3)."""
    alpha = rgba[..., 3:]
    return rgba[..., :3] * alpha + 1 - alpha


def clamped(image: FloatArray) -> FloatArray:
    """Clamp to [0, 1] and keep the floating-point precision."""
    return np.clip(image, 0, 1)


def quantised(image: FloatArray) -> FloatArray:
    """Clamp to [0, 1] and round to the 256 values of an 8-bit file."""
    return np.round(np.clip(image, 0, 1) * 255) / 255


def as_it_is(images: Tensor) -> Tensor:
    """Leave [0, 1] alone: the quirk of the original PAPR evaluation."""
    return images


def to_signed(images: Tensor) -> Tensor:
    """Map [0, 1] to [-1, 1], which LPIPS is defined for."""
    return images * 2 - 1


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


PAPR = Protocol(
    name="papr",
    description="float predictions, uniform 11 x 11 SSIM, LPIPS fed [0, 1] unmapped, on white",
    encode=clamped,
    ssim_map=uniform_ssim_map,
    lpips_input=as_it_is,
)
STANDARD = Protocol(
    name="standard",
    description="8-bit images, Gaussian 11 x 11 SSIM (sigma 1.5), LPIPS fed [-1, 1], on white",
    encode=quantised,
    ssim_map=gaussian_ssim_map,
    lpips_input=to_signed,
)
PROTOCOLS: Mapping[str, Protocol] = {p.name: p for p in (PAPR, STANDARD)}
