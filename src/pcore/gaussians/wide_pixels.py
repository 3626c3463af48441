"""Pictures whose pixels are wider on the object than those that its Gaussians learned from.

A screen filter blurs each Gaussian, and blends what several cover of one pixel as if it lay there
at random. Drawn as finely as the photos were, and averaged, they show what they have learned
(ADR 46).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pixel_unshuffle

from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, GaussianPictures, PosedGaussians, render
from pcore.geometry.camera import Camera

_WIDER = 1.15
"""So much wider a pixel may be before it is divided: there both ways are equally good."""
_MOST, _PIXELS = 8, 2**23
"""Parts of a side of a pixel at most, and of a picture."""


def pixel_width(gaussians: Gaussians, camera: Camera, growth: Tensor | None = None) -> float:
    """Width of a pixel at the object, world units: the median over Gaussians.

    Args:
        gaussians: at least one.
        camera: one.
        growth: (N,) by how much an edit has made each longer; the width is then that at rest.
    """
    means = gaussians.means.detach()
    widths = (means - camera.center.detach().to(means)).norm(dim=-1) / min(camera.focal)
    return float((widths if growth is None else widths / growth).median())


def parts_of_pixels(posed: PosedGaussians, camera: Camera, footprint: Footprint) -> int:
    """Into how many parts along each side a pixel must be divided; 1 where that is not known."""
    if footprint.pixel is None or not len(posed.gaussians):
        return 1
    growth = None
    if posed.axes is not None:
        first, second, third = posed.axes.detach().double().unbind(dim=-1)
        volumes = (torch.linalg.cross(first, second) * third).sum(dim=-1).abs()
        rest = posed.gaussians.scales.detach().double().prod(dim=-1)
        growth = (volumes / rest).pow(1 / 3).clamp_min(torch.finfo(torch.float32).tiny)
    wider = pixel_width(posed.gaussians, camera, growth) / footprint.pixel
    room = max(1, math.isqrt(_PIXELS // (camera.width * camera.height)))
    return max(1, min(math.ceil(min(wider, _MOST) / _WIDER), room))


def render_divided(
    posed: PosedGaussians, camera: Camera, *, footprint: Footprint, background: Tensor
) -> GaussianPictures:
    """Draw one picture as `render`; pixels that are too wide are divided, then without normals."""
    parts = parts_of_pixels(posed, camera, footprint)
    if parts == 1:
        return render(posed, [camera], footprint=footprint, background=background)
    fine = camera.resized(parts * camera.width, parts * camera.height)
    found = render(posed, [fine], footprint=footprint, background=background)

    return GaussianPictures(
        rgb=avg_pool2d(found.rgb.movedim(-1, 1), parts).movedim(1, -1),
        alpha=avg_pool2d(found.alpha.unsqueeze(1), parts).squeeze(1),
        depth=_middle_depths(found, parts),
        means2d=found.means2d / parts,
    )


def _middle_depths(found: GaussianPictures, parts: int) -> Tensor:
    """Depths (C, H, W) of the part at which half of what all parts of a pixel show is reached."""
    opacity, depth = (
        pixel_unshuffle(plane.unsqueeze(1), parts).movedim(1, -1)
        for plane in (found.alpha, found.depth)
    )
    depth, order = depth.sort(dim=-1)
    reached = opacity.detach().gather(-1, order).cumsum(dim=-1)
    middle = (reached >= reached[..., -1:] / 2).int().argmax(dim=-1, keepdim=True)
    return depth.gather(-1, middle).squeeze(-1)
