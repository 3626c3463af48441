"""How well a posed object agrees with photos, and whether they show that object at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import WHITE, Asset, Posed
from pcore.errors import InputError
from pcore.fitting.fit_photos import Photo

_LEAST_OVERLAP = 0.8
_LEAST_EXPLAINED = 0.5


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Means over photos.

    Attributes:
        psnr: of the pixels of the object, dB.
        overlap: area that both outlines cover by the area that one covers, in [0, 1].
        explained: share of the variance of the photo's colours, where the object is, that the
            picture explains; 1 is all, below 0 is worse than one colour all over.
        error: of outlines and, unless only these count, of colours: their mean absolute difference
            by the area of the object in the photos.
    """

    psnr: float
    overlap: float
    explained: float
    error: float


@torch.no_grad()
def agreement(
    asset: Asset, posed: Posed, photos: Sequence[Photo], *, silhouettes: bool
) -> Agreement:
    """Compare the pictures that an object is drawn in by default with photos of its pose."""
    psnr, overlap, left, varied = 0.0, 0.0, 0.0, 0.0
    differs, area = 0.0, 0.0
    on_white = asset.over(WHITE)
    for photo in photos:
        white = photo.color.new_ones(3)
        seen = on_white.render(posed, photo.camera)
        known, alpha, rgb = photo.known, seen.alpha.to(white), seen.rgb.to(white)
        both = (torch.minimum(alpha, photo.alpha) * known).sum()
        overlap += float(both / (torch.maximum(alpha, photo.alpha) * known).sum())
        differs += float(difference(rgb, alpha, photo, white, silhouettes=silhouettes))
        area += float((photo.alpha * known).sum())
        true = photo.over(white)
        inside = (photo.alpha > 0.5) & (known > 0.5)
        error = (rgb.clamp(0, 1) - true)[inside].square()
        psnr -= 10 * math.log10(max(float(error.mean()), 1e-10))
        left += float(error.sum())
        varied += float((true[inside] - true[inside].mean(dim=0)).square().sum())
    count = len(photos)
    explained = 1 - left / max(varied, 1e-10)
    return Agreement(
        psnr=psnr / count,
        overlap=overlap / count,
        explained=explained,
        error=differs / max(area, 1.0),
    )


def difference(
    rgb: Tensor, alpha: Tensor, photo: Photo, background: Tensor, *, silhouettes: bool
) -> Tensor:
    """Sum over pixels of how much opacity (H, W) and colours (H, W, 3) differ from a photo's.

    Args:
        rgb: over the background.
        alpha: opacity.
        photo: to compare with.
        background: (3,) colour that both stand before.
        silhouettes: leave the colours out.
    """
    error = (alpha - photo.alpha).abs()
    if not silhouettes:
        error = error + (rgb - photo.over(background)).abs().mean(dim=-1)
    return (error * photo.known).sum()


def check_same_object(found: Agreement, *, silhouettes: bool, coarse: bool = False) -> None:
    """Refuse photos of something else.

    Args:
        found: agreement of what was fitted.
        silhouettes: only outlines count.
        coarse: it is not refined yet: only colours that one colour all over would meet better are
            refused, so that nobody waits for the rest.

    Raises:
        InputError: the fitted object covers other pixels than the photos show, or its colours
            have nothing to do with theirs.
    """
    overlap, explained = (0.0, 0.0) if coarse else (_LEAST_OVERLAP, _LEAST_EXPLAINED)
    if found.overlap >= overlap and (silhouettes or found.explained >= explained):
        return
    if coarse:
        why = "after the coarse stages of the fit one colour all over would meet theirs better"
    else:
        why = (
            f"after the fit outlines overlap by {found.overlap:.0%} (at least {overlap:.0%}) and "
            f"{max(found.explained, 0):.0%} of the variation of colours is explained (at least "
            f"{explained:.0%})"
        )
    raise InputError(
        "photos: expected the object of the run in another pose, got pictures that no pose of it "
        f"explains: {why}; check that run and photos are of one object, that cameras are in the "
        "run's world, or start nearer (--start)"
    )
