"""Where photos without masks agree on a colour: points on surfaces, from rays and nothing else.

A plane sweep (Collins 1996): along a random ray of a photo, the depth is taken at which its
neighbours show the same little patch.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.camera import Camera
from pcore.training.reduced_view import Photo, reduced

_DEPTHS = 64
"""Tried along every ray, evenly in the inverse of the depth."""
_BESIDE, _LEAST = 6, 2
"""Nearest other cameras that are asked, and how many of them must see a patch."""
_SIDE = 160
"""Pixels along the longer side of the photos that are compared."""
_FAR_OFF = 0.2
"""Differences of colour above this are all the same: something stands in between."""


def consistent_points(
    count: int,
    views: Sequence[Photo],
    nearest: float,
    farthest: float,
    generator: torch.Generator,
) -> Tensor:
    """Points (N, 3), N <= count, where neighbouring photos agree; world units.

    Args:
        count: rays that are drawn; those on which no two others see anything give no point.
        views: at least three.
        nearest: least depth, world units.
        farthest: greatest depth.
        generator: of the draws.
    """
    longest = max(max(view.camera.width, view.camera.height) for view in views)
    small = reduced(views, max(1, round(longest / _SIDE)))
    cameras = [view.camera for view in small]
    images = [view.rgba()[..., :3].permute(2, 0, 1) for view in small]
    centers = torch.stack([camera.center for camera in cameras]).float()
    inverse = torch.linspace(1 / nearest, 1 / farthest, _DEPTHS)
    which = torch.randint(len(small), (count,), generator=generator)
    places = torch.rand(count, 2, generator=generator)
    found: list[Tensor] = []
    for index, camera in enumerate(cameras):
        at = places[which == index] * torch.tensor([camera.width, camera.height])
        if not len(at):
            continue
        order = (centers - centers[index]).norm(dim=-1).argsort()[1 : _BESIDE + 1]
        patches = at[:, None] + _OFFSETS
        points = _along(patches, camera, 1 / inverse)
        own = _shown(images[index], patches[..., 0], patches[..., 1])[:, None]
        score = _disagreement(points, own, [(cameras[n], images[n]) for n in order.tolist()])
        least, best = score.min(dim=1)
        known = least.isfinite()
        found.append(points[known, best[known], _MIDDLE])
    return torch.cat(found)


_OFFSETS = torch.tensor([[x, y] for y in (-1.0, 0.0, 1.0) for x in (-1.0, 0.0, 1.0)])
_MIDDLE = 4


def _along(patches: Tensor, camera: Camera, depths: Tensor) -> Tensor:
    """Points (R, K, P, 3) at depths (K,) behind pixels (R, P, 2) of a camera."""
    x = (patches[..., 0] - camera.cx) / camera.fx
    y = -(patches[..., 1] - camera.cy) / camera.fy
    local = torch.stack([x, y, -torch.ones_like(x)], dim=-1)[:, None] * depths[:, None, None]
    pose = camera.world_from_camera.float()
    return local @ pose[:3, :3].T + pose[:3, 3]


def _disagreement(points: Tensor, own: Tensor, others: Sequence[tuple[Camera, Tensor]]) -> Tensor:
    """Mean difference (R, K) between patches and what others show there; infinite: too few do."""
    total = torch.zeros(points.shape[:2])
    seen = torch.zeros(points.shape[:2])
    for camera, image in others:
        across, down, depth = camera.project(points.reshape(-1, 3))
        across, down, depth = (one.reshape(points.shape[:3]) for one in (across, down, depth))
        inside = (depth > 0) & (across > 0) & (across < camera.width)
        inside = (inside & (down > 0) & (down < camera.height)).all(dim=-1)
        apart = (_shown(image, across, down) - own).abs().mean(dim=(-1, -2)).clamp_max(_FAR_OFF)
        total += torch.where(inside, apart, 0.0)
        seen += inside
    return torch.where(seen >= _LEAST, total / seen.clamp_min(1), torch.inf)


def _shown(image: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """Colours (..., 3) of an image (3, H, W) at columns and rows (...)."""
    height, width = image.shape[1:]
    grid = torch.stack([2 * across / width - 1, 2 * down / height - 1], dim=-1)
    grid = grid.nan_to_num(9.0, 9.0, 9.0).reshape(1, -1, 1, 2)
    colors = F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)
    return colors[0, :, :, 0].T.reshape(*across.shape, 3)
