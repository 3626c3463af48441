"""What training photos say about the Gaussians of a trained model: normals and colours.

A trained Gaussian is a flat piece of the surface that it lies on. Its normal is halfway between its
shortest axis, turned outwards, and the normal of the surface that pictures show there. The weight
that a pixel gives a Gaussian is the derivative of what is blended there, so that sums over pixels
are one backward pass of the renderer.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import surface_points
from pcore.gaussians.render import Footprint, blended
from pcore.geometry.rotation import rotations
from pcore.geometry.surfels import known_normals, spacing_of
from pcore.render.image import Image
from pcore.render.surfel_fit import Observed, Progress, Shown, colors_at, compared, small, told

_SEEN = 0.5
"""Pixels of all views that must show a Gaussian, by its weights in them."""
_OPAQUE = 0.1
"""Less opacity is haze and no surface."""
_FLAT = 0.8
"""Longest that the shortest axis may be, as a share of the second: else it says nothing."""
_ALIKE = 0.4
"""Shortest mean of the unit normals of the pictures' surface at a Gaussian."""
_AGREE = 0.5
"""Least cosine between an axis and that mean: an axis that stands across the surface that pictures
show there is that of a Gaussian which is no piece of it."""


def observe_gaussians(
    gaussians: Gaussians,
    footprint: Footprint,
    views: Sequence[View],
    *,
    progress: Progress | None = None,
) -> Observed:
    """Normals and colours of Gaussians at rest by all views, on the CPU; the means are the surface.

    Views are looked at with at most 200 pixels a side.

    Args:
        gaussians: N of them; their device does the work.
        footprint: as they were trained.
        views: photos that they were trained on.
        progress: told (views seen, views in all).
    """
    gaussians = gaussians.detached()
    sums, shown = torch.zeros(len(gaussians), 7), list[Shown]()
    kept = compared(len(views))
    for number, view in enumerate(views, start=1):
        weighed, seen = _look(gaussians, footprint, view)
        sums += weighed
        if number - 1 in kept:
            shown.append(seen)
        if progress is not None:
            progress(number, len(views))
    facing, color, attention = sums[:, :3], sums[:, 3:6], sums[:, 6]
    plain = gaussians.to("cpu", torch.float32)
    normal = _normals(plain, facing, attention)
    spacing = spacing_of(plain.means)
    around = color / attention.clamp_min(1e-9)[:, None]
    there = colors_at(plain.means, normal, shown, spacing)
    colors = torch.where(known_normals(normal)[:, None] & ~there.isnan(), there, around)
    return Observed(
        normals=normal,
        colors=colors,
        attention=attention,
        heights=torch.zeros_like(attention),
    )


def shortest_axes(gaussians: Gaussians) -> tuple[Tensor, Tensor]:
    """Unit axes (N, 3) along which Gaussians are shortest, and whether one is so, (N,) bool."""
    lengths, order = gaussians.scales.sort(dim=1)
    axes = rotations(gaussians.quats)
    axis = axes.gather(2, order[:, None, :1].expand(-1, 3, 1))[..., 0]
    return F.normalize(axis, dim=1), lengths[:, 0] < _FLAT * lengths[:, 1]


def _normals(gaussians: Gaussians, facing: Tensor, attention: Tensor) -> Tensor:
    """Normals (N, 3), zero where none is known.

    Args:
        gaussians: on the CPU.
        facing: (N, 3) weighted sums of the normals, towards the cameras, that pictures show.
        attention: (N,) sums of the weights.
    """
    axis, flat = shortest_axes(gaussians)
    along, length = (axis * facing).sum(dim=1), facing.norm(dim=1)
    axis = torch.where(along[:, None] < 0, -axis, axis)
    agreed = flat & (along.abs() > _AGREE * length)
    shown = F.normalize(facing, dim=1)
    # Half of each: an axis knows finer shapes, pictures are calmer. A round Gaussian lies on the
    # surface all the same, whose normal pictures show.
    normal = torch.where(agreed[:, None], F.normalize(axis + shown, dim=1), shown)
    known = (attention > _SEEN) & (gaussians.opacities > _OPAQUE) & (length > _ALIKE * attention)
    return normal * known[:, None]


def _look(gaussians: Gaussians, footprint: Footprint, view: View) -> tuple[Tensor, Shown]:
    """Sums (N, 7) of normal, colour and 1 of a photo's pixels by the weights of the blending."""
    camera, rgba = small(view)
    values = gaussians.means.new_zeros(len(gaussians), 7, requires_grad=True)
    with torch.enable_grad():
        image, alpha, depth = blended(gaussians, values, camera, footprint=footprint)
    opacity, far = alpha.detach().cpu(), depth.detach().cpu()
    far = torch.where(opacity > 0, far, torch.nan)
    taken = Image(rgb=rgba[..., :3], alpha=opacity, depth=far, surface=surface_points(far, camera))
    seen, shown = told(taken, camera, rgba, masked=view.has_alpha)
    (weighed,) = torch.autograd.grad(image, values, seen.to(image))
    return weighed.cpu().float(), shown
