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
_LEAST, _ENOUGH = 17.0, 22.0
"""PSNR in dB over both silhouettes. Of six objects of ours, in their own world: 24 to 41, by
another screen filter 17.4 to 22; turned by 10 to 180 degrees or moved by a twentieth: 7.5 to 16.5,
and up to 18.7 where an object is nearly the same from behind."""
_LEAST_WHOLE, _ENOUGH_WHOLE = 15.0, 20.0
"""Of whole pictures, where no masks tell what the object is: pictures of one place by another
camera have less than the first, trained Gaussians more than the second."""
_OVERLAP = 0.5
_CLEARER = 0.5
"""dB by which another screen filter has to be better than the first."""
_MOVED = (
    "their trainer moved the world; undo that with --transform dataparser_transforms.json "
    "(nerfstudio writes it beside its splats), train gsplat with normalize_world_space off"
)


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How like photos the pictures of Gaussians are.

    Attributes:
        views: how many were compared.
        psnr: mean over them, dB, on the background that fits better: over what either of both
            silhouettes covers, for the empty space around an object agrees with anything; over
            whole pictures without masks.
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
        if view.has_alpha:
            drawn, true = told & (found.alpha[0] > 0.5), told & (rgba[..., 3] > 0.5)
            told = drawn | true
            overlaps.append(float((drawn & true).sum() / told.sum().clamp_min(1)))
        for name in errors:
            color = background_color(name)
            shown = found.rgb[0] + (1 - found.alpha[0])[..., None] * color
            error = (shown.clamp(0, 1) - composite(rgba, color)).square()[told]
            error = error.sum() / max(1, error.numel())
            errors[name] += float(-10 * torch.log10(error.clamp_min(1e-12))) / len(chosen)
    best = max(errors, key=lambda name: errors[name])
    red, green, blue = background_color(best).tolist()
    return Agreement(
        views=len(chosen),
        psnr=errors[best],
        overlap=sum(overlaps) / len(overlaps) if overlaps else None,
        background=(red, green, blue),
    )


def best_agreement(
    gaussians: Gaussians, footprints: Sequence[Footprint], views: Sequence[View]
) -> tuple[Agreement, Footprint]:
    """Compare by several screen filters; found is the first, unless another is clearly better."""
    first, *others = footprints
    found = agreement_with(gaussians, first, views), first
    least = found[0].psnr + _CLEARER
    for footprint in others:
        agreement = agreement_with(gaussians, footprint, views)
        if agreement.psnr > max(least, found[0].psnr):
            found = agreement, footprint
    return found


def check_agreement(agreement: Agreement, *, where: str, scene: str) -> str | None:
    """Raise InputError where Gaussians and photos do not show the same; return a doubt, if any.

    Args:
        agreement: what was found.
        where: the file of the Gaussians, for the message.
        scene: folder of the photos, for the message.
    """
    if agreement.overlap is None:
        apart, least, enough, silhouettes = False, _LEAST_WHOLE, _ENOUGH_WHOLE, ""
    else:
        apart, least, enough = agreement.overlap < _OVERLAP, _LEAST, _ENOUGH
        silhouettes = f" and silhouettes that overlap by {100 * agreement.overlap:.0f} %"
    if agreement.psnr < least or apart:
        raise InputError(
            f"{where}: expected Gaussians that show what the photos of {scene} show, got "
            f"{agreement.psnr:.1f} dB{silhouettes}: they are of another scene, or {_MOVED}, or "
            "their trainer had another screen filter (--variance, --antialiased), or leave out "
            "--scene"
        )
    if agreement.psnr >= enough:
        return None
    return (
        f"{agreement.psnr:.1f} dB{silhouettes} are few for its own photos: --variance or "
        f"--antialiased may be other than its trainer's, or {_MOVED}"
    )
