"""What training photos say about the points of a trained model: normals and colours."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.model.passes import Picture
from pcore.model.render import normals

_LARGEST_SIDE = 200
_SOLID = 0.9
_ALIKE = 0.4
"""Shortest mean of the unit normals that views see at a point; at edges they see several sides."""
_SEEN = 0.5

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Observed:
    """What photos say about N points.

    Attributes:
        normals: (N, 3) unit, outwards; zero where views do not agree on one.
        colors: (N, 3) mean colour.
        attention: (N,) sum of the weights that the pixels of all views gave a point.
    """

    normals: Tensor
    colors: Tensor
    attention: Tensor


@torch.no_grad()
def observe(
    papr: Papr, cloud: PointCloud, views: Sequence[View], *, progress: Progress | None = None
) -> Observed:
    """Mean normals and colours of canonical points over views, on the CPU.

    Views are looked at with at most 200 pixels a side; their number of rays per pixel is one.
    """
    device = next(papr.parameters()).device
    cloud = cloud.detached().lit(None).to(device)
    sums = torch.zeros(len(cloud), 7)
    for number, view in enumerate(views, start=1):
        _look(papr, cloud, view, sums)
        if progress is not None:
            progress(number, len(views))
    normal, color, attention = sums[:, :3], sums[:, 3:6], sums[:, 6]
    known = (attention > _SEEN) & (normal.norm(dim=1) > _ALIKE * attention)
    return Observed(
        normals=F.normalize(normal, dim=1) * known[:, None],
        colors=color / attention.clamp_min(1e-9)[:, None],
        attention=attention,
    )


def _look(papr: Papr, cloud: PointCloud, view: View, sums: Tensor) -> None:
    """Add normal, colour and 1 of every pixel to its points, by the weights of their attention."""
    largest = max(view.camera.width, view.camera.height)
    stride = math.ceil(largest / _LARGEST_SIDE)
    camera = view.camera.resized(view.camera.width // stride, view.camera.height // stride)
    rgba = _shrunk(view.rgba(), camera.height, camera.width)
    rays = camera.rays().flat()
    device = cloud.positions.device
    parts = [
        papr.attend(cloud, rays[part].to(device))
        for part in torch.arange(len(rays.origins)).split(8192)
    ]
    shape = camera.height, camera.width
    alpha = (1 - torch.cat([one.background for one, _ in parts])).reshape(shape).cpu()
    surface = torch.cat([one.surface for one, _ in parts]).reshape(*shape, 3).cpu()
    weights = torch.cat([one.weights for one, _ in parts]).reshape(*shape, -1).cpu()
    points = torch.cat([near for _, near in parts]).reshape(*shape, -1).cpu()
    picture = Picture(rgb=rgba[..., :3], alpha=alpha, depth=camera.depth(surface), surface=surface)
    normal = normals(picture, camera)
    used = ~normal.isnan().any(dim=-1) & (alpha > _SOLID)
    if view.has_alpha:
        used &= rgba[..., 3] > _SOLID
    seen = torch.cat([normal, rgba[..., :3], torch.ones(*shape, 1)], dim=-1)[used]
    share = weights[used].unsqueeze(-1) * seen.unsqueeze(1)
    sums.index_add_(0, points[used].flatten(), share.flatten(0, 1))


def _shrunk(rgba: Tensor, height: int, width: int) -> Tensor:
    """Area mean of straight colours (H, W, 4), which only count where they are solid anyway."""
    if rgba.shape[:2] == (height, width):
        return rgba
    return F.interpolate(rgba.permute(2, 0, 1)[None], (height, width), mode="area")[0].permute(
        1, 2, 0
    )
