"""Whether Gaussians of another trainer show what photos show, in the same world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from pcore.data.images import background_color, composite
from pcore.data.scene import View
from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, render

_VIEWS = 6
_LEAST = 15.0
"""PSNR in dB; pictures of one place by another camera have less, trained Gaussians 20 and more."""
_OVERLAP = 0.5


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How like photos the pictures of Gaussians are.

    Attributes:
        views: how many were compared.
        psnr: mean over them, dB, on the background that fits better.
        overlap: of the silhouettes, their common part over both together, mean; None without masks.
        background: colour on which they were compared.
    """

    views: int
    psnr: float
    overlap: float | None
    background: tuple[float, float, float]


@torch.no_grad()
def agreement_with(gaussians: Gaussians, footprint: Footprint, views: Sequence[View]) -> Agreement:
    """Compare Gaussians (float32) with some of the views, evenly chosen, on white and on black."""
    step = max(1, len(views) // _VIEWS)
    chosen = views[::step][:_VIEWS]
    posed = PosedGaussians(gaussians=gaussians)
    errors = {"white": 0.0, "black": 0.0}
    overlaps: list[float] = []
    for view in chosen:
        rgba = view.rgba()
        valid = view.valid()
        told = torch.ones(rgba.shape[:2], dtype=torch.bool) if valid is None else valid
        found = render(posed, [view.camera], footprint=footprint, background=torch.zeros(3))
        for name in errors:
            color = background_color(name)
            shown = found.rgb[0] + (1 - found.alpha[0])[..., None] * color
            error = (shown.clamp(0, 1) - composite(rgba, color)).square()[told].mean()
            errors[name] += float(-10 * torch.log10(error.clamp_min(1e-12))) / len(chosen)
        if view.has_alpha:
            drawn, true = told & (found.alpha[0] > 0.5), rgba[..., 3] > 0.5
            overlaps.append(float((drawn & true).sum() / (drawn | true).sum().clamp_min(1)))
    best = max(errors, key=lambda name: errors[name])
    red, green, blue = background_color(best).tolist()
    return Agreement(
        views=len(chosen),
        psnr=errors[best],
        overlap=sum(overlaps) / len(overlaps) if overlaps else None,
        background=(red, green, blue),
    )


def check_agreement(agreement: Agreement, *, where: str, scene: str) -> None:
    """Raise InputError where Gaussians and photos do not show the same.

    Args:
        agreement: what was found.
        where: the file of the Gaussians, for the message.
        scene: folder of the photos, for the message.
    """
    apart = agreement.overlap is not None and agreement.overlap < _OVERLAP
    if agreement.psnr >= _LEAST and not apart:
        return
    silhouettes = ""
    if agreement.overlap is not None:
        silhouettes = f" and silhouettes that overlap by {100 * agreement.overlap:.0f} %"
    raise InputError(
        f"{where}: expected Gaussians that show what the photos of {scene} show, got "
        f"{agreement.psnr:.1f} dB{silhouettes}: they are of another scene, or their trainer moved "
        "the world; undo that with --transform dataparser_transforms.json (nerfstudio writes it "
        "beside its splats), train gsplat with normalize_world_space off, or leave out --scene"
    )
