"""How well a posed object agrees with photos, and whether they show that object at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from pcore.errors import InputError
from pcore.fitting.fit_photos import Photo
from pcore.gaussians.render import Footprint, PosedGaussians, render

_LEAST_OVERLAP = 0.8
_LEAST_EXPLAINED = 0.3


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Means over photos.

    Attributes:
        psnr: of the pixels of the object, dB.
        overlap: area that both outlines cover by the area that one covers, in [0, 1].
        explained: share of the variance of the photo's colours, where the object is, that the
            picture explains; 1 is all, below 0 is worse than one colour all over.
    """

    psnr: float
    overlap: float
    explained: float


@torch.no_grad()
def agreement(posed: PosedGaussians, photos: Sequence[Photo], footprint: Footprint) -> Agreement:
    """Compare pictures of posed Gaussians with photos of the same cameras."""
    psnr, overlap, left, varied = 0.0, 0.0, 0.0, 0.0
    for photo in photos:
        white = photo.color.new_ones(3)
        seen = render(posed, [photo.camera], footprint=footprint, background=white)
        known, alpha = photo.known, seen.alpha[0]
        both = (torch.minimum(alpha, photo.alpha) * known).sum()
        overlap += float(both / (torch.maximum(alpha, photo.alpha) * known).sum())
        true = photo.over(white)
        inside = (photo.alpha > 0.5) & (known > 0.5)
        error = (seen.rgb[0].clamp(0, 1) - true)[inside].square()
        psnr -= 10 * math.log10(max(float(error.mean()), 1e-10))
        left += float(error.sum())
        varied += float((true[inside] - true[inside].mean(dim=0)).square().sum())
    count = len(photos)
    explained = 1 - left / max(varied, 1e-10)
    return Agreement(psnr=psnr / count, overlap=overlap / count, explained=explained)


def check_same_object(found: Agreement, *, silhouettes: bool) -> None:
    """Refuse photos of something else.

    Raises:
        InputError: the fitted object covers other pixels than the photos show, or its colours
            have nothing to do with theirs.
    """
    same = found.overlap >= _LEAST_OVERLAP
    if same and (silhouettes or found.explained >= _LEAST_EXPLAINED):
        return
    raise InputError(
        f"photos: expected the object of the run in another pose, got pictures that no pose of it "
        f"explains: after the fit outlines overlap by {found.overlap:.0%} (at least "
        f"{_LEAST_OVERLAP:.0%}) and {max(found.explained, 0):.0%} of the variation of colours is "
        f"explained (at least {_LEAST_EXPLAINED:.0%}); check that run and photos are of one "
        "object, that cameras are in the run's world, or start nearer (--start)"
    )
