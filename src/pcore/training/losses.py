"""Photometric losses that both stages share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.metrics.perceptual import load_lpips
from pcore.model.papr import Papr
from pcore.render.image import Image
from pcore.render.picture import render_rays
from pcore.training.config import TrunkName
from pcore.training.patches import Patch

Perceptual = Callable[[Tensor, Tensor], Tensor]
"""Distance of two (1, 3, H, W) images in [-1, 1]."""


@dataclass(frozen=True, kw_only=True)
class Losses:
    """Weighted terms by name.

    Attributes:
        terms: scalars with gradient; their sum is what is minimised.
        squared_error: mean squared error of the patch, for its PSNR.
    """

    terms: Mapping[str, Tensor]
    squared_error: Tensor

    @property
    def total(self) -> Tensor:
        """The sum."""
        return torch.stack(list(self.terms.values())).sum()


def mean_of(losses: Sequence[Losses], *, of: int | None = None) -> Losses:
    """Mean of the same terms over several patches, or the part of it that these few have `of` all.

    Parts add up to the mean.
    """
    count = of or len(losses)
    return Losses(
        terms={
            name: torch.stack([one.terms[name] for one in losses if name in one.terms]).sum()
            / count
            for name in dict.fromkeys(name for one in losses for name in one.terms)
        },
        squared_error=torch.stack([one.squared_error for one in losses]).sum() / count,
    )


def perceptual_loss(weight: float, trunk: TrunkName, device: torch.device) -> Perceptual | None:
    """Return the LPIPS network when its loss is asked for.

    Raises:
        WeightsError: its weights are not on this machine; the message says where to put them.
    """
    return load_lpips(trunk, device=device) if weight > 0 else None


def training_image(papr: Papr, posed: PosedCloud, rays: RayBundle, background: Tensor) -> Image:
    """Render rays as losses want them: no gradient through gamma(p), as in the original.

    Depth and surface, for which no loss asks, are not looked for.
    """
    return render_rays(papr, posed, rays, background, stop_encoding=True, geometry=False)


def photometric(
    image: Image,
    patch: Patch,
    *,
    opacity_weight: float,
    lpips_weight: float,
    perceptual: Perceptual | None,
    front_weight: float = 0.0,
) -> Losses:
    """L_rgb: squared error, LPIPS and opacity against the alpha channel (paper: "as in PAPR").

    Our addition: attention to points behind the first of a ray's neighbours costs their squared
    distance from it, weighted by the opacity. Colours alone leave PAPR free to blend the back of
    the object into its front, and then its surface points lie between the two.
    """
    rgb = patch.told(image.rgb, patch.rgb)
    error = (rgb - patch.rgb).square().mean()
    terms = {"rgb": error}
    if perceptual is not None:
        images = [_as_lpips(one) for one in (rgb, patch.rgb)]
        terms["lpips"] = lpips_weight * perceptual(*images).mean()
    if opacity_weight > 0 and patch.alpha is not None:
        alpha = patch.told(image.alpha, patch.alpha)
        terms["opacity"] = opacity_weight * (alpha - patch.alpha).square().mean()
    if front_weight > 0:
        terms["front"] = front_weight * (image.alpha.detach() * image.spread).mean()
    return Losses(terms=terms, squared_error=error.detach())


def _as_lpips(image: Tensor) -> Tensor:
    return 2 * image.permute(2, 0, 1).unsqueeze(0) - 1
